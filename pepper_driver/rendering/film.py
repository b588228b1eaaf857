"""Films and pictures of a log: MP4, GIF and PNG."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, get_args

import numpy as np

from pepper_driver.config import MissingExtraError, RobotConfig, UnknownNameError, load_robot
from pepper_driver.config.arrays import FloatArray, PixelArray
from pepper_driver.config.errors import check_name
from pepper_driver.config.files import check_writable, replacing
from pepper_driver.log import RunLog
from pepper_driver.log.plots import rows_between
from pepper_driver.observer import Contact
from pepper_driver.rendering import Format, View
from pepper_driver.rendering.gl import RenderError, check_gl
from pepper_driver.rendering.panel import MAX_JOINTS, SignalPanel, joints_to_show
from pepper_driver.viewer.drawing import FORCE_COLOR
from pepper_driver.viewer.moments import Moments
from pepper_driver.viewer.picture import Force

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFont import FreeTypeFont

FORMATS: tuple[Format, ...] = get_args(Format)
NEEDED = ("imageio_ffmpeg", "PIL", "matplotlib")
"""Modules of the extra ``video``."""

DEFAULT_SIZE = (1280, 720)
MIN_SIDE, MAX_SIDE = 360, 3840
"""Width and height in pixels: less has no room for signals, more is beyond what drivers draw."""
MAX_FPS = 100.0
MAX_GIF_FPS = 50.0
"""Browsers show faster ones slowly."""
MAX_GIF_FRAMES = 1500
"""A GIF is composed in memory."""
MIN_SPEED, MAX_SPEED = 0.01, 100.0

SCENE_RATIO = 0.44
"""Fraction of the picture that the robot has: of its width, or its height where that is larger."""

CAPTION_HEIGHT = 0.034
"""Letters, as a fraction of the picture's height."""
MIN_FORCE = 0.5
"""[N] A smaller force is not named."""
TEXT_COLOR, CONTACT_COLOR, FAINT_COLOR = (40, 44, 52), (200, 60, 0), (120, 126, 136)

PALETTE_SAMPLES = 12
"""Frames from which the colours of a GIF are chosen."""
PALETTE_COLORS = 255
"""One of 256 is left to Pillow for what does not change."""

TICK = 0.012
"""[s] A film of a single tick is as long."""


class Film:
    """A film of a log, or pictures of it.

    Args:
        log: What was recorded.
        start: Begin, on the clock of the robot [s]; None for the first tick.
        stop: End [s]; None for the last tick.
        fps: Frames in a second of the film.
        speed: Times real time.
        size: Width and height in pixels, even numbers.
        view: Side from which the robot is seen.
        joints: Whose residuals are shown, at most three; without any, those on which contacts were detected.

    Attributes:
        times: (n,) moments of the frames, on the clock of the robot [s].
        fps: As given.

    Raises:
        UnknownNameError: No such joint.
        LogError: The log has no tick, or none at that time.
        RenderError: A number is out of its bounds, a joint was not observed, or the log is of another robot.
    """

    def __init__(
        self,
        log: RunLog,
        *,
        start: float | None = None,
        stop: float | None = None,
        fps: float = 25.0,
        speed: float = 1.0,
        size: tuple[int, int] = DEFAULT_SIZE,
        view: View = "front",
        joints: Sequence[str] = (),
    ) -> None:
        check_numbers(fps, speed, size)
        self.robot = load_robot()
        if log.joint_names != self.robot.joint_names:
            raise RenderError(f"the log is of another robot ('{log.robot}')")
        if len(set(joints)) > MAX_JOINTS:
            raise RenderError(f"{len(set(joints))} joints: at most {MAX_JOINTS} have room")
        for joint in joints:
            check_name("joint", joint, log.joint_names)
        rows = rows_between(log, start, stop)
        for joint in joints:
            if np.isnan(log["residual"][rows, log.joint_names.index(joint)]).all():
                raise RenderError(f"{joint} was not observed then: it has no residual to show")
        time = log["time"][rows]
        self.log, self.fps, self.view, self.size = log, fps, view, size
        self.start, self.stop = float(time[0]), max(float(time[-1]), float(time[0]) + TICK)
        self.joints = list(dict.fromkeys(joints)) or joints_to_show(log, self.start, self.stop)
        count = max(1, round((self.stop - self.start) / speed * fps))
        self.times: FloatArray = self.start + np.arange(count, dtype=np.float64) * (speed / fps)

    def write(self, path: Path, on_frame: Callable[[], None] = lambda: None) -> None:
        """Write the film; an existing file is replaced at the end, and stays if this fails or is interrupted.

        Args:
            path: MP4 or GIF by its suffix.
            on_frame: Called after each frame.

        Raises:
            MissingExtraError: The extra ``video`` is not installed.
            RenderError: Nothing draws here, or the film cannot be composed.
            OutputError: The file cannot be written.
        """
        form = check_output(path)
        if form == "png":
            raise RenderError(f"{path}: a picture is of one moment; use save_picture")
        if form == "gif":
            check_gif(len(self.times), self.fps)
        with replacing(path) as partial, Frames(self) as frames:
            if form == "gif":
                _write_gif(partial, frames, self.times, self.fps, on_frame)
            else:
                with _encoder(partial, self.size, self.fps) as write:
                    for time in self.times.tolist():
                        write(frames.draw(time))
                        on_frame()

    def save_picture(self, path: Path, at: float | None = None) -> None:
        """Write the picture of one moment as PNG.

        Args:
            path: The file.
            at: When [s]; None for the moment at which a residual is farthest beyond its threshold.

        Raises:
            MissingExtraError: The extra ``video`` is not installed.
            RenderError: Nothing draws here, or the moment is outside the film.
            OutputError: The file cannot be written.
        """
        check_output(path)
        if at is not None and not self.start <= at <= self.stop:
            raise RenderError(
                f"at {at:g} s there is no tick: they go from {self.start:.2f} s to {self.stop:.2f} s"
            )
        with replacing(path) as partial, Frames(self) as frames:
            image = _as_image(frames.draw(self._best_moment() if at is None else at))
            image.save(partial, format="png")

    def _best_moment(self) -> float:
        time = self.log["time"]
        rows = np.flatnonzero((time >= self.start) & (time <= self.stop))
        with np.errstate(invalid="ignore", divide="ignore"):
            excess = np.abs(self.log["residual"][rows]) / self.log["threshold"][rows]
        best = np.nan_to_num(excess, posinf=0.0).max(axis=1)
        return float(time[rows[int(best.argmax())]])


