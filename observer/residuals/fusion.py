"""Residuals of mode ``fusion``: stick-slip model and motor current must agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray, contiguous
from pepper_driver.config.kernels import Matrix, Out, Records, kernel
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    BIAS_TIME,
    CONFIRMING_RATIO,
    MIN_SPREAD,
    PUSH_TICKS,
    QUIET_RATIO,
    REST_SPEED,
    SETTLING_TICKS,
)
from pepper_driver.observer.detection.threshold import SpreadThreshold
from pepper_driver.observer.interface import MAX_PLAUSIBLE, MIN_OBSERVED_STIFFNESS, Residuals
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.residuals.doubt import JointDoubt
from pepper_driver.observer.residuals.hand_loads import HandLoads
from pepper_driver.observer.residuals.mobile_base import BaseGenerator
from pepper_driver.observer.residuals.momentum import (
    CurrentChannel,
    DerivativeFilter,
    ErrorDerivatives,
    current_channels,
    current_residual,
    differentiate,
)
from pepper_driver.observer.residuals.prediction import (
    MAX_LATE_TICKS,
    ErrorPredictor,
    PredictedJoint,
    Prediction,
    update_integral,
)
from pepper_driver.observer.residuals.torque_estimate import SPREAD_STDS, TorqueEstimate
from pepper_driver.observer.running_filters import RunningMedian

WORN_CHANGE = 1.95
"""Growth of the spread of a residual at which a joint counts as worn."""


@kernel
def _check_inputs(
    target: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    measured: FloatArray,
    current: FloatArray,
    stiffness: FloatArray,
    good: Out[BoolArray],
) -> int:
    """Mark the joints that can be judged; return how many."""
    count = 0
    for j in range(len(good)):
        # One sum finds NaN and infinity in any of its terms; NaN compares as False.
        inputs = abs(target[j]) + abs(load_torque[j]) + abs(velocity[j]) + abs(acceleration[j])
        inputs = inputs + abs(measured[j]) + abs(current[j])
        good[j] = inputs < MAX_PLAUSIBLE and stiffness[j] >= MIN_OBSERVED_STIFFNESS
        count += good[j]
    return count


@kernel
def _exclude_behind(
    target: FloatArray,
    board_target: FloatArray,
    carries: Matrix[BoolArray],
    good: Out[BoolArray],
) -> bool:
    """Clear ``good`` of joints whose load depends on a board that is behind its command; return True if one is."""
    behind = False
    for i in range(len(good)):
        if abs(target[i] - board_target[i]) > MIN_SPREAD:
            behind = True
            for j in range(len(good)):
                good[j] = good[j] and not carries[i, j]
    return behind


@kernel
def _combine(
    joints: Out[Records[PredictedJoint]],
    filters: Out[Records[DerivativeFilter]],
    channels: Out[Records[CurrentChannel]],
    target: FloatArray,
    board_target: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    position: FloatArray,
    friction: FloatArray,
    remainder: FloatArray,
    measured: FloatArray,
    current: FloatArray,
    bias: FloatArray,
    gain: float,
    cycle: float,
    pushed: bool,
    no_model: BoolArray,
    good: Out[BoolArray],
    change: Out[FloatArray],
    residuals: Out[FloatArray],
) -> int:
    """Compute (2 n,) residuals of both channels and the derivative of the error; return how many joints are good.

    The arguments are those of :class:`Prediction`, ``current_residual`` and ``differentiate``. Where a joint with a
    model has no residual, it is no longer ``good``.
    """
    count, n = 0, len(good)
    for j in range(n):
        joint = joints[j]
        error, board_error = target[j] - measured[j], board_target[j] - measured[j]
        change[j], curvature = differentiate(filters, j, error, gain, cycle)
        by_current, motor = current_residual(
            channels,
            j,
            current[j],
            board_error + joint.board_integral,
            velocity[j] - change[j],
            acceleration[j] - curvature,
            friction[j] + joint.load_gain * load_torque[j],
            pushed,
        )
        if good[j]:
            update_integral(joints, j, board_error, motor, cycle)
        by_model = position[j] - measured[j] - remainder[j] - bias[j]
        residuals[j] = by_model
        residuals[n + j] = by_current - bias[j] if channels[j].by_current else by_model
        good[j] = good[j] and (math.isfinite(residuals[j] + residuals[n + j]) or no_model[j])
        count += good[j]
    return count


@kernel
def _agree(filtered: FloatArray, residual: Out[FloatArray]) -> None:
    """Take the smaller of two residuals, 0 where their signs differ."""
    n = len(residual)
    for j in range(n):
        model, current = filtered[j], filtered[n + j]
        size = min(abs(model), abs(current)) if model * current > 0.0 else 0.0
        residual[j] = math.copysign(size, model)


@kernel
def _follow_hands(
    filtered: FloatArray, threshold: FloatArray, hands: Out[IntArray], residual: Out[FloatArray]
) -> None:
    """Replace the residual of touched joints by that of the current, until it has fallen.

    A board that sums up errors takes a joint back to its target while a hand still holds it: the first channel then
    shows nothing more, and after the release something that is no touch. ``hands`` has the signs of touches.
    """
    n = len(residual)
    for j in range(n):
        by_current = filtered[n + j]
        if abs(residual[j]) > threshold[j]:
            hands[j] = 1 if residual[j] > 0.0 else -1
        elif by_current * hands[j] <= QUIET_RATIO * threshold[j]:
            hands[j] = 0
        if hands[j] != 0:
            residual[j] = by_current


@kernel
def _join_limbs(
    limbs: IntArray, count: int, residual: FloatArray, threshold: Out[FloatArray]
) -> None:
    """Lower the thresholds of joints of a limb together, so that the largest ratio becomes the norm of all of them."""
    for limb in range(count):
        largest, square = 0.0, 0.0
        for j in range(len(limbs)):
            if limbs[j] == limb:
                ratio = abs(residual[j]) / threshold[j]
                if math.isfinite(ratio):
                    largest, square = max(largest, ratio), square + ratio * ratio
        if square > 0.0:
            share = largest / math.sqrt(square)
            for j in range(len(limbs)):
                if limbs[j] == limb:
                    threshold[j] *= share


@kernel
def _express(
    target: FloatArray,
    position: FloatArray,
    remainder: FloatArray,
    bias: FloatArray,
    blind: BoolArray,
    expected: Out[FloatArray],
    residual: Out[FloatArray],
    threshold: Out[FloatArray],
    torque: Out[FloatArray],
    torque_std: Out[FloatArray],
) -> None:
    """Compute the expected error; set all values of blind joints to NaN."""
    for j in range(len(expected)):
        expected[j] = target[j] - position[j] + remainder[j] + bias[j]
        if blind[j]:
            expected[j] = residual[j] = threshold[j] = torque[j] = torque_std[j] = math.nan


@kernel
def _judge(
    residual: FloatArray,
    threshold: FloatArray,
    speed: FloatArray,
    free: BoolArray,
    blind: BoolArray,
    doubtful: BoolArray,
    limited: BoolArray,
    pace: float,
    bias: Out[FloatArray],
    touched: Out[BoolArray],
    seen: Out[BoolArray],
    resting: Out[BoolArray],
    sliding: Out[BoolArray],
) -> None:
    """Mark joints that are touched, the free ones that can be judged, and which of these rest or slide; update bias."""
    for j in range(len(residual)):
        touched[j] = not (free[j] or blind[j] or doubtful[j])
        seen[j] = free[j] and not (blind[j] or limited[j])
        quiet = seen[j] and abs(residual[j]) < QUIET_RATIO * threshold[j]
        slides = abs(speed[j]) > REST_SPEED
        resting[j] = quiet and not slides
        sliding[j] = seen[j] and slides
        if quiet:
            bias[j] += pace * residual[j]


@dataclass(slots=True)
class _Detail:
    """Values of a tick, (n,) each.

    Attributes:
        prediction: Of the tick.
        measured: Position [rad].
        limited: Joints whose command the safety gate altered.
        threshold: Of each joint alone [rad].
    """

    prediction: Prediction
    measured: FloatArray
    limited: BoolArray
    threshold: FloatArray


@dataclass(frozen=True, kw_only=True)
class FusionParts:
    """Parts of the residual that can be left out, to compare it with itself; by default all are there.

    Attributes:
        model: False for the residual by the current alone, where there is one.
        current: False for the residual by the stick-slip model alone.
        limbs: False to judge each joint alone.
        confirmation: False for thresholds of limbs that a push on the base does not lower.
        bias: False for no bias.
        loads: False for hands that are taken to be empty.
    """

    model: bool = True
    current: bool = True
    limbs: bool = True
    confirmation: bool = True
    bias: bool = True
    loads: bool = True


class FusionGenerator:
    """Residual on which two channels must agree, filtered by a short running median.

    The stick-slip model shows a touch as an unexpected position, the motor current as a torque that a free motion does
    not need (:func:`current_residual`). The residual is the smaller of the two, and 0 where they contradict each other:
    a board that follows another target than the command shows in the first channel alone, a current of the wrong
    sign in the second one. Where the current does not show the torque, the model alone counts.

    A joint is blind

    - if it has no model;
    - if its stiffness is below MIN_OBSERVED_STIFFNESS;
    - if its sample is later than MAX_LATE_TICKS;
    - if a value is not finite;
    - if a board of its limb or of the trunk holds its target more than MIN_SPREAD behind the command; a joint of the
      trunk also if a board of any limb does.

    It stays blind until the median window has none of these samples. Its model then starts from the measured position.

    A joint is in doubt if its command has rested for SETTLING_TICKS and more while the first channel alone was beyond
    the threshold: it rests off its place, and its motor does not work against that. Its friction may then have any
    sign. From QUIET_RATIO of the threshold on, until the first channel is within this again, and for SETTLING_TICKS
    after it was blind, its threshold is UNSURE_FACTOR times as high.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        window: Samples of the median.
        false_contacts: That are allowed in an hour.
        adapt: True to follow bias and spread of the robot of today.
        limbs: (n,) number of the limb of each joint, 0 for the trunk; None to judge each joint alone.
        base: Residual of the base, None without a model of it.
        loads: Estimate of the loads of the hands, None for hands that are taken to be empty.
        stiffness: (n,) K of torque estimates [N m/rad]; None for that of the models, by the documented masses.
        motor_torque: (n,) largest torque of the motors, at the joints [N m].
        parts: That it has.
    """

    def __init__(
        self,
        models: Sequence[FusionModel | None],
        cycle: float,
        *,
        window: int,
        false_contacts: float,
        adapt: bool,
        limbs: IntArray | None = None,
        base: BaseGenerator | None = None,
        loads: HandLoads | None = None,
        stiffness: FloatArray | None = None,
        motor_torque: FloatArray | float = math.inf,
        parts: FusionParts = FusionParts(),
    ) -> None:
        n = len(models)
        self._parts = parts
        self._cycle, self._window, self._adapt = cycle, window, adapt
        self._base = base
        self._predictor = ErrorPredictor(models, cycle)
        self._channels = current_channels(models)
        self._derivatives = ErrorDerivatives(n, cycle)
        self.no_model = np.array([m is None for m in models])
        spread = np.array([(np.nan,) * 3 if m is None else m.spread for m in models])
        gain = self._predictor.identified["load_gain"]
        self._threshold = SpreadThreshold(
            spread,
            gain,
            cycle,
            false_contacts=false_contacts,
            adapt=adapt,
        )
        self.bounds = self._threshold.bounds
        self._carries = _carries(n, limbs)
        self._limb_numbers = np.arange(1, n + 1) if limbs is None else limbs
        self._limbs = self._limb_numbers if parts.limbs else np.arange(n)
        self._limb_count = int(self._limbs.max()) + 1
        self._torque = TorqueEstimate(
            models,
            cycle,
            window=window,
            stiffness=1.0 / gain if stiffness is None else stiffness,
            spread=spread.max(axis=1) / SPREAD_STDS,
            motor_torque=motor_torque,
        )
        self._median = RunningMedian(window, 2 * n)
        self._loads, self._no_doubt = loads, np.zeros(n)
        self._doubt = JointDoubt(n, cycle)
        self._check_inputs, self._exclude_behind = _check_inputs.load(), _exclude_behind.load()
        self._combine, self._agree = _combine.load(), _agree.load()
        self._join_limbs, self._follow_hands = _join_limbs.load(), _follow_hands.load()
        self._express, self._judge = _express.load(), _judge.load()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        n = len(self.no_model)
        self._predictor.reset()
        self._threshold.reset()
        self._torque.reset()
        if self._loads is not None:
            self._loads.reset()
        self._derivatives.reset()
        self._median.reset()
        for name in ("answered", "recent", "steady"):
            self._channels[name] = 0
        if self._base is not None:
            self._base.reset()
        self._blind_ticks = np.zeros(n, dtype=np.int64)
        self._blind_countdown = 0
        self._base_quiet, self._confirming, self._untouched = PUSH_TICKS, 0, True
        self._doubt.reset()
        self._change, self._bias = np.zeros(n), np.zeros(n)
        self._hands = np.zeros(n, dtype=np.int64)
        self._settling_ticks = np.zeros(n, dtype=np.int64)
        self._settling_countdown = 0

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick."""
        measurement, reference, n = tick.measurement, tick.reference, len(self.no_model)
        target, load_torque = contiguous(tick.sent.position), contiguous(reference.load_torque)
        velocity, acceleration = contiguous(reference.velocity), contiguous(reference.acceleration)
        measured, current = contiguous(measurement.position), contiguous(measurement.current)
        limited = np.ascontiguousarray(tick.limited, np.bool_)
        good = np.empty(n, np.bool_)
        count = self._check_inputs(
            target,
            load_torque,
            velocity,
            acceleration,
            measured,
            current,
            contiguous(tick.sent.stiffness),
            good,
        )
        late = measurement.age / self._cycle
        lost = not 0.0 <= late < MAX_LATE_TICKS + 0.5  # also for NaN
        late_ticks = 0 if lost else round(late)
        if lost:
            good[:], count = False, 0
        if count < n:
            target, measured = self._replace_invalid(target, measured)
            load_torque = _zero_invalid(load_torque)
            velocity, acceleration = _zero_invalid(velocity), _zero_invalid(acceleration)
            current = _zero_invalid(current)
        if self._loads is not None:
            if not lost:
                self._step_loads(self._loads, target, measured, velocity, acceleration, good)
            load_torque = load_torque + self._loads.torque
        self._predictor.step(target, load_torque, velocity, acceleration, measured)
        # A late sample is the response to an older command.
        prediction = self._predictor.before(late_ticks)
        falls_behind = self._exclude_behind(
            prediction.target, prediction.board_target, self._carries, good
        )
        channels, count = self._residuals(prediction, measured, current, good)
        if not self._parts.model:
            channels[:n] = channels[n:]
        if not self._parts.current:
            channels[n:] = channels[:n]
        bad = None
        if count < n:
            bad = ~good
            channels[np.tile(bad, 2)] = 0.0
        both = self._median.push(channels)
        raw, filtered = np.empty(n), np.empty(n)
        self._agree(channels, raw)
        self._agree(both, filtered)
        if bad is not None:
            raw[bad] = np.nan
        blind = self._blind(bad, measured)
        own = self._threshold.step(prediction.speed, prediction.velocity, limited)
        moving = self._threshold.moving
        load_doubt = self._no_doubt if self._loads is None else self._loads.doubt
        alone = self._doubt.raise_thresholds(own, load_doubt, moving)
        threshold = alone.copy()
        base = (np.nan, np.nan)
        if self._base is not None:
            base = self._base.step(tick, late_ticks > 0, lost, falls_behind)
            if self._confirms(base[1]):
                # What shakes the base shakes all limbs a little: the one that shows most of it.
                # What a joint has shown for longer is of another push, or of none.
                limbs, fresh = self._limb_numbers, self._doubt.fresh
                candidates = fresh & (limbs != 0) & ~blind
                ratio = np.where(candidates, np.abs(filtered) / threshold, 0.0)
                largest = np.argmax(ratio)
                if ratio[largest] > 0.0:
                    threshold[fresh & (limbs == limbs[largest])] *= CONFIRMING_RATIO
        self._join_limbs(self._limbs, self._limb_count, filtered, threshold)
        self._follow_hands(both, threshold, self._hands, filtered)
        torque, torque_std = self._torque.step(
            both,
            prediction.friction,
            threshold,
            measured,
            moving,
            prediction.load_torque,
            current,
        )
        doubtful = self._doubt.step(both, filtered, own, moving, blind)
        expected_error = np.empty(n)
        self._express(
            prediction.target,
            prediction.position,
            prediction.remainder,
            self._bias,
            blind,
            expected_error,
            filtered,
            threshold,
            torque,
            torque_std,
        )
        return Residuals(
            expected=expected_error,
            raw=raw,
            residual=filtered,
            threshold=threshold,
            torque=torque,
            torque_std=torque_std,
            friction_band=self._predictor.friction_band(prediction, moving),
            blind=blind,
            doubtful=doubtful,
            base_raw=base[0],
            base_residual=base[1],
            base_drives=self._base is not None and self._base.drives,
            detail=_Detail(prediction, measured, limited, alone),
        )

    @staticmethod
    def _step_loads(
        loads: HandLoads,
        target: FloatArray,
        measured: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        good: BoolArray,
    ) -> None:
        """Take a tick in: a limp joint hangs elsewhere than its command."""
        if not good.all():
            target = np.where(good, target, measured)
            velocity, acceleration = np.where(good, (velocity, acceleration), 0.0)
        loads.step(target, velocity, acceleration)

    def _confirms(self, base_residual: float) -> bool:
        """Return True while a push on the base confirms one on a limb."""
        if abs(base_residual) > 1.0:
            # A hand that lets go shakes the base as well.
            if self._base_quiet >= PUSH_TICKS and self._untouched:
                self._confirming = PUSH_TICKS
            self._base_quiet = 0
        else:
            self._base_quiet += 1
        if not self._confirming or not self._parts.confirmation:
            return False
        self._confirming -= 1
        return True

    def _blind(self, bad: BoolArray | None, measured: FloatArray) -> BoolArray:
        """Return the (n,) joints that cannot be judged; their stick-slip models follow the measured position."""
        if bad is not None:
            # One tick more than the window, because this tick is counted down at once.
            self._blind_ticks[bad] = self._window + 1
            self._blind_countdown = self._window + 1
        if not self._blind_countdown:
            return self.no_model
        self._blind_countdown -= 1
        self._blind_ticks = np.maximum(self._blind_ticks - 1, 0)
        still_blind = self._blind_ticks > 0
        self._reset_models(still_blind & ~self.no_model, measured)
        blind: BoolArray = still_blind | self.no_model
        return blind

    def _replace_invalid(
        self, target: FloatArray, measured: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return both with the model's position in place of values that are not valid; at first with the target."""
        # NaN would stay in the states of models and filters for ever.
        here = self._predictor.position
        harmless = _zero_invalid(target) if here is None else np.nan_to_num(here)
        measured = np.where(np.abs(measured) < MAX_PLAUSIBLE, measured, harmless)
        return np.where(np.abs(target) < MAX_PLAUSIBLE, target, measured), measured

    def _residuals(
        self, prediction: Prediction, measured: FloatArray, current: FloatArray, good: BoolArray
    ) -> tuple[FloatArray, int]:
        """Return (2 n,) residuals [rad], and how many joints are good; clear ``good`` where there is none."""
        derivatives = self._derivatives
        if not derivatives.started:
            derivatives.start(prediction.target - measured)
        change, residuals = np.empty(len(good)), np.empty(2 * len(good))
        count = self._combine(
            self._predictor.joints,
            derivatives.filters,
            self._channels,
            prediction.target,
            prediction.board_target,
            prediction.load_torque,
            prediction.velocity,
            prediction.acceleration,
            prediction.position,
            prediction.friction,
            prediction.remainder,
            measured,
            current,
            self._bias,
            derivatives.gain,
            self._cycle,
            self._base_quiet < PUSH_TICKS,
            self.no_model,
            good,
            change,
            residuals,
        )
        self._change = change
        return residuals, count

    @property
    def moving(self) -> BoolArray:
        """(n,) joints that slide without touch, or did just before."""
        return self._threshold.moving

    @property
    def phase(self) -> IntArray:
        """(n,) phase of the motion of each joint; see :mod:`~pepper_driver.observer.detection.threshold`."""
        return self._threshold.phase

    @property
    def worn(self) -> BoolArray:
        """(n,) joints whose residual while sliding has grown as far as its spread may follow it."""
        return self._threshold.change >= WORN_CHANGE

    @property
    def misses_inertial_unit(self) -> bool:
        """True if the inertial unit gives no values any more; see :class:`BaseGenerator`."""
        return self._base is not None and self._base.misses_inertial_unit

    def learn(
        self, residuals: Residuals, free: BoolArray, settled: BoolArray, untouched: bool
    ) -> None:
        """Learn from a tick, once its events are known; see :class:`ResidualGenerator`."""
        detail, residual, blind = residuals.detail, residuals.residual, residuals.blind
        assert isinstance(detail, _Detail)
        assert residuals.doubtful is not None
        learns_bias = self._adapt and self._parts.bias
        self._settle(settled, blind, detail.measured)
        n = len(residual)
        touched, seen = np.empty(n, np.bool_), np.empty(n, np.bool_)
        resting, sliding = np.empty(n, np.bool_), np.empty(n, np.bool_)
        self._judge(
            residual,
            detail.threshold,
            detail.prediction.speed,
            free,
            blind,
            residuals.doubtful,
            detail.limited,
            self._cycle / BIAS_TIME if learns_bias and untouched else 0.0,
            self._bias,
            touched,
            seen,
            resting,
            sliding,
        )
        self._threshold.hold(touched)
        if untouched and self._loads is not None:
            self._loads.learn(residual, detail.threshold, sliding)
        # Also without adaptation: this corrects the state of the models.
        self._predictor.rest(resting, residual)
        self._untouched = untouched
        if untouched:
            self._threshold.learn(residual, seen)
            if self._base is not None:
                self._base.learn()

    def _settle(self, settled: BoolArray, blind: BoolArray, measured: FloatArray) -> None:
        """Reset the stick-slip models of joints that come to rest after a contact."""
        if np.count_nonzero(settled):
            self._settling_ticks[settled] = self._settling_countdown = SETTLING_TICKS + 1
        if not self._settling_countdown:
            return
        self._settling_countdown -= 1
        self._settling_ticks = np.maximum(self._settling_ticks - 1, 0)
        # A model that starts during a motion would have its friction in the wrong direction.
        rests = ~self._threshold.moving & (np.abs(self._change) <= REST_SPEED)
        settles = (self._settling_ticks > 0) & rests & ~blind
        self._settling_ticks[settles] = 0
        self._reset_models(settles, measured)

    def _reset_models(self, where: BoolArray, measured: FloatArray) -> None:
        """Reset the stick-slip models to the measured positions."""
        if np.count_nonzero(where):
            # Older residuals were those of the model before its reset.
            self._median.clear(np.tile(where, 2))
            self._derivatives.put(where, self._predictor.before(0).target - measured)
            self._predictor.put(where, measured)


def _carries(n: int, limbs: IntArray | None) -> BoolArray:
    """Return (n, n) True where the load on the joint of the column depends on the motion of the joint of the row."""
    if limbs is None:
        return np.eye(n, dtype=np.bool_)
    moved, loaded = limbs[:, None], limbs[None, :]
    carries: BoolArray = (moved == loaded) | (moved == 0) | (loaded == 0)
    return carries


def _zero_invalid(values: FloatArray) -> FloatArray:
    """Return ``values`` with 0 where they are not finite or exceed MAX_PLAUSIBLE."""
    return np.where(np.abs(values) < MAX_PLAUSIBLE, values, 0.0)
