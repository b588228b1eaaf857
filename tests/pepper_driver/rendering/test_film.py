"""Films and pictures: how many frames, what is in the files, and what is left of one that fails."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("imageio_ffmpeg")
pytest.importorskip("PIL")
pytest.importorskip("matplotlib")
import imageio_ffmpeg
from PIL import Image

from pepper_driver.cli.app import run
from pepper_driver.config import MissingExtraError, UnknownNameError
from pepper_driver.config.files import OutputError
from pepper_driver.log import LogError, RunLog, read_log
from pepper_driver.rendering import film as film_module
from pepper_driver.rendering.film import Film, Frames, check_output
from pepper_driver.rendering.gl import RenderError
from support import ROOT
from support.rendering import pushed_robot, require_gl

SMALL = (480, 360)
START, STOP = 3.9, 4.7


@pytest.fixture(scope="module")
def gl() -> None:
    require_gl()


@pytest.fixture(scope="module")
def log_file(request: pytest.FixtureRequest) -> Path:
    return pushed_robot(request)


@pytest.fixture(scope="module")
def log(log_file: Path) -> RunLog:
    return read_log(log_file)


def frames_of(path: Path) -> list[np.ndarray]:
    """Decode a film by another library's decoder."""
    if path.suffix == ".gif":
        with Image.open(path) as image:
            shown = []
            for number in range(getattr(image, "n_frames", 0)):
                image.seek(number)
                shown.append(np.asarray(image.convert("RGB")))
            return shown
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return [np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader]


@pytest.mark.parametrize(("fps", "speed"), [(25.0, 1.0), (10.0, 0.5), (30.0, 3.0)])
def test_a_film_has_a_frame_for_each_part_of_its_time(
    log: RunLog, fps: float, speed: float
) -> None:
    film = Film(log, start=START, stop=STOP, fps=fps, speed=speed)
    length = film.stop - film.start
    assert length == pytest.approx(STOP - START, abs=0.025)
    assert len(film.times) == round(length / speed * fps)
    np.testing.assert_allclose(np.diff(film.times), speed / fps)
    assert film.times[0] == film.start
    assert film.times[-1] < film.stop + 1e-9


def test_without_bounds_it_is_all_of_the_log(log: RunLog) -> None:
    film = Film(log)
    assert (film.start, film.stop) == (log["time"][0], log["time"][-1])


def test_a_single_tick_is_a_frame(log: RunLog) -> None:
    one = replace(log, fields={name: column[:1] for name, column in log.fields.items()})
    assert len(Film(one).times) == 1


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_the_file_has_all_frames_at_their_rate(log: RunLog, tmp_path: Path, suffix: str) -> None:
    film = Film(log, start=START, stop=STOP, fps=15.0, size=SMALL)
    path, done = tmp_path / f"film.{suffix}", []
    film.write(path, lambda: done.append(1))
    shown = frames_of(path)
    assert len(shown) == len(done) == len(film.times) == 12
    assert all(frame.shape == (SMALL[1], SMALL[0], 3) for frame in shown)
    with Frames(film) as frames:
        drawn = frames.draw(film.times[5])
    assert np.abs(shown[5].astype(int) - drawn).mean() < 4.0
    if suffix == "gif":
        with Image.open(path) as image:
            total = 0
            for number in range(getattr(image, "n_frames", 0)):
                image.seek(number)
                total += image.info["duration"]
            assert image.info["loop"] == 0
        assert total == pytest.approx(1000 * 12 / 15.0, abs=10)
    else:
        assert next(imageio_ffmpeg.read_frames(str(path)))["fps"] == 15.0
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.usefixtures("gl")
def test_a_picture_without_a_time_is_of_the_strongest_touch(log: RunLog, tmp_path: Path) -> None:
    film = Film(log, size=SMALL)
    film.save_picture(tmp_path / "a.png")
    excess = np.nan_to_num(np.abs(log["residual"]) / log["threshold"]).max(axis=1)
    film.save_picture(tmp_path / "b.png", float(log["time"][excess.argmax()]))
    film.save_picture(tmp_path / "c.png", START)
    a, b, c = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in "abc")
    assert a.shape == (SMALL[1], SMALL[0], 3)
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


@pytest.mark.usefixtures("gl")
def test_a_log_without_an_observer_shows_the_robot_alone(log: RunLog) -> None:
    nothing = np.full_like(log["residual"], np.nan)
    film = Film(replace(log, contacts=[], fields=log.fields | {"residual": nothing}), size=SMALL)
    assert film.joints == []
    with Frames(film) as frames:
        assert frames.draw(START).shape == (SMALL[1], SMALL[0], 3)
    with pytest.raises(RenderError, match="LElbowRoll was not observed then"):
        Film(replace(log, fields=log.fields | {"residual": nothing}), joints=["LElbowRoll"])


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("size", [(480, 360), (360, 480), (1280, 360)])
def test_any_shape_is_filled(log: RunLog, size: tuple[int, int], recwarn: Any) -> None:
    film = Film(log, size=size, joints=["LShoulderRoll", "LElbowRoll", "LHand"])
    with Frames(film) as frames:
        assert frames.draw(START).shape == (size[1], size[0], 3)
    assert not [w for w in recwarn if "layout" in str(w.message)]