def check_output(path: Path) -> str:
    """Return the format of a file by its suffix.

    Raises:
        UnknownNameError: There is no such format.
        MissingExtraError: The extra ``video`` is not installed.
        PepperError: Nothing draws here.
        OutputError: The file cannot be written.
    """
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMATS:
        raise UnknownNameError("film format", path.suffix.removeprefix("."), FORMATS)
    if any(find_spec(module) is None for module in NEEDED):
        raise MissingExtraError("rendering", "video")
    check_gl()
    check_writable(path)
    return form


def check_numbers(fps: float, speed: float, size: tuple[int, int]) -> None:
    """Refuse what cannot be filmed.

    Raises:
        RenderError: A number is out of its bounds.
    """
    if not 0.0 < fps <= MAX_FPS:
        raise RenderError(f"{fps:g} frames a second: must be more than 0, at most {MAX_FPS:g}")
    if not MIN_SPEED <= speed <= MAX_SPEED:
        raise RenderError(
            f"speed {speed:g}: must be {MIN_SPEED:g} to {MAX_SPEED:g} times real time"
        )
    if any(n % 2 or not MIN_SIDE <= n <= MAX_SIDE for n in size):
        raise RenderError(
            f"size {size[0]}x{size[1]}: both must be even numbers, {MIN_SIDE} to {MAX_SIDE}"
        )


def check_gif(frames: int, fps: float) -> None:
    """Refuse a GIF that browsers show too slowly, or that does not fit into memory.

    Raises:
        RenderError: It is too fast or too long.
    """
    if fps > MAX_GIF_FPS:
        raise RenderError(
            f"{fps:g} frames a second: a GIF has at most {MAX_GIF_FPS:g}; or write .mp4"
        )
    if frames > MAX_GIF_FRAMES:
        raise RenderError(
            f"{frames} frames: a GIF has at most {MAX_GIF_FRAMES}; take a shorter stretch or fewer "
            "frames a second, or write .mp4"
        )


class Frames:
    """Draws frames of a film: the robot with a caption, and the signals next to it or below it.

    Args:
        film: What to draw.

    Raises:
        RenderError: Nothing draws here without a display.
    """

    def __init__(self, film: Film) -> None:
        # Only now: importing MuJoCo fails where an environment variable asks for a library that is not there.
        from pepper_driver.rendering.scene import SceneRenderer

        log = film.log
        self._moments = Moments(log)
        width, height = film.size
        scene = _scene_size(width, height) if film.joints else film.size
        self._panel: SignalPanel | None = None
        self._side_by_side = scene[1] == height
        if film.joints:
            panel = (width - scene[0], height) if self._side_by_side else (width, height - scene[1])
            self._panel = SignalPanel(log, film.joints, film.start, film.stop, *panel)
        self._caption = Caption(film.robot, round(CAPTION_HEIGHT * min(height, width)))
        heading = float(np.nan_to_num(self._moments.base[self._moments.row(film.start), 2]))
        self._scene = SceneRenderer(film.robot, *scene, view=film.view, heading=heading)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._scene.close()

    def draw(self, time: float) -> PixelArray:
        """Return (height, width, 3) pixels at a time [s]."""
        contacts = self._moments.contacts(time)
        picture = self._moments.picture(self._moments.row(time))
        robot = self._scene.draw(picture, contacts)
        robot = self._caption.write(
            robot,
            time,
            contacts,
            forces=picture.forces,
            observed=self._panel is not None,
            simulated=self._moments.log.truth is not None,
        )
        if self._panel is None:
            return robot
        return np.concatenate((robot, self._panel.draw(time)), axis=1 if self._side_by_side else 0)


