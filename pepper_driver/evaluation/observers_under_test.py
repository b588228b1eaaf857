"""Observers under test, with an oracle that has the free motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pepper_driver.backends import make_backend, with_query
from pepper_driver.backends.simulated import drive_along
from pepper_driver.config import (
    PepperError,
    RobotConfig,
    RobotIdentity,
    UnknownNameError,
    load_observer_settings,
    load_plant,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.observer import (
    TREE_TYPES,
    CartTree,
    ContactObserver,
    ModelFileError,
    ModelSet,
    Observation,
    Observer,
    Recording,
    TreeKind,
)
from pepper_driver.observer.models.model_file import ModelKind
from pepper_driver.observers import find_models, make_observer

PAPER_THRESHOLD = float(np.radians(2.5))

_NOTHING = CartTree(feature=(-1,), threshold=(0.0,), left=(-1,), right=(-1,), value=(0.0,))


def untouched_error(recording: Recording, uri: str, robot: RobotConfig) -> FloatArray:
    """Tracking error of the same commands on a simulated robot without touch, paired as in a tick.

    How the robot came to where the recording begins is not known: it comes there slowly and rests. The error is that
    of the joints, without noise and steps of the encoders, which are unpredictable.

    Args:
        recording: Position, stiffness and wheel speed as they were sent.
        uri: Of the simulated robot.
        robot: Its description.

    Returns:
        (n, N) position sent - true position when it was to be reached [rad].

    Raises:
        PepperError: No such backend, or its simulation diverged.
    """
    backend = make_backend(uri, robot)
    plant = backend.plant.config
    assert plant is not None  # of MuJoCo
    delay = plant.transport.command_delay
    rows = [*range(len(recording)), *[len(recording) - 1] * delay]
    with backend:
        driven = drive_along(
            backend,
            recording.sent_position[rows],
            recording.stiffness[rows],
            recording.sent_wheel_speed[rows],
            robot,
        )
        positions = [backend.truth.position.copy() for _ in driven]
    error: FloatArray = recording.sent_position - np.array(positions[delay:])
    return error


class OracleObserver(Observer):
    """Median and threshold of the paper on the residual to errors known beforehand, tick by tick of one recording.

    Args:
        robot: Description of the robot.
        expected: (n, N) from :func:`untouched_error` [rad].
    """

    def __init__(self, robot: RobotConfig, expected: FloatArray) -> None:
        nothing: dict[str, float] = dict.fromkeys(robot.joint_names, 0.0)
        models = ModelSet(
            robot=robot.name,
            joint_names=robot.joint_names,
            identity="oracle",
            kind="cart",
            cycle=robot.cycle,
            estimation_fit=nothing,
            test_fit=nothing,
            threshold=dict.fromkeys(robot.joint_names, PAPER_THRESHOLD),
            version="",
            models=dict.fromkeys(robot.joint_names, _NOTHING),
        )
        settings = load_observer_settings()
        self._watcher = ContactObserver(robot, models, settings)
        self._expected = expected
        self._row = 0

    def step(self, tick: Tick) -> Observation:
        """Episode in the next tick of the recording; the last row stands for all that come after it."""
        expected = self._expected[min(self._row, len(self._expected) - 1)]
        self._row += 1
        measurement = tick.measurement
        moved = replace(measurement, position=measurement.position + expected)
        observation = self._watcher.step(replace(tick, measurement=moved))
        blind = np.isnan(observation.expected)
        return replace(observation, expected=np.where(blind, np.nan, expected))

    def reset(self) -> None:
        """Back to the first tick."""
        self._row = 0
        self._watcher.reset()

    def describe(self) -> str:
        """One line: kind, thresholds."""
        return f"oracle: the plant itself, untouched; {self._watcher.describe()}"


ORACLE = "oracle"
TREES: dict[str, TreeKind] = {f"paper-{kind}": kind for kind in TREE_TYPES}
"""The paper's observer by the kind of its trees."""
DEFAULTS = ("fusion", "paper", *TREES, "momentum", ORACLE)
ORACLE_SUITES = ("fit", "paper")
"""The oracle costs a simulation for each episode: elsewhere only when it is asked for."""
SHARED_SUITE = "types"
"""The suite that is about models shared by type of motor."""
RECORDED = "recorded"
"""Stands for the plant of a recording."""
_REFERENCES = ("nominal", "integral")
"""The plants that models are identified on: boards that are a PD, and boards with an integral part."""


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """A model file, with what it holds."""

    path: Path
    kind: str
    identity: str