def interrupt(after: int) -> Callable[[], None]:
    """Ctrl-C after some frames."""
    left = iter(range(after))

    def on_frame() -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt

    return on_frame


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("suffix", ["mp4", "gif"])
def test_an_interrupted_film_leaves_what_was_there(
    log: RunLog, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*args: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*args, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    path = tmp_path / f"film.{suffix}"
    path.write_bytes(b"the old one")
    with pytest.raises(KeyboardInterrupt):
        Film(log, start=START, stop=STOP, size=SMALL).write(path, interrupt(3))
    assert path.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [path]
    assert bool(started) == (suffix == "mp4")  # a first start may ask for the version of ffmpeg
    assert all(process.poll() is not None for process in started)


@pytest.mark.usefixtures("gl")
def test_the_reason_why_ffmpeg_fails_is_one_line(
    log: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho first >&2\necho No space left on device >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(broken))
    with pytest.raises(RenderError, match=r"^ffmpeg failed: No space left on device$"):
        Film(log, start=START, stop=STOP, size=SMALL).write(tmp_path / "film.mp4")
    assert not (tmp_path / "film.mp4").exists()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"start": 2.0, "stop": 1.0}, LogError, "from 2 s to 1 s is no stretch of time"),
        ({"start": 90.0}, LogError, "the log holds no tick there"),
        ({"fps": 0.0}, RenderError, "0 frames a second: must be more than 0, at most 100"),
        ({"fps": float("nan")}, RenderError, "nan frames a second"),
        ({"speed": 0.0}, RenderError, "speed 0: must be 0.01 to 100"),
        ({"size": (1280, 721)}, RenderError, "size 1280x721: both must be even numbers, 360 to"),
        ({"size": (64, 64)}, RenderError, "size 64x64: both must be even numbers, 360 to 3840"),
        ({"joints": ["LElbow"]}, UnknownNameError, "unknown joint 'LElbow' (did you mean LElbow"),
        (
            {"joints": ["LHand", "RHand", "HeadYaw", "HeadPitch"]},
            RenderError,
            "4 joints: at most 3 have room",
        ),
    ],
)
def test_what_cannot_be_filmed_is_refused(
    log: RunLog, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=re.escape(message)):
        Film(log, **options)


def test_files_that_cannot_be_written_are_refused(log: RunLog, tmp_path: Path) -> None:
    with pytest.raises(
        UnknownNameError, match=r"unknown film format 'avi' \(possible: gif, mp4, png"
    ):
        check_output(Path("x.avi"))
    film = Film(log, start=START, stop=STOP, size=SMALL)
    with pytest.raises(OutputError, match="there is no such file"):
        film.write(tmp_path / "nowhere" / "x.mp4")
    with pytest.raises(RenderError, match="a picture is of one moment"):
        film.write(tmp_path / "x.png")
    with pytest.raises(RenderError, match=r"at 99 s there is no tick: they go from 3\.9"):
        film.save_picture(tmp_path / "x.png", 99.0)
    with pytest.raises(RenderError, match="a GIF has at most 50"):
        replaced(film, fps=60.0).write(tmp_path / "x.gif")
    with pytest.raises(RenderError, match="frames: a GIF has at most 1500"):
        replaced(film, times=np.zeros(1501)).write(tmp_path / "x.gif")
    assert not list(tmp_path.iterdir())


def replaced(film: Film, **values: Any) -> Film:
    other = Film(film.log, start=START, stop=STOP, size=SMALL)
    for name, value in values.items():
        setattr(other, name, value)
    return other


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film_module, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pepper-driver\[video\]"):
        check_output(Path("x.mp4"))


@pytest.mark.usefixtures("gl")
def test_the_command_writes_films_and_pictures(
    log_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gif, png = tmp_path / "touch.gif", tmp_path / "touch.png"
    bounds = ["--from", str(START), "--to", str(START + 0.25), "--size", "480x360"]
    assert run(["render", str(log_file), "--out", str(gif), *bounds, "--fps", "10"]) == 0
    assert f"film: {gif}, 2 frames, 0.2 s" in capsys.readouterr().out
    assert len(frames_of(gif)) == 2
    options = ["--at", "4.3", "--view", "left", "--joint", "LElbowRoll", "--size", "480x360"]
    assert run(["render", str(log_file), "--out", str(png), *options]) == 0
    assert f"picture: {png}" in capsys.readouterr().out
    assert Image.open(png).size == (480, 360)
    assert run(["render", str(log_file), "--format", "png", "--size", "480x360"]) == 0
    assert Image.open(log_file.with_suffix(".png")).size == (480, 360)


@pytest.mark.usefixtures("gl")
def test_the_code_in_the_documentation_runs(
    log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (code,) = re.findall(r"```py\n(.*?)```", (ROOT / "docs" / "render.md").read_text(), re.DOTALL)
    (tmp_path / "run.mcap").symlink_to(log_file)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert (tmp_path / "touch.mp4").stat().st_size > 1000
    assert (tmp_path / "touch.png").is_file()
