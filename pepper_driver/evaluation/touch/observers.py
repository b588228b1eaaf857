"""Observers that the judge compares on one robot, each with models of that robot, and their walk over one take."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from pepper_driver.backends import with_query
from pepper_driver.config import (
    ObserverSettings,
    PepperError,
    RobotConfig,
    load_observer_settings,
)
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.errors import ArgumentError, check_name
from pepper_driver.config.evaluation_baselines import (
    STATIC_BASELINES,
    EvaluationBaselines,
    load_evaluation_baselines,
)
from pepper_driver.controller import Tick
from pepper_driver.evaluation.observers_under_test import (
    ORACLE,
    PAPER_THRESHOLD,
    OracleObserver,
    untouched_error,
)
from pepper_driver.evaluation.quiet import quiet
from pepper_driver.evaluation.touch.records import (
    MIN_RISE,
    ForceEstimate,
    ObserverRecord,
    TorqueEstimate,
    Touched,
)
from pepper_driver.evaluation.touch.scoring import reported_events
from pepper_driver.observer import (
    CartTree,
    Contact,
    ContactObserver,
    FusionModel,
    ModelFileError,
    ModelSet,
    Observer,
    Recording,
)
from pepper_driver.observer.contact_observer import ObserverParts
from pepper_driver.observer.detection.chain_isolation import ChainTrackers
from pepper_driver.observer.residuals.fusion import FusionParts

# -- names ------------------------------------------------------------------------------------------------------------

FUSION = "fusion"

MATCHED = "@matched"
"""Ending of a baseline whose threshold gives the false contacts of ``fusion`` on the development suites."""

MOMENTUM_ADAPTIVE = "momentum-adaptive"

BASELINES = (
    *STATIC_BASELINES,
    *(f"{name}{MATCHED}" for name in STATIC_BASELINES),
    MOMENTUM_ADAPTIVE,
    ORACLE,
)

ABLATIONS = tuple(
    f"{FUSION}-without-{part}"
    for part in (
        "model",
        "current",
        "law",
        "bias",
        "loads",
        "adaptation",
        "limbs",
        "base",
        "confirmation",
        "isolation",
    )
)

OBSERVERS = (FUSION, *BASELINES, *ABLATIONS)

DEFAULT = (FUSION, *(name for name in BASELINES if name != ORACLE))
"""Observers of each take. The oracle costs a simulation of it; ablations are for the development suites."""

DEVELOPMENT = (FUSION, "momentum", f"momentum{MATCHED}", "paper-affine", f"paper-affine{MATCHED}")
"""Observers of a development split, which is judged more often."""

# -- making -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ModelFiles:
    """Model files of one robot, by their kind; None where it has none of this kind."""

    fusion: Path
    affine: Path | None = None
    cart: Path | None = None


def oracle_uri(plant: str, draw: int | None = None, day: int | None = None) -> str:
    """Return the URI of a simulated robot for its oracle: the robot itself, also where it is a draw."""
    return with_query("mujoco", plant=plant, draw=draw, day=day)


def make(
    name: str,
    robot: RobotConfig,
    models: ModelFiles,
    *,
    baselines: EvaluationBaselines | None = None,
    recording: Recording | None = None,
    uri: str | None = None,
) -> Observer:
    """Make an observer of this robot.

    Args:
        name: One of OBSERVERS; a static baseline also as ``NAME@FACTOR``, its threshold times any factor.
        robot: Its description.
        models: Files of its own models.
        baselines: Factors of the baselines ``@matched``; None for the shipped ones.
        recording: Take that the oracle foresees; others do not need it.
        uri: Simulated robot of this take: plant, draw and day. Its noise does not matter, its world is left out.

    Raises:
        UnknownNameError: No observer of this name.
        ModelFileError: A file is damaged, missing, of another kind, or of another robot.
        ArgumentError: The oracle has no take.
        HeldOutDrawError: The oracle's robot is a draw for tests, and these are not allowed here.
        ConfigError: The factors or settings are wrong.
    """
    factor = _own_factor(name)
    if factor is None:
        check_name("observer", name, OBSERVERS)
    settings = load_observer_settings()
    if name == ORACLE:
        if recording is None or uri is None:
            raise ArgumentError("the oracle needs the recording of a take and the URI of its robot")
        untouched = with_query(uri, world=None, window=None)
        return OracleObserver(robot, untouched_error(recording, untouched, robot))
    fusion = _load(models.fusion, "fusion", robot)
    baseline = name.partition("@")[0]
    if baseline in STATIC_BASELINES:
        if factor is None:
            factor = 1.0
            if baseline != name:
                factor = (baselines or load_evaluation_baselines()).factors[baseline]
        return _static(baseline, factor, robot, models, fusion, settings)
    if name == MOMENTUM_ADAPTIVE:
        alone = ObserverParts(residual=FusionParts(model=False, limbs=False, confirmation=False))
        return ContactObserver(robot, replace(fusion, base=None), settings, parts=alone)
    return _fusion(name, robot, fusion, settings)


def check_observers(names: Iterable[str]) -> None:
    """Refuse names that are no observers.

    Raises:
        UnknownNameError: No observer of this name.
    """
    for name in names:
        if _own_factor(name) is None:
            check_name("observer", name, OBSERVERS)


def _own_factor(name: str) -> float | None:
    """Return the factor of ``NAME@FACTOR``, None of other names."""
    baseline, at, text = name.partition("@")
    if not at or baseline not in STATIC_BASELINES:
        return None
    try:
        factor = float(text)
    except ValueError:
        return None
    return factor if 0.0 < factor < math.inf else None


def _load(path: Path, kind: str, robot: RobotConfig) -> ModelSet:
    models = ModelSet.load(path, robot)
    if models.kind != kind:
        raise ModelFileError(f"{path}: these are models of kind '{models.kind}', not '{kind}'")
    return models


def _static(
    name: str,
    factor: float,
    robot: RobotConfig,
    files: ModelFiles,
    fusion: ModelSet,
    settings: ObserverSettings,
) -> Observer:
    """Return a baseline with its constant threshold times ``factor``."""
    if name == "momentum":
        scaled = _changed(fusion, lambda m: replace(m, momentum_bound=factor * m.momentum_bound))
        return ContactObserver(robot, scaled, settings, momentum=True)
    paper = replace(settings, threshold=factor * PAPER_THRESHOLD)
    if name == "error":
        nothing = replace(
            fusion, kind="cart", models=dict.fromkeys(fusion.models, constant_tree(0.0)), base=None
        )
        return ContactObserver(robot, nothing, paper)
    kind: Literal["affine", "cart"] = "affine" if name == "paper-affine" else "cart"
    path = files.affine if kind == "affine" else files.cart
    if path is None:
        raise ModelFileError(f"observer '{name}': this robot has no models of kind '{kind}'")
    trees = _load(path, kind, robot)
    if trees.identity != fusion.identity:
        raise ModelFileError(f"{path}: identified on another robot than {files.fusion}")
    return ContactObserver(robot, trees, paper)


def _fusion(
    name: str, robot: RobotConfig, models: ModelSet, settings: ObserverSettings
) -> ContactObserver:
    """Return the observer of the project, whole or without a part."""
    parts = ObserverParts()
    match name.removeprefix(FUSION).removeprefix("-without-"):
        case "model":
            parts = ObserverParts(residual=FusionParts(model=False))
        case "current":
            parts = ObserverParts(residual=FusionParts(current=False))
        case "law":
            parts = ObserverParts(residual=FusionParts(law=False))
        case "bias":
            parts = ObserverParts(residual=FusionParts(bias=False))
        case "loads":
            parts = ObserverParts(residual=FusionParts(loads=False))
        case "adaptation":  # bias, loads and spreads
            settings = replace(settings, adapt=False)
        case "limbs":
            parts = ObserverParts(residual=FusionParts(limbs=False))
        case "base":
            models = replace(models, base=None)
        case "confirmation":
            parts = ObserverParts(residual=FusionParts(confirmation=False))
        case "isolation":
            parts = ObserverParts(
                tracker=lambda robot, settings, onset, _: ChainTrackers(robot, settings, onset)
            )
    return ContactObserver(robot, models, settings, parts=parts)


def constant_tree(value: float) -> CartTree:
    """Return a tree with the same value everywhere."""
    return CartTree(feature=(-1,), threshold=(0.0,), left=(-1,), right=(-1,), value=(value,))


def _changed(models: ModelSet, change: Callable[[FusionModel], FusionModel]) -> ModelSet:
    """Return a set with the model of each joint changed."""
    joints = {
        joint: change(model)
        for joint, model in models.models.items()
        if isinstance(model, FusionModel)
    }
    return replace(models, models=joints)


# -- watching ---------------------------------------------------------------------------------------------------------

AFTER_TOUCH = 0.8
"""[s] after a release in which thresholds are not those of an untouched robot."""

THRESHOLD_STRIDE = 25
"""One tick in so many is kept of the thresholds: 0.3 s, as long as a threshold stays raised."""

MIN_TORQUE = 0.5
"""[N m] A touch turns a joint on which it puts this much."""

PLATEAU_MARGIN = 0.1
"""[s] From the rise of a force to its plateau."""

MIN_ROWS = 3
"""Ticks of a plateau with an estimate, without which it has no mean."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Selection:
    """Ticks and joints of a take that are kept of each observer.

    Attributes:
        untouched: (m,) rows whose thresholds are kept.
        place: By row, its place among them.
        joints: By plateau, touch, joint's name and index.
        plateaus: By row, those that it lies in.
        pushes: By limb, number, onset and begin of the fading [s] and force [N] of touches that rise and fade.
        true: (n, N) true torque [N m]; None where it is unknown, and there are no plateaus.
        indices: Of the joints, by their names.
    """

    untouched: IntArray
    place: dict[int, int]
    joints: tuple[tuple[int, str, int], ...]
    plateaus: dict[int, tuple[int, ...]]
    pushes: dict[str, tuple[tuple[int, float, float, float], ...]]
    true: FloatArray | None
    indices: dict[str, int]

    def true_torque(self, row: int, joint: str | None) -> float | None:
        """Return the torque that really acts on a joint in a row [N m]; None where it is unknown."""
        if self.true is None or joint is None:
            return None
        return float(self.true[row, self.indices[joint]])


