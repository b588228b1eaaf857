"""Recordings of an identification, and the folder in which they are kept."""

from __future__ import annotations

import dataclasses
import json
import logging
import platform
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, field
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.backends import Backend
from pepper_driver.config import ConfigError, Experiment, PepperError, RobotConfig
from pepper_driver.config.errors import first_difference, reason
from pepper_driver.config.files import content_hash, make_folder, set_aside, write_json
from pepper_driver.config.loading import STRICT, parse
from pepper_driver.identification.measurements.friction import HeldWeight
from pepper_driver.identification.runs import IdentificationRun, Role, run_name
from pepper_driver.observer import Recording, RecordingError

logger = logging.getLogger("pepper_driver")


@dataclasses.dataclass(frozen=True, kw_only=True)
class JointDataset:
    """Free motion of one joint: the estimation runs, in order of their stiffness, and the faster test run.

    Without estimation runs the joint has no model of its own: one that is shared is tried on the test run.
    """

    joint: str
    estimation: tuple[Recording, ...]
    test: Recording

    @property
    def runs(self) -> tuple[Recording, ...]:
        """All of them, the test run last."""
        return (*self.estimation, self.test)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the runs, in this order."""
        numbers = (*range(1, len(self.estimation) + 1), None)
        return tuple(run_name(self.joint, number) for number in numbers)

    @property
    def index(self) -> int:
        """Column of the joint."""
        return self.test.joint_names.index(self.joint)

    def mirrored(self, robot: RobotConfig) -> JointDataset:
        """Mirror image of the dataset: that of the joint of the other side."""
        return JointDataset(
            joint=mirror_joint(self.joint, robot),
            estimation=tuple(run.mirrored(robot) for run in self.estimation),
            test=self.test.mirrored(robot),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class IdentificationDataset:
    """All that was recorded of one robot.

    Attributes:
        sweeps: By joint, in the order they were recorded; models are fitted to these.
        calibration: Free motion of the whole body, in order of its stiffness, on which thresholds and the weights of
            channels are chosen; no model is fitted to it. May be empty.
        measurement: By experiment, the runs by which the robot was measured; empty for none.
    """

    sweeps: tuple[JointDataset, ...]
    calibration: tuple[Recording, ...]
    measurement: Mapping[str, Recording] = field(default_factory=dict)

    @property
    def free_motion(self) -> tuple[Recording, ...]:
        """Motion that no model is fitted to: the calibration, or without it the test runs."""
        return self.calibration or tuple(entry.test for entry in self.sweeps)

    def without(self, joints: Collection[str]) -> IdentificationDataset:
        """Return the dataset without the sweeps of these joints."""
        kept = tuple(entry for entry in self.sweeps if entry.joint not in joints)
        return dataclasses.replace(self, sweeps=kept)

    def entries(self, robot: RobotConfig, *, mirror: bool = True) -> Iterator[JointDataset]:
        """Yield the recordings of each joint that gets a model.

        With ``mirror``, what was recorded of one side follows mirrored, where the other side was not recorded. Mirrored
        recordings are made when they are asked for: they take as much memory as the others.
        """
        recorded = {entry.joint for entry in self.sweeps}
        for entry in self.sweeps:
            yield entry
            if mirror and mirror_joint(entry.joint, robot) not in recorded:
                yield entry.mirrored(robot)


def mirror_joint(joint: str, robot: RobotConfig) -> str:
    """Return the joint at the place of ``joint`` on the other side; joints of legs and head are their own."""
    return robot.joint_names[robot.mirror[robot.joint_index(joint)][0]]


FORMAT: Literal[3] = 3
MANIFEST = "manifest.json"
SUFFIX = ".npz"

_AGAIN = "give what was given then, or another folder"

_COMPARED = {
    "robot": "of the robot description",
    "joint_names": "of a robot with the joints",
    "identity": "of the robot",
    "backend": "with the backend",
    "experiment": "with the motion",
    "experiment_hash": "with the content of the motion file",
    "calibration": "with the calibration motion",
    "calibration_hash": "with the content of the calibration file",
    "seed": "with the seed",
    "joints": "of the joints",
    "tested": "for a test only of the joints",
    "response_delay": "with a delay in ticks of",
    "measured_by": "measuring",
    "weight": "with the weight",
}
"""What the runs depend on, and the words before its value."""


class RecordingFolderError(PepperError, ValueError):
    """A folder of recordings is not complete, not of this robot, made in another way, or damaged."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RunEntry:
    """One run in the manifest; see :class:`pepper_driver.identification.runs.IdentificationRun`."""

    name: Annotated[str, Field(pattern=r"^\w+-\w+$")]
    joint: str | None
    role: Role
    stiffness: float
    seed: tuple[int, ...]
    seconds: float
    weight: HeldWeight | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Manifest:
    """Origin of the recordings in a folder: robot, runs and settings.

    Attributes:
        format: Of this file.
        robot, joint_names: Of the robot's description.
        backend: URI of the robot that was driven.
        identity: Hash of the simulated robot, or the body id of a real one.
        simulated: Whether it was a simulated one, here or behind the stand-in.
        real_time: Whether it moved by the clock of the wall, as a robot on a network does.
        response_delay: Ticks from a command to the sample that answers it, as the backend said.
        experiment, experiment_hash: The motion, by name and content.
        calibration, calibration_hash: That of the whole body; None if not available.
        seed: Root of all that is random.
        joints: With estimation runs and a test run.
        tested: With a test run only.
        versions: Of the software that recorded.
        runs: In the order they are made.
    """

    format: Literal[3]
    robot: str
    joint_names: tuple[str, ...]
    backend: str
    identity: str
    simulated: bool
    real_time: bool
    response_delay: int
    experiment: str
    experiment_hash: str
    calibration: str | None
    calibration_hash: str | None
    seed: int
    joints: tuple[str, ...]
    tested: tuple[str, ...]
    versions: dict[str, str]
    runs: tuple[RunEntry, ...]

    @property
    def measured_by(self) -> tuple[str, ...]:
        """Names of the runs by which the robot was measured."""
        return tuple(run.name for run in self.runs if run.role == "measurement")

    @property
    def weight(self) -> HeldWeight | None:
        """Weight that was held in a run; None for none."""
        return next((run.weight for run in self.runs if run.weight is not None), None)


