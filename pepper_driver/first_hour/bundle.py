"""Bundle of a first hour: its folder, or the archive that can be sent."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, get_args

from pepper_driver.backends.log_file import RUN
from pepper_driver.backends.log_records import find_metadata
from pepper_driver.config import PepperError, load_robot
from pepper_driver.config.errors import reason
from pepper_driver.first_hour.state import STATE, FirstHour, FirstHourError, StepName, load_state
from pepper_driver.identification.dataset import (
    MANIFEST,
    SUFFIX,
    RecordingFolderError,
    finished,
    read_manifest,
)
from pepper_driver.log.reader import BEGIN_SIZE
from pepper_driver.observer.models.model_file import ModelFileError, ModelSet

ARCHIVE = "first_hour.zip"

Part = Literal["models", "identification", "rest", "free", "touches", "doctor"]
PARTS: tuple[Part, ...] = get_args(Part)

PLACES: dict[Part, str] = {
    "models": "models.json",
    "identification": "identification",
    "rest": "rest.mcap",
    "free": "free.mcap",
    "touches": "touches.mcap",
    "doctor": "doctor.zip",
}
"""Place of each part in the folder and in the archive."""

_STEP_OF: dict[Part, StepName] = {
    "models": "identify",
    "identification": "identify",
    "rest": "rest",
    "free": "free",
    "touches": "touches",
    "doctor": "doctor",
}

MAX_SIZE = 4 * 2**30
"""[bytes] Of all files in an archive: more is no first hour."""


class BundleError(PepperError, ValueError):
    """A bundle of a first hour lacks parts, is damaged, of another version, or mixed of several robots."""


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """Files of one robot's first hour. Only those that were asked for are sure to be there.

    Attributes:
        source: As given: folder or archive.
        state: What ``first_hour.json`` says; ``state.prompts`` has the touches that were asked for.
        models: Model file of the robot.
        identification: Folder of recordings, as :func:`pepper_driver.identification.record_joints` leaves it.
        rest, free, touches: Logs with the observer on: standing, in free motion, with labelled touches.
        doctor: Archive of ``pepper doctor --report``.
    """

    source: Path
    state: FirstHour
    models: Path
    identification: Path
    rest: Path
    free: Path
    touches: Path
    doctor: Path

    def place_of(self, part: Part) -> Path:
        """Return the file or folder of a part by its name."""
        path: Path = getattr(self, part)
        return path


def is_bundle(path: Path) -> bool:
    """Return True for a folder or an archive with the state of a first hour at its root."""
    if path.is_dir():
        return (path / STATE).is_file()
    try:
        with zipfile.ZipFile(path) as archive:
            return STATE in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


@contextmanager
def open_bundle(path: Path | str, *, parts: Collection[Part] = PARTS) -> Iterator[Bundle]:
    """Yield the files of a bundle; those of an archive are in a temporary folder until the block ends.

    Args:
        path: Folder of ``pepper first-hour``, or its archive.
        parts: That must be there; the steps that make them must be done.

    Raises:
        BundleError: In one line: what is missing, damaged, of another format, or of another robot than the rest.
    """
    path = Path(path)
    if path.is_dir():
        yield _bundle(path, path, parts)
        return
    with TemporaryDirectory() as name:
        folder = Path(name)
        _extract(path, folder, parts)
        yield _bundle(path, folder, parts)


def _bundle(source: Path, folder: Path, parts: Collection[Part]) -> Bundle:
    try:
        state = load_state(folder / STATE)
    except FirstHourError as error:
        text = str(error).replace(f"{folder}/", "").replace(str(folder), "it")
        raise BundleError(f"{source}: {text.split('; ')[0]}") from error
    robot = load_robot()
    here = (robot.name, robot.joint_names, robot.cycle)
    if (state.robot, state.joint_names, state.cycle) != here:
        raise BundleError(
            f"{source}: it is of a robot '{state.robot}' with other joints or another clock than '{robot.name}' here"
        )
    files = {part: folder / place for part, place in PLACES.items()}
    for part in parts:
        remedy = (
            f"'pepper first-hour' with '--again {_STEP_OF[part]}' makes it again"
            if source.is_dir()
            else "have it sent again"
        )
        if state.step(_STEP_OF[part]).progress != "done":
            raise BundleError(
                f"{source}: step '{_STEP_OF[part]}' is not done, so it has no {PLACES[part]}; the command 'pepper "
                "first-hour' that began it goes on from there"
            )
        if not files[part].exists():
            raise BundleError(f"{source}: {PLACES[part]} is missing; {remedy}")
        _check_robot(source, part, files[part], state, remedy)
    return Bundle(
        source=source,
        state=state,
        models=files["models"],
        identification=files["identification"],
        rest=files["rest"],
        free=files["free"],
        touches=files["touches"],
        doctor=files["doctor"],
    )


def _check_robot(source: Path, part: Part, file: Path, state: FirstHour, remedy: str) -> None:
    """Refuse a part of another robot than the state says, and one that cannot be read."""
    try:
        identity = _identity(part, file)
    except (ModelFileError, RecordingFolderError, OSError, ValueError) as error:
        text = reason(error).replace(f"{file.parent}/", "")
        raise BundleError(f"{source}: {PLACES[part]} cannot be read: {text}; {remedy}") from error
    if identity is not None and identity != state.identity:
        raise BundleError(
            f"{source}: {PLACES[part]} is of the robot {identity}, and {STATE} of {state.identity}: the files of two "
            "robots are mixed"
        )


def _identity(part: Part, file: Path) -> str | None:
    """Return the identity of the robot that a part is of; None where it does not say. Its clock is checked too."""
    if part == "models":
        return ModelSet.load(file, load_robot()).identity
    if part == "identification":
        manifest = read_manifest(file)
        names = [run.name for run in manifest.runs]
        missing = sorted(set(names) - set(finished(file, names)))
        if missing:
            raise RecordingFolderError(f"{len(missing)} runs are missing, such as {missing[0]}")
        return manifest.identity
    if part == "doctor":
        if not zipfile.is_zipfile(file):
            raise OSError("it is no ZIP archive")
        return None
    with file.open("rb") as log:
        found = find_metadata(log.read(BEGIN_SIZE), (RUN,))
    if RUN not in found:
        raise OSError("it is no log of this package, or its begin is damaged")
    cycle, expected = float(found[RUN].get("cycle", "nan")), load_robot().cycle
    if cycle != expected:
        raise OSError(f"it is of a robot whose clock has cycles of {cycle} s, not {expected} s")
    return found[RUN].get("identity")


def _extract(path: Path, folder: Path, parts: Collection[Part]) -> None:
    """Copy state and parts of a first hour out of an archive; all else in it is left there."""
    try:
        with zipfile.ZipFile(path) as archive:
            known = [entry for entry in archive.infolist() if _is_known(entry.filename, parts)]
            if sum(entry.file_size for entry in known) > MAX_SIZE:
                raise BundleError(f"{path}: its files are too large for a first hour")
            for entry in known:
                target = folder / entry.filename
                target.parent.mkdir(exist_ok=True)
                with archive.open(entry) as packed, target.open("wb") as file:
                    shutil.copyfileobj(packed, file)
    except FileNotFoundError:
        raise BundleError(f"{path}: there is no such file or folder") from None
    except (OSError, zipfile.BadZipFile, EOFError, RuntimeError, NotImplementedError) as error:
        raise BundleError(
            f"{path}: is no archive of a first hour, or damaged ({reason(error)})"
        ) from error
    except Exception as error:  # decompressors raise errors of their own on damaged bytes
        if isinstance(error, BundleError):
            raise
        raise BundleError(f"{path}: damaged ({reason(error)})") from error


def _is_known(name: str, parts: Collection[Part]) -> bool:
    """Return True for the state and a file of these parts: then its name leads out of no folder."""
    folder, _, file = name.partition("/")
    if "identification" in parts and folder == PLACES["identification"]:
        return file == MANIFEST or (file.endswith(SUFFIX) and not {"/", "\\"} & set(file))
    return name == STATE or name in {PLACES[part] for part in parts}