@dataclass(frozen=True, kw_only=True)
class ObserversUnderTest:
    """The observers of one evaluation.

    Attributes:
        modes: Their names.
        files: Model files in place of shipped ones.
        oracle_everywhere: Whether the oracle was asked for by name.
        notes: Who is missing, and why.
    """

    modes: tuple[str, ...]
    files: tuple[ModelFile, ...] = ()
    oracle_everywhere: bool = False
    notes: tuple[str, ...] = ()

    def of_suite(self, suite: str) -> tuple[str, ...]:
        """Return the observers that take part in a suite."""
        oracle = suite in ORACLE_SUITES or self.oracle_everywhere
        return tuple(mode for mode in self.modes if mode != ORACLE or oracle)

    def observer(self, mode: str, episode: Episode, robot: RobotConfig) -> Observer:
        """Return a new observer for one episode, with models of the robot that the episode's differs from.

        Raises:
            PepperError: There are no such models; the oracle cannot simulate a recording.
        """
        recorded = episode.plant == RECORDED
        if mode == ORACLE:
            if recorded:
                raise ModelFileError(
                    "the oracle simulates the plants of the suites, not the robot of a recording"
                )
            uri = with_query("mujoco", plant=episode.plant)
            return OracleObserver(robot, untouched_error(episode.recording, uri, robot))
        if recorded:
            own = RobotIdentity(name=episode.experiment, identity=episode.identity)
            identities = (own, *episode.parents)
        else:
            identities = (_identity(reference_plant(episode.plant, robot), robot),)
        shared = episode.suite == SHARED_SUITE
        return _make(mode, robot, identities, self.files, strict=recorded, shared=shared)


def reference_plant(plant: str, robot: RobotConfig) -> str:
    """Return the plant whose models are used on another one: they are of one kind of board."""
    integral = any(drive.ki for drive in load_plant(plant, robot).actuators)
    return _REFERENCES[int(integral)]


def contestants(
    modes: Sequence[str] | None, models: Sequence[Path], robot: RobotConfig
) -> ObserversUnderTest:
    """Check names and model files before anything is simulated.

    Args:
        modes: Names; None for all there are, those without models left out with a note.
        models: Files; each serves the observers that take its kind.
        robot: Description of the robot.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: A file is damaged or of another robot; an observer asked for by name has no models.
    """
    files = tuple(_file(path, robot) for path in models)
    settings = load_observer_settings()
    chosen = tuple(
        dict.fromkeys(f"paper-{settings.tree}" if m == "paper" else m for m in modes or DEFAULTS)
    )
    there, notes = [], []
    for mode in chosen:
        try:
            if mode != ORACLE:
                _make(mode, robot, (_identity(_REFERENCES[0], robot),), files)
        except PepperError as error:
            if modes is not None and isinstance(error, UnknownNameError):
                raise UnknownNameError("mode", mode, {*DEFAULTS, *error.choices}) from None
            if modes is not None:
                raise
            notes.append(f"{mode} is left out: {error}")
        else:
            there.append(mode)
    return ObserversUnderTest(
        modes=tuple(there),
        files=files,
        oracle_everywhere=bool(modes) and ORACLE in chosen,
        notes=tuple(notes),
    )


def _file(path: Path, robot: RobotConfig) -> ModelFile:
    models = ModelSet.load(path, robot)
    return ModelFile(path=path, kind=models.kind, identity=models.identity)


def _make(
    mode: str,
    robot: RobotConfig,
    identities: Sequence[RobotIdentity],
    files: Sequence[ModelFile],
    *,
    strict: bool = False,
    shared: bool = False,
) -> Observer:
    """Make an observer with models of the robots ``identities``, ``shared`` by type of motor if so.

    A file of a robot other than the reference plants is accepted too, unless ``strict``.
    """
    kind: ModelKind = TREES.get(mode, "fusion")
    known = [_identity(plant, robot).identity for plant in _REFERENCES]
    files = [file for file in files if file.kind == kind]
    fitting = [f for one in reversed(identities) for f in files if f.identity == one.identity]
    foreign = [f for f in files if f.identity not in known]
    if strict and foreign and not fitting:
        raise ModelFileError(
            f"{foreign[-1].path}: identified on another robot than that of '{identities[0].name}'"
        )
    file = next(iter(reversed(fitting or foreign)), None)
    path = None if file is None else file.path
    if file is not None and not fitting:
        identities = (RobotIdentity(name=str(path), identity=file.identity),)
    if mode not in TREES and not shared:
        return make_observer(mode, robot, identities, path)
    models = find_models(identities, path, kind, (kind,))
    if shared:
        models = shared_by_type(models, robot)
    if mode in TREES:
        return ContactObserver(robot, models, load_observer_settings())
    with TemporaryDirectory() as folder:
        models.save(Path(folder) / "shared.json")
        return make_observer(mode, robot, identities, Path(folder) / "shared.json")


def shared_by_type(models: ModelSet, robot: RobotConfig) -> ModelSet:
    """Return the set with one model for all joints with a motor of the same type: that of the first of them."""
    first: dict[str, str] = {}
    for joint in robot.joint_names:
        if joint in models.models:
            first.setdefault(robot.motors.joints[joint].type, joint)
    source = {joint: first[robot.motors.joints[joint].type] for joint in models.models}
    return replace(
        models,
        models={joint: models.models[other] for joint, other in source.items()},
        threshold={joint: models.threshold[other] for joint, other in source.items()},
    )


def _identity(plant: str, robot: RobotConfig) -> RobotIdentity:
    return RobotIdentity(name=plant, identity=plant_hash(load_plant(plant, robot), robot))