def make_manifest(
    robot: RobotConfig,
    backend: Backend,
    runs: Sequence[IdentificationRun],
    experiment: Experiment,
    calibration: Experiment | None,
    seed: int,
) -> Manifest:
    """Return the manifest of runs that are about to be made."""
    estimated = {run.joint for run in runs if run.role == "estimation"}
    swept = [run.joint for run in runs if run.role == "test" and run.joint is not None]
    return Manifest(
        format=FORMAT,
        robot=robot.name,
        joint_names=robot.joint_names,
        backend=backend.uri,
        identity=backend.info.identity,
        simulated=backend.info.simulated,
        real_time=backend.real_time,
        response_delay=backend.info.response_delay,
        experiment=experiment.name,
        experiment_hash=experiment_hash(experiment),
        calibration=None if calibration is None else calibration.name,
        calibration_hash=None if calibration is None else experiment_hash(calibration),
        seed=seed,
        joints=tuple(joint for joint in swept if joint in estimated),
        tested=tuple(joint for joint in swept if joint not in estimated),
        versions={
            "pepper_driver": version("pepper-driver"),
            "numpy": version("numpy"),
            "mujoco": version("mujoco"),
            "python": platform.python_version(),
        },
        runs=tuple(
            RunEntry(
                name=run.name,
                joint=run.joint,
                role=run.role,
                stiffness=run.stiffness,
                seed=run.seed,
                seconds=run.seconds,
                weight=run.weight,
            )
            for run in runs
        ),
    )


def experiment_hash(experiment: Experiment) -> str:
    """Hash of what an experiment makes the robot do: not of its description, nor of where the file lies."""
    content = {k: v for k, v in asdict(experiment).items() if k not in ("source", "description")}
    return content_hash(content)


def recording_path(folder: Path, name: str) -> Path:
    """Return the file of a run."""
    return folder / f"{name}{SUFFIX}"