class Caption:
    """Text in the picture of the robot: the time, the contacts, and that it is a simulation.

    Args:
        robot: Names the limbs.
        height: Of its letters in pixels, roughly.
    """

    def __init__(self, robot: RobotConfig, height: int) -> None:
        from matplotlib import font_manager
        from PIL import ImageFont

        file = font_manager.findfont("DejaVu Sans")
        self._limbs = tuple(robot.limbs)
        self._large: FreeTypeFont = ImageFont.truetype(file, max(9, round(1.2 * height)))
        self._small: FreeTypeFont = ImageFont.truetype(file, max(8, round(0.85 * height)))
        self._margin = max(4, height // 2)

    def write(
        self,
        pixels: PixelArray,
        time: float,
        contacts: Sequence[Contact],
        *,
        forces: Sequence[Force],
        observed: bool,
        simulated: bool,
    ) -> PixelArray:
        """Return the picture with its caption."""
        from PIL import ImageDraw

        image = _as_image(pixels)
        draw = ImageDraw.Draw(image)
        place = (self._margin, self._margin)
        draw.text(place, f"{time:.2f} s", font=self._large, fill=TEXT_COLOR)
        below = (self._margin, self._margin + round(1.35 * self._large.size))
        limbs = [limb for limb in self._limbs if any(c.limb == limb for c in contacts)]
        if limbs:
            text = ", ".join(limb.replace("_", " ") for limb in limbs)
            draw.text(below, f"contact: {text}", font=self._large, fill=CONTACT_COLOR)
        elif observed:
            draw.text(below, "no contact", font=self._large, fill=FAINT_COLOR)
        if simulated:
            corner = (self._margin, image.height - self._margin)
            draw.text(corner, "simulation", font=self._small, fill=FAINT_COLOR, anchor="ls")
            sizes = [float(np.linalg.norm(force.force)) for force in forces]
            if sizes and max(sizes) > MIN_FORCE:
                above = (self._margin, corner[1] - round(1.35 * self._small.size))
                text = f"true force {max(sizes):.0f} N"
                draw.text(above, text, font=self._small, fill=FORCE_COLOR, anchor="ls")
        return np.asarray(image)


def _scene_size(width: int, height: int) -> tuple[int, int]:
    if width >= height:
        return 2 * round(0.5 * SCENE_RATIO * width), height
    return width, 2 * round(0.5 * (1.0 - SCENE_RATIO) * height)


def _as_image(pixels: PixelArray) -> Image:
    from PIL import Image

    return Image.fromarray(pixels)


def _write_gif(
    path: Path, frames: Frames, times: FloatArray, fps: float, on_frame: Callable[[], None]
) -> None:
    """Write a GIF whose frames share one palette: with one each, still parts would flicker."""
    from PIL.Image import Dither, Quantize

    samples = times[np.unique(np.linspace(0, len(times) - 1, PALETTE_SAMPLES).round().astype(int))]
    seen = _as_image(np.concatenate([frames.draw(t) for t in samples.tolist()]))
    palette = seen.quantize(PALETTE_COLORS, Quantize.FASTOCTREE)  # keeps rare colours: what glows

    def images() -> Iterator[Image]:
        for time in times.tolist():
            yield _as_image(frames.draw(time)).quantize(palette=palette, dither=Dither.NONE)
            on_frame()

    # A GIF counts hundredths of a second: rounded one by one they add up to the film's length.
    ends = np.round(100.0 * np.arange(len(times) + 1) / fps).astype(int)
    drawn = images()
    next(drawn).save(
        path,
        format="gif",
        save_all=True,
        append_images=drawn,
        duration=(10 * np.diff(ends)).tolist(),
        loop=0,
    )


@contextmanager
def _encoder(
    path: Path, size: tuple[int, int], fps: float
) -> Iterator[Callable[[PixelArray], None]]:
    """Yield a function that adds a frame to an MP4.

    Raises:
        RenderError: ffmpeg cannot compose it.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    rate = Fraction(fps).limit_denominator(1000)
    taken = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(rate)]
    made = ["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    with TemporaryFile() as said:
        try:
            process: Any = subprocess.Popen(
                [
                    get_ffmpeg_exe(),
                    "-v",
                    "error",
                    "-y",
                    *taken,
                    "-i",
                    "-",
                    *made,
                    "-f",
                    "mp4",
                    path,
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,  # Ctrl-C is for this process, which then ends it
            )
        except (OSError, RuntimeError) as error:
            raise RenderError(f"ffmpeg cannot be started ({error})") from error
        try:
            yield lambda pixels: process.stdin.write(np.ascontiguousarray(pixels).data)
            process.stdin.close()
            failed = process.wait() != 0
        except BrokenPipeError:  # it says why
            failed = True
        finally:
            process.kill()
            process.wait()
        if failed:
            said.seek(0)
            words = said.read().decode(errors="replace").strip().splitlines()
            raise RenderError(f"ffmpeg failed: {words[-1] if words else 'it does not say why'}")