class _Listener:
    """Results of one observer, tick by tick."""

    def __init__(self, observer: Observer, joints: int, selection: _Selection) -> None:
        self._observer, self._selection = observer, selection
        self._contacts: list[Contact] = []
        self._true_torques: list[float | None] = []
        self._threshold = np.empty((len(selection.untouched), joints))
        self._sums = np.zeros((len(selection.joints), 2))
        self._counts = np.zeros(len(selection.joints), dtype=np.int64)
        self._forces: dict[int, ForceEstimate] = {}
        self.failure = ""

    def reset(self) -> None:
        self._guard(self._observer.reset)

    def step(self, row: int, tick: Tick) -> None:
        """Show the observer a tick; do nothing after a failure."""
        if not self.failure:
            self._guard(lambda: self._step(row, tick))

    def _guard(self, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception as error:  # an observer that fails must not cost the others
            text = " ".join(str(error).split())
            known = isinstance(error, PepperError)
            self.failure = text if known and text else f"{type(error).__name__}: {text}"

    def _step(self, row: int, tick: Tick) -> None:
        observation = self._observer.step(tick)
        now = tick.measurement.time
        # An end carries the time at which the residual fell, and a callback gets it later.
        for contact in observation.contacts:
            self._contacts.append(replace(contact, time=now))
            self._true_torques.append(self._selection.true_torque(row, contact.joint))
            self._keep_force(contact, now)
        if (place := self._selection.place.get(row)) is not None:
            self._threshold[place] = observation.threshold
        for plateau in self._selection.plateaus.get(row, ()):
            joint = self._selection.joints[plateau][2]
            estimate = observation.torque[joint]
            if np.isfinite(estimate) and self._selection.true is not None:
                self._sums[plateau] += self._selection.true[row, joint], estimate
                self._counts[plateau] += 1

    def _keep_force(self, contact: Contact, now: float) -> None:
        """Keep the force of an event as the last one reported of the touches that act on its limb."""
        size, interval = contact.force_size, contact.force_interval
        if contact.phase == "end" or size is None or interval is None:
            return
        for touch, onset, fading, force in self._selection.pushes.get(contact.limb, ()):
            if onset <= now <= fading:
                self._forces[touch] = ForceEstimate(
                    touch=touch,
                    true=force,
                    estimate=size,
                    low=interval[0],
                    high=interval[1],
                    scale_known=bool(contact.scale_known),
                )

    def record(self, robot: RobotConfig) -> ObserverRecord:
        """Return what the observer reported; only its failure if it failed."""
        found: list[ObserverRecord] = []
        if not self.failure:
            self._guard(lambda: found.append(self._record(robot)))
        return found[0] if found else ObserverRecord(failure=self.failure)

    def _record(self, robot: RobotConfig) -> ObserverRecord:
        torques = [
            TorqueEstimate(touch=touch, joint=joint, true=true / count, estimate=estimate / count)
            for (touch, joint, _), (true, estimate), count in zip(
                self._selection.joints, self._sums.tolist(), self._counts.tolist(), strict=True
            )
            if count >= MIN_ROWS
        ]
        return ObserverRecord(
            events=reported_events(self._contacts, self._true_torques),
            torques=tuple(torques),
            forces=tuple(self._forces[touch] for touch in sorted(self._forces)),
            threshold_deg=self._medians(robot),
        )

    def _medians(self, robot: RobotConfig) -> dict[str, float]:
        """Return the median threshold of each joint that was not blind all the time [deg]."""
        known = np.isfinite(self._threshold)
        return {
            name: float(np.degrees(np.median(self._threshold[known[:, joint], joint])))
            for joint, name in enumerate(robot.joint_names)
            if known[:, joint].any()
        }


def watch_all(
    observers: Mapping[str, Observer],
    recording: Recording,
    touches: Sequence[Touched],
    robot: RobotConfig,
    *,
    true_torque: FloatArray | None = None,
    warn: bool = False,
) -> dict[str, ObserverRecord]:
    """Reset the observers, and show them all each tick of a take, once.

    Torques are means over the plateau of a touch: from PLATEAU_MARGIN after its rise until its fall begins, which is
    taken to last as long as the rise. Forces are those of the last event on the limb of a touch before its fall begins:
    a program has these then.

    Args:
        observers: By name.
        recording: n ticks of N joints.
        touches: Touches of the take, by its clock.
        robot: Its description.
        true_torque: (n, N) external torque that really acted [N m]; None where it is unknown.
        warn: Whether observers may warn in the log, as of worn joints: simulated ones are worn on purpose.

    Returns:
        By name, what each reported. One that raised has only its failure; the others go on.

    Raises:
        ArgumentError: ``true_torque`` is not of this recording.
        RecordingError: The recording is of another robot.
    """
    recording.check_robot(robot)
    if true_torque is not None and true_torque.shape != recording.position.shape:
        raise ArgumentError(
            f"true torques of shape {true_torque.shape} for a recording of {recording.position.shape}"
        )
    selection = _select(recording, touches, robot, true_torque)
    listeners = {
        name: _Listener(observer, len(robot.joint_names), selection)
        for name, observer in observers.items()
    }
    with nullcontext() if warn else quiet("pepper_driver.observer"):
        for listener in listeners.values():
            listener.reset()
        for row, tick in enumerate(recording.ticks()):
            for listener in listeners.values():
                listener.step(row, tick)
    return {name: listener.record(robot) for name, listener in listeners.items()}


def _select(
    recording: Recording,
    touches: Sequence[Touched],
    robot: RobotConfig,
    true_torque: FloatArray | None,
) -> _Selection:
    time = recording.time
    touched = np.zeros(len(time), dtype=np.bool_)
    joints: list[tuple[int, str, int]] = []
    plateaus: dict[int, tuple[int, ...]] = {}
    pushes: dict[str, tuple[tuple[int, float, float, float], ...]] = {}
    for number, touch in enumerate(touches):
        touched |= (time >= touch.onset) & (time <= touch.release + AFTER_TOUCH)
        if touch.force is not None and touch.fading is not None:
            push = (number, touch.onset, touch.fading, touch.force)
            pushes[touch.limb] = (*pushes.get(touch.limb, ()), push)
        if true_torque is None:
            continue
        rise = max(touch.rise or 0.0, MIN_RISE)
        first, last = touch.onset + rise + PLATEAU_MARGIN, touch.release - rise
        rows = np.flatnonzero((time >= first) & (time <= last)).tolist()
        for joint, torque in touch.torque.items():
            if abs(torque) >= MIN_TORQUE:
                joints.append((number, joint, robot.joint_index(joint)))
                for row in rows:
                    plateaus[row] = (*plateaus.get(row, ()), len(joints) - 1)
    untouched = np.flatnonzero(~touched)[::THRESHOLD_STRIDE]
    return _Selection(
        untouched=untouched,
        place={row: place for place, row in enumerate(untouched.tolist())},
        joints=tuple(joints),
        plateaus=plateaus,
        pushes=pushes,
        true=true_torque,
        indices={name: i for i, name in enumerate(robot.joint_names)},
    )