def open_folder(folder: Path, manifest: Manifest) -> None:
    """Make the folder, or see that it was made for the same runs: then those that are there need not be made again.

    Raises:
        RecordingFolderError: It holds other things, or recordings of another robot or made with other arguments.
        OutputError: It cannot be made.
    """
    if not (folder / MANIFEST).exists():
        if folder.is_dir() and any(folder.glob(f"*{SUFFIX}")):
            raise RecordingFolderError(
                f"{folder}: holds recordings without a {MANIFEST}, so their robot is unknown; take another folder"
            )
        make_folder(folder)
        write_json(folder / MANIFEST, asdict(manifest))
        return
    there = read_manifest(folder)
    compared = dict(_COMPARED)
    if there.real_time:
        del compared["backend"]  # such a robot has an identity; its address may change
    if difference := first_difference(there, manifest, compared):
        raise RecordingFolderError(f"{folder}: these recordings were made {difference}; {_AGAIN}")
    make_folder(folder)


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest in a folder.

    Raises:
        RecordingFolderError: In one line: file, reason, remedy.
    """
    path = folder / MANIFEST
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise ValueError("it is no mapping")
        return parse(Manifest, data, str(path))
    except FileNotFoundError:
        raise RecordingFolderError(
            f"{folder}: no recordings there (no {MANIFEST}); record with 'pepper identify --recordings {folder}'"
        ) from None
    except OSError as error:
        raise RecordingFolderError(f"{path}: cannot be read ({reason(error)})") from error
    except ConfigError as error:
        raise RecordingFolderError(f"{error}; record again into another folder") from error
    except (ValueError, RecursionError) as error:
        raise RecordingFolderError(
            f"{path}: damaged: {error}; record again into another folder"
        ) from error


def finished(folder: Path, names: Sequence[str]) -> tuple[str, ...]:
    """Return the runs that have a recording."""
    return tuple(name for name in names if recording_path(folder, name).exists())


def set_damaged_aside(folder: Path, names: Sequence[str], robot: RobotConfig) -> None:
    """Give recordings that cannot be read another name: then their runs are made again. A warning names each.

    Raises:
        OutputError: One cannot be renamed.
    """
    for name in finished(folder, names):
        path = recording_path(folder, name)
        try:
            Recording.load(path, robot)
        except RecordingError as error:
            kept = set_aside(path)
            found = str(error).partition("; ")[0]
            logger.warning("%s; it is kept as %s, and the run is made again", found, kept)


def load_measurement(folder: Path, robot: RobotConfig) -> dict[str, Recording]:
    """Return by experiment the runs by which the robot was measured; empty for none.

    Raises:
        RecordingError: A file is missing or damaged.
    """
    return {
        run.name.rpartition("-")[0]: Recording.load(recording_path(folder, run.name), robot)
        for run in read_manifest(folder).runs
        if run.role == "measurement"
    }


def load_recordings(folder: Path, robot: RobotConfig) -> IdentificationDataset:
    """Return the recordings of an identification that is complete.

    Raises:
        RecordingFolderError: Runs are missing, or they are of another robot.
        RecordingError: A file is damaged.
    """
    manifest = read_manifest(folder)
    if (manifest.robot, manifest.joint_names) != (robot.name, robot.joint_names):
        raise RecordingFolderError(
            f"{folder}: recordings of robot '{manifest.robot}', not of '{robot.name}' as it is described here"
        )
    names = [run.name for run in manifest.runs]
    there = finished(folder, names)
    if len(there) < len(names):
        missing = [name for name in names if name not in there]
        raise RecordingFolderError(
            f"{folder}: {len(missing)} of {len(names)} runs are missing, the first is {missing[0]}; the command that "
            "began them continues"
        )
    runs = {
        run.name: Recording.load(recording_path(folder, run.name), robot)
        for run in manifest.runs
        if run.role != "measurement"
    }
    swept = (*manifest.joints, *manifest.tested)
    return IdentificationDataset(
        sweeps=tuple(
            JointDataset(
                joint=joint,
                estimation=_of(manifest, runs, joint, "estimation"),
                test=_of(manifest, runs, joint, "test")[0],
            )
            for joint in swept
        ),
        calibration=_of(manifest, runs, None, "calibration"),
        measurement=load_measurement(folder, robot),
    )


def _of(
    manifest: Manifest, runs: dict[str, Recording], joint: str | None, role: Role
) -> tuple[Recording, ...]:
    return tuple(runs[run.name] for run in manifest.runs if (run.joint, run.role) == (joint, role))
