"""The contact observer: residual, threshold, isolation and events of one mode, which its models determine."""

from __future__ import annotations

import json
import logging
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import ObserverSettings, RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.errors import ArgumentError
from pepper_driver.config.kernels import kernel
from pepper_driver.config.robot import TRUNK
from pepper_driver.config.self_collision import load_self_collision
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.detection.body_isolation import BodyTracker
from pepper_driver.observer.detection.chain_isolation import ChainTrackers
from pepper_driver.observer.detection.contact_force import ForceEstimator
from pepper_driver.observer.detection.excursions import Onset, ResidualHistory
from pepper_driver.observer.detection.threshold import SLIDING
from pepper_driver.observer.interface import (
    Contact,
    HandLoad,
    JointState,
    Observation,
    Observer,
    ResidualGenerator,
    Residuals,
)
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.model_file import ModelSet, predict_recording
from pepper_driver.observer.models.tree import AffineTree, CartTree
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.fusion import FusionGenerator, FusionParts
from pepper_driver.observer.residuals.hand_loads import HandLoads
from pepper_driver.observer.residuals.mobile_base import BaseGenerator
from pepper_driver.observer.residuals.momentum import MomentumGenerator
from pepper_driver.observer.residuals.paper import PaperGenerator
from pepper_driver.observer.residuals.torque_scale import TorqueScale

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ONSET_LOOKBACK = 0.5
"""[s] before the median window; the onset of a touch that grows more slowly is reported too late."""

MAX_SPREAD = np.radians(3.0)
"""[rad] Identified spread while sliding beyond which a joint never shows a touch: recorded wrists have 5 deg."""

WEAR_PERIOD = 2500
"""Ticks between two checks for worn joints: half a minute."""

LONG_CONTACT_RATIO = 0.5
"""Fraction of WEAR_PERIOD in which a limb is in contact, from which on this is worth a warning."""

UNIT_PERIOD = 250
"""Ticks between two checks for values of the inertial unit: three seconds."""

LOG = logging.getLogger(__name__)


@kernel
def _have_sizes(
    joints: int,
    wheels: int,
    limited: BoolArray,
    sent_position: FloatArray,
    stiffness: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    load_torque: FloatArray,
    position: FloatArray,
    current: FloatArray,
    sent_wheel_speed: FloatArray,
    wheel_speed: FloatArray,
    linear_acceleration: FloatArray,
    angular_velocity: FloatArray,
) -> bool:
    """Return True if the arrays of a tick have the right sizes: other kernels do not look at them."""
    commanded = len(limited) == len(sent_position) == len(stiffness) == joints
    desired = len(velocity) == len(acceleration) == len(load_torque) == joints
    measured = len(position) == len(current) == joints
    driven = len(sent_wheel_speed) == len(wheel_speed) == wheels
    inertial = len(linear_acceleration) == len(angular_velocity) == 3
    return commanded and desired and measured and driven and inertial


@kernel
def _count_quiet(residual: FloatArray, threshold: FloatArray, doubtful: BoolArray) -> int:
    """Count the joints within their thresholds; those that are blind or doubtful are not."""
    count = 0
    for j in range(len(residual)):
        count += abs(residual[j]) <= threshold[j] and not doubtful[j]  # NaN compares as False
    return count


class Tracker(Protocol):
    """Stage that derives events from residuals."""

    @property
    def idle(self) -> bool:
        """True if a step with all residuals within their thresholds would change nothing."""
        ...

    def step(
        self,
        time: float,
        residuals: Residuals,
        position: FloatArray,
        state: list[JointState],
        settled: list[bool],
    ) -> Sequence[Contact]:
        """Take in one tick at ``time`` [s] and measured ``position`` (n,) [rad].

        It sets (n,) states, and ``settled`` where a contact has just ended.
        """
        ...

    def reset(self) -> None:
        """Forget everything; contacts are counted from 1 again."""
        ...


