"""Who is evaluated: observers by name, the paper's beside the baselines, each with the models it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlencode

from pepper_driver.config import (
    PepperError,
    RobotConfig,
    RobotIdentity,
    UnknownNameError,
    load_observer_settings,
    load_plant,
    plant_hash,
)
from pepper_driver.evaluation.oracle import OracleObserver, untouched_error
from pepper_driver.evaluation.takes import Take
from pepper_driver.observer import (
    TREE_TYPES,
    ContactObserver,
    ModelFileError,
    ModelSet,
    Observer,
    TreeKind,
)
from pepper_driver.observer.models.model_file import ModelKind
from pepper_driver.observers import find_models, make_observer

ORACLE = "oracle"
TREES: dict[str, TreeKind] = {f"paper-{kind}": kind for kind in TREE_TYPES}
"""The paper's observer by the kind of its trees."""
DEFAULTS = ("fusion", "paper", *TREES, "momentum", ORACLE)
ORACLE_SUITES = ("fit", "paper")
"""The oracle costs a simulation for each take: elsewhere only when it is asked for."""
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
class Contestants:
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
        """Who takes part in a suite."""
        oracle = suite in ORACLE_SUITES or self.oracle_everywhere
        return tuple(mode for mode in self.modes if mode != ORACLE or oracle)

    def observer(self, mode: str, take: Take, robot: RobotConfig) -> Observer:
        """A new observer for one take, with models of the robot that the take's differs from.

        Raises:
            PepperError: There are no such models; the oracle cannot simulate a recording.
        """
        if mode == ORACLE:
            return OracleObserver(robot, untouched_error(take.recording, _oracle_uri(take), robot))
        if recorded := take.plant == RECORDED:
            own = RobotIdentity(name=take.experiment, identity=take.identity)
            identities = (own, *take.parents)
        else:
            identities = (_identity(reference_plant(take.plant, robot), robot),)
        shared = take.suite == SHARED_SUITE
        return _make(mode, robot, identities, self.files, strict=recorded, shared=shared)


def reference_plant(plant: str, robot: RobotConfig) -> str:
    """The plant whose models are used on another one: they are of one kind of board."""
    integral = any(drive.ki for drive in load_plant(plant, robot).actuators)
    return _REFERENCES[int(integral)]


def contestants(
    modes: Sequence[str] | None, models: Sequence[Path], robot: RobotConfig
) -> Contestants:
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
    wanted = tuple(
        dict.fromkeys(f"paper-{settings.tree}" if m == "paper" else m for m in modes or DEFAULTS)
    )
    there, notes = [], []
    for mode in wanted:
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
    return Contestants(
        modes=tuple(there),
        files=files,
        oracle_everywhere=bool(modes) and ORACLE in wanted,
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

    A file of a robot that is none of the reference plants stands for them too, unless ``strict``.
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
    """The same set with one model for all joints with a motor of the same type: that of the first of them."""
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


def _oracle_uri(take: Take) -> str:
    """The plant of a take; of one that was drawn, the one it was drawn from, since nobody knows which it is."""
    if take.plant == RECORDED:
        raise ModelFileError("the oracle knows simulated robots only")
    plant = take.plant if take.draw is None else _REFERENCES[0]
    return f"mujoco://?{urlencode({'plant': plant})}"