@dataclass(frozen=True, kw_only=True)
class ObserverParts:
    """Stages of mode ``fusion`` that can be left out or replaced, to compare it with itself; by default all are there.

    Attributes:
        residual: Parts of the residual.
        tracker: Function that makes the tracker.
    """

    residual: FusionParts = field(default_factory=FusionParts)
    tracker: Callable[[RobotConfig, ObserverSettings, Onset, ForceEstimator], Tracker] = BodyTracker


class ContactObserver(Observer):
    """Observer of contacts: mode ``paper`` with trees, modes ``fusion`` and ``momentum`` with fusion models.

    The stages are the same: a generator computes residuals and thresholds of ticks (:class:`PaperGenerator`,
    :class:`FusionGenerator`, :class:`MomentumGenerator`), a tracker derives events from them (:class:`ChainTrackers`,
    for fusion :class:`BodyTracker`). A joint that cannot be judged is BLIND: its values are NaN, and it takes part in
    no contact. A joint is DOUBTFUL (mode ``fusion``) if it rests off its place and its motor does not work against
    that, or if its identified spread is beyond MAX_SPREAD; in the latter case it takes part in no contact either.

    Args:
        robot: Description of the robot.
        models: Models of its joints; those that have none stay blind.
        settings: Filter, threshold and times.
        momentum: True to use only the momentum channel of fusion models: the baseline ``momentum``.
        parts: Stages of mode ``fusion``; the others ignore it.

    Raises:
        ModelFileError: The models are of another robot.
    """

    def __init__(
        self,
        robot: RobotConfig,
        models: ModelSet,
        settings: ObserverSettings,
        *,
        momentum: bool = False,
        parts: ObserverParts = ObserverParts(),
    ) -> None:
        models.check_robot(robot)
        self._models, self._robot, self._settings = models, robot, settings
        self._mode = "paper" if models.kind != "fusion" else "momentum" if momentum else "fusion"
        fusion = _fusion_models(robot, models)
        scale = TorqueScale.from_models(fusion, robot, models.measured)
        self._loads: HandLoads | None = None
        if self._mode == "fusion" and settings.adapt and parts.residual.loads:
            gain = [np.nan if model is None else model.twin.load_gain for model in fusion]
            self._loads = HandLoads(robot, np.array(gain))
        self._generator, window = _make_generator(
            self._mode, robot, models, fusion, scale, self._loads, settings, parts
        )
        lookback = math.ceil(ONSET_LOOKBACK / robot.cycle)
        self._history = ResidualHistory(window, lookback, len(robot.joint_names))
        self._tracker: Tracker
        if self._mode == "fusion":
            forces = ForceEstimator(robot, load_self_collision(robot), scale)
            self._tracker = parts.tracker(robot, settings, self._history.onset, forces)
        else:
            self._tracker = ChainTrackers(robot, settings, self._history.onset)
        no_model = self._generator.no_model
        self._resting_state = np.where(no_model, JointState.BLIND, JointState.FREE).astype(np.int8)
        self._numb = [robot.joint_index(name) for name in numb_joints(models)]
        self._resting_state[self._numb] = JointState.DOUBTFUL
        for name in numb_joints(models):
            LOG.warning(
                "%s detects nothing: its residual in free motion is beyond %.0f deg, which hardly any touch reaches",
                name,
                np.degrees(MAX_SPREAD),
            )
        self._count_quiet = _count_quiet.load_unchecked()
        self._known = ~no_model
        self._known_count = np.count_nonzero(self._known)
        self._none_settled = np.zeros(len(no_model), dtype=np.bool_)
        self._window = window
        self._have_sizes = _have_sizes.load()
        self._sizes = len(robot.joint_names), len(robot.wheels.names)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models; contacts are counted from 1 again."""
        self._time = 0.0
        self._ticks = 0
        self._worn: tuple[str, ...] = ()
        self._unit_reported = False
        # By number, the limbs of contacts that last; by limb, ticks of contact since the last check.
        self._lasting: dict[int, str] = {}
        self._contact_ticks: Counter[str] = Counter()
        self._long_touched: set[str] = set()
        self._doubted = np.zeros(len(self._none_settled), dtype=np.bool_)
        self._generator.reset()
        self._history.reset()
        self._tracker.reset()

    @property
    def models(self) -> ModelSet:
        """Models of the robot."""
        return self._models

    def describe(self) -> str:
        """Return one line: mode, models, thresholds."""
        known = np.degrees(self._generator.bounds[~self._generator.no_model])
        what = f"{self._models.kind} {'trees' if self._mode == 'paper' else 'models'}"
        # There is none if each model is of a joint that detects nothing.
        bounds = f"threshold {known.min():.2f} to {known.max():.2f} deg" if len(known) else "blind"
        base, lack = self._models.base, ""
        if self._mode == "fusion" and base is None:
            lack = "; base not known"
        elif self._mode == "fusion" and base is not None and not base.has_inertial_unit:
            lack = "; base without inertial unit"
        return (
            f"{self._mode}: {what} of {len(self._models.models)} joints, identified on "
            f"{self._models.identity}; median of {self._window}, {bounds}{lack}"
        )

    def provenance(self) -> dict[str, str]:
        """Return mode, models and settings; ``models_sha256`` is the hash of the file that ``ModelSet.save`` writes."""
        return {
            "mode": self._mode,
            "models": f"{self._models.kind}, identified on {self._models.identity}",
            "models_sha256": self._models.sha256(),
            # Sorted, so that equal settings give equal text.
            "settings": json.dumps(asdict(self._settings), sort_keys=True),
        }

    @property
    def worn(self) -> tuple[str, ...]:
        """Joints that this session shows to be worn since their identification; mode ``fusion`` only."""
        return self._worn

    @property
    def hand_loads(self) -> dict[str, HandLoad]:
        """Load of each hand that no model knows, by the name of its arm.

        Mode ``fusion`` estimates it while the arm moves without touch; others, and one that does not adapt, have none.
        """
        return {} if self._loads is None else self._loads.by_limb

    def _check_wear(self) -> None:
        """Warn once a session about each joint that has worn."""
        names = self._robot.joint_names
        found = (names[joint] for joint in np.flatnonzero(self._generator.worn))
        fresh = tuple(name for name in found if name not in self._worn)
        self._worn += fresh
        for name in fresh:
            LOG.warning(
                "%s has worn since its model was identified: it turns much harder. Its thresholds are wider; "
                "identify it again with 'pepper identify'",
                name,
            )

    def _count_contacts(self, contacts: Sequence[Contact]) -> None:
        """Count the ticks in which each limb is in contact."""
        for contact in contacts:
            if contact.phase == "end" or contact.kind == "rebound":
                self._lasting.pop(contact.id, None)
            else:
                self._lasting[contact.id] = contact.limb
        self._contact_ticks.update(self._lasting.values())

    def _check_contacts(self) -> None:
        """Warn once a session about each limb that is in contact most of the time."""
        ticks, self._contact_ticks = self._contact_ticks, Counter()
        for limb, count in ticks.items():
            if count > LONG_CONTACT_RATIO * WEAR_PERIOD and limb not in self._long_touched:
                self._long_touched.add(limb)
                LOG.warning(
                    "%s was in contact for most of half a minute. If nothing touches it, it carries a load that its "
                    "models do not know, or they are of another robot; meanwhile the observer learns nothing of today",
                    limb,
                )

    def _check_unit(self) -> None:
        """Warn once a session about an inertial unit that gives no values."""
        if self._generator.misses_inertial_unit and not self._unit_reported:
            self._unit_reported = True
            LOG.warning(
                "the inertial unit gives no values, or always the same: pushes on trunk and base show in wheels and "
                "legs alone"
            )

    def _report_doubt(self, doubtful: BoolArray) -> None:
        """Report once a session each joint that is in doubt."""
        for joint in np.flatnonzero(doubtful & ~self._doubted):
            LOG.info(
                "%s is doubtful: it rests off its place, and its motor does not work against that",
                self._robot.joint_names[joint],
            )
        self._doubted |= doubtful

    def predict(self, joint: str, recording: Recording) -> FloatArray:
        """Predict the (n,) tracking error of a joint over a run [rad], without its measurements; NaN if unknown.

        In mode ``fusion`` ``Observation.expected`` is more accurate: it follows the positions in which joints rest.
        """
        model = self._models.models.get(joint)
        if model is None or self._mode == "momentum":
            return np.full(len(recording), np.nan)
        return predict_recording(model, joint, recording)

    def step(self, tick: Tick) -> Observation:
        """Take in one tick; never raises for bad sensor values.

        Raises:
            ArgumentError: An array of the tick has not one value for each joint, wheel or axis.
        """
        try:
            fits = self._fits(tick)
        except TypeError:  # arrays that other programs made may have gaps, or another type
            tick = _contiguous(tick)
            fits = self._fits(tick)
        if not fits:
            joints, wheels = self._sizes
            sizes = (joints,) * 8 + (wheels,) * 2 + (3,) * 2
            raise ArgumentError(f"a tick has arrays of {_sizes(tick)}, not of {sizes} values")
        # Events must stay in order when the clock of the robot jumps back, or is not finite after a lost connection.
        if self._time < tick.measurement.time < math.inf:
            self._time = tick.measurement.time
        residuals = self._generator.step(tick)
        self._history.append(self._time, residuals.raw, residuals.base_raw)
        contacts, state, free, settled = self._events(residuals, tick.measurement.position)
        self._generator.learn(free, settled, self._tracker.idle)
        self._ticks += 1
        if contacts or self._lasting:
            self._count_contacts(contacts)
        if self._ticks % WEAR_PERIOD == 0:
            self._check_wear()
            self._check_contacts()
        if self._ticks % UNIT_PERIOD == 0:
            self._check_unit()
        return Observation(
            contacts=tuple(contacts),
            expected=residuals.expected,
            residual=residuals.residual,
            threshold=residuals.threshold,
            torque=residuals.torque,
            torque_std=residuals.torque_std,
            state=state,
        )

    def _fits(self, tick: Tick) -> bool:
        """Return True if the arrays of a tick have the right sizes; raises TypeError if kernels do not take them."""
        sent, measurement, reference = tick.sent, tick.measurement, tick.reference
        joints, wheels = self._sizes
        return self._have_sizes(
            joints,
            wheels,
            tick.limited,
            sent.position,
            sent.stiffness,
            reference.velocity,
            reference.acceleration,
            reference.load_torque,
            measurement.position,
            measurement.current,
            sent.wheel_speed,
            measurement.wheel_speed,
            measurement.imu.acceleration,
            measurement.imu.angular_velocity,
        )

    def _events(
        self, residuals: Residuals, position: FloatArray
    ) -> tuple[Sequence[Contact], NDArray[np.int8], BoolArray, BoolArray]:
        """Return the events of this tick; (n,) states; joints without touch; joints that were just released."""
        no_model, doubtful = self._generator.no_model, residuals.doubtful
        quiet = self._count_quiet(residuals.residual, residuals.threshold, doubtful)
        # Most ticks end here, which saves the state machines of all joints.
        all_quiet = quiet == self._known_count and not abs(residuals.base_residual) > 1.0
        if all_quiet and self._tracker.idle:
            return (), self._resting_state.copy(), self._known, self._none_settled
        n = len(no_model)
        states, settled = [JointState.BLIND] * n, [False] * n
        contacts = self._tracker.step(self._time, residuals, position, states, settled)
        # Of bytes: an array of a list of enumeration members takes three times as long.
        state = np.frombuffer(bytearray(states), dtype=np.int8)
        state[self._numb] = JointState.DOUBTFUL
        # A contact on a joint counts for more: its limb may have found it by several small residuals.
        doubted = doubtful & (state == JointState.FREE)
        if np.count_nonzero(doubted):
            state[doubted] = JointState.DOUBTFUL
            self._report_doubt(doubted)
        ended = np.array(settled) if any(settled) else self._none_settled
        return contacts, state, state == JointState.FREE, ended


def _sizes(tick: Tick) -> tuple[int, ...]:
    """Return the sizes of the arrays of a tick."""
    sent, measurement, reference = tick.sent, tick.measurement, tick.reference
    return (
        len(tick.limited),
        len(sent.position),
        len(sent.stiffness),
        len(reference.velocity),
        len(reference.acceleration),
        len(reference.load_torque),
        len(measurement.position),
        len(measurement.current),
        len(sent.wheel_speed),
        len(measurement.wheel_speed),
        len(measurement.imu.acceleration),
        len(measurement.imu.angular_velocity),
    )


def _contiguous(tick: Tick) -> Tick:
    """Return a tick whose arrays are as kernels take them."""
    sent = _with_floats(tick.sent, "position", "stiffness", "wheel_speed")
    imu = _with_floats(tick.measurement.imu, "acceleration", "angular_velocity")
    return replace(
        tick,
        limited=np.ascontiguousarray(tick.limited, np.bool_),
        sent=sent,
        reference=_with_floats(tick.reference, "velocity", "acceleration", "load_torque"),
        measurement=replace(
            _with_floats(tick.measurement, "position", "current", "wheel_speed"), imu=imu
        ),
    )


T = TypeVar("T", bound="DataclassInstance")


def _with_floats(part: T, *names: str) -> T:
    """Return a part of a tick with these arrays contiguous, and of floats."""
    return replace(
        part, **{name: np.ascontiguousarray(getattr(part, name), np.float64) for name in names}
    )


def numb_joints(models: ModelSet) -> tuple[str, ...]:
    """Return the joints whose identified spreads are so large that they never show a touch; of kind ``fusion``."""
    return tuple(
        name
        for name, model in models.models.items()
        if isinstance(model, FusionModel) and model.spread[SLIDING] > MAX_SPREAD
    )


def limb_numbers(robot: RobotConfig) -> IntArray:
    """Return (n,) the number of the limb of each joint, 0 for the trunk."""
    numbers = np.empty(len(robot.joint_names), dtype=np.int64)
    order = (TRUNK, *(name for name in robot.limbs if name != TRUNK))
    for number, joints in enumerate(robot.limbs[name] for name in order):
        numbers[[robot.joint_index(joint) for joint in joints]] = number
    return numbers


def _fusion_models(robot: RobotConfig, models: ModelSet) -> list[FusionModel | None]:
    """Return the models of the joints, None for those that have none or detect nothing."""
    numb = numb_joints(models)
    found = [None if name in numb else models.models.get(name) for name in robot.joint_names]
    return [model if isinstance(model, FusionModel) else None for model in found]


def _make_generator(
    mode: str,
    robot: RobotConfig,
    models: ModelSet,
    fusion: list[FusionModel | None],
    scale: TorqueScale,
    loads: HandLoads | None,
    settings: ObserverSettings,
    parts: ObserverParts,
) -> tuple[ResidualGenerator, int]:
    """Make the residual generator for the models, and the window of its filter."""
    if mode == "momentum":
        own = np.array([np.nan if m is None else m.momentum_bound for m in fusion])
        window = settings.median_window
        return MomentumGenerator(fusion, robot.cycle, own, window), window
    if mode == "fusion":
        window = settings.fusion_window
        adapt = settings.adapt
        base = None
        if models.base is not None:
            base = BaseGenerator(
                models.base,
                robot,
                window,
                false_contacts=settings.false_contacts,
                adapt=adapt,
            )
        generator: ResidualGenerator = FusionGenerator(
            fusion,
            robot.cycle,
            window=window,
            adapt=adapt,
            false_contacts=settings.false_contacts,
            limbs=limb_numbers(robot),
            base=base,
            loads=loads,
            parts=parts.residual,
            stiffness=scale.stiffness,
            motor_torque=np.array(
                [
                    robot.motors.of(name).stall_torque * robot.motors.joints[name].ratio
                    for name in robot.joint_names
                ]
            ),
        )
        return generator, window
    of_joint = [models.models.get(name) for name in robot.joint_names]
    trees = [model if isinstance(model, CartTree | AffineTree) else None for model in of_joint]
    threshold = np.array(
        [settings.threshold or models.threshold.get(name, np.nan) for name in robot.joint_names]
    )
    return PaperGenerator(trees, threshold, settings.median_window), settings.median_window
