"""Residuals of mode ``fusion``: stick-slip model and motor current must agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    BIAS_TIME,
    CORRECTION_TIME,
    MIN_SPREAD,
    PUSH_TICKS,
    QUIET_RATIO,
    REST_SPEED,
    SETTLING_TICKS,
)
from pepper_driver.observer.detection.confirmation import BaseConfirmation
from pepper_driver.observer.detection.threshold import (
    SpreadState,
    SpreadThreshold,
    ThresholdState,
    learn_spread,
    load_margin,
    step_threshold,
)
from pepper_driver.observer.interface import MAX_PLAUSIBLE, MIN_OBSERVED_STIFFNESS, Residuals
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import StickSlipState
from pepper_driver.observer.residuals.channels import ChannelComparison, follow_hand
from pepper_driver.observer.residuals.doubt import DoubtState, raise_threshold, step_doubt
from pepper_driver.observer.residuals.hand_loads import HandLoads
from pepper_driver.observer.residuals.mobile_base import BaseGenerator
from pepper_driver.observer.residuals.prediction import (
    MAX_LATE_TICKS,
    ErrorPredictor,
    PredictedJoint,
    Prediction,
    friction_band,
    rest,
)
from pepper_driver.observer.residuals.torque_estimate import (
    SPREAD_STDS,
    TorqueEstimate,
    TorqueState,
    estimate_torque,
)

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
def _set_thresholds(
    spreads: Records[SpreadState],
    states: Out[Records[ThresholdState]],
    factors: Matrix[FloatArray],
    smallest: Matrix[FloatArray],
    rest_ticks: int,
    limbs: IntArray,
    doubts: Records[DoubtState],
    model: Records[StickSlipState],
    desired: FloatArray,
    load_doubt: FloatArray,
    limited: BoolArray,
    own: Out[FloatArray],
    raised: Out[FloatArray],
) -> None:
    """Compute the threshold of each joint alone, and the same raised where it is in doubt."""
    for j in range(len(own)):
        own[j] = step_threshold(
            spreads,
            states,
            factors,
            smallest,
            j,
            model[j].velocity,
            desired[j],
            limited[j],
            rest_ticks,
        )
    for j in range(len(own)):
        own[j] += load_margin(states, limbs, j, load_doubt[j], rest_ticks)
        raised[j] = raise_threshold(doubts, j, own[j])


@kernel
def _decide(
    limbs: IntArray,
    limb_count: int,
    joints: Records[PredictedJoint],
    thresholds: Records[ThresholdState],
    torques: Out[Records[TorqueState]],
    currents: Out[Matrix[FloatArray]],
    count: int,
    doubts: Out[Records[DoubtState]],
    hands: Out[IntArray],
    target: FloatArray,
    load_torque: FloatArray,
    model: Records[StickSlipState],
    filtered: FloatArray,
    bias: FloatArray,
    measured: FloatArray,
    current: FloatArray,
    own: FloatArray,
    blind: BoolArray,
    residual: Out[FloatArray],
    threshold: Out[FloatArray],
    torque: Out[FloatArray],
    torque_std: Out[FloatArray],
    expected: Out[FloatArray],
    band: Out[FloatArray],
    doubtful: Out[BoolArray],
) -> None:
    """Compute what :class:`Residuals` has of each joint."""
    _join_limbs(limbs, limb_count, residual, threshold)
    n = len(residual)
    for j in range(n):
        moving, by_model, by_current = thresholds[j].moving, filtered[j], filtered[n + j]
        residual[j] = follow_hand(hands, j, residual[j], by_current, threshold[j])
        torque[j], torque_std[j] = estimate_torque(
            torques,
            currents,
            count,
            j,
            by_model,
            by_current,
            model[j].friction,
            threshold[j],
            measured[j],
            moving,
            load_torque[j],
            current[j],
        )
        doubtful[j] = step_doubt(doubts, j, by_model, residual[j], own[j], moving, blind[j])
        expected[j] = target[j] - model[j].position + bias[j]
        band[j] = friction_band(joints, j, load_torque[j], moving)
        if blind[j]:
            expected[j] = residual[j] = threshold[j] = torque[j] = torque_std[j] = math.nan


@kernel
def _learn(
    joints: Records[PredictedJoint],
    states: Out[Records[StickSlipState]],
    spreads: Out[Records[SpreadState]],
    thresholds: Out[Records[ThresholdState]],
    residual: FloatArray,
    threshold: FloatArray,
    model: Records[StickSlipState],
    free: BoolArray,
    blind: BoolArray,
    doubtful: BoolArray,
    limited: BoolArray,
    bias_pace: float,
    model_pace: float,
    learns_spread: bool,
    bias: Out[FloatArray],
    sliding: Out[BoolArray],
) -> None:
    """Learn from the joints without touch that can be judged; mark those that slide, and those that are touched."""
    n = len(residual)
    for j in range(n):
        thresholds[j].touched = not (free[j] or blind[j] or doubtful[j])
        seen = free[j] and not (blind[j] or limited[j])
        sliding[j] = seen and abs(model[j].velocity) > REST_SPEED
        if not seen:
            continue
        if abs(residual[j]) < QUIET_RATIO * threshold[j]:
            bias[j] += bias_pace * residual[j]
            if not sliding[j]:
                rest(joints, states, j, residual[j], model_pace)
        if learns_spread:
            learn_spread(spreads, thresholds[j].phase * n + j, residual[j], MIN_SPREAD)


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

    :class:`ChannelComparison` has the residual of each joint, :class:`SpreadThreshold` its threshold.

    A joint is blind

    - if it has no model;
    - if its stiffness is below MIN_OBSERVED_STIFFNESS;
    - if its sample is later than MAX_LATE_TICKS;
    - if a value is not finite;
    - if a board of its limb or of the trunk holds its target more than MIN_SPREAD behind the command; a joint of the
      trunk also if a board of any limb does.

    It stays blind until the median window has none of these samples. Its model then starts from the measured position.

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
        self.no_model = np.array([m is None for m in models])
        spread = np.array([(np.nan,) * 3 if m is None else m.spread for m in models])
        identified = self._predictor.identified
        gain = identified["load_gain"]
        settling = np.array([0.0 if m is None else m.twin.settling_time for m in models])
        limb_numbers = np.arange(1, n + 1) if limbs is None else limbs
        self._threshold = SpreadThreshold(
            spread,
            gain,
            identified["friction"],
            settling,
            cycle,
            false_contacts=false_contacts,
            trunk=limb_numbers == 0,
        )
        self.bounds = self._threshold.bounds
        self._limbs = limb_numbers if parts.limbs else np.arange(n)
        self._limb_count = int(self._limbs.max()) + 1
        self._channels = ChannelComparison(
            models,
            cycle,
            window=window,
            carries=_carries(n, limbs),
            uses_model=parts.model,
            uses_current=parts.current,
        )
        self._torque = TorqueEstimate(
            models,
            window=window,
            stiffness=1.0 / gain if stiffness is None else stiffness,
            spread=spread.max(axis=1) / SPREAD_STDS,
            motor_torque=motor_torque,
        )
        self._loads, self._no_doubt = loads, np.zeros(n)
        self._confirmation = BaseConfirmation(limb_numbers)
        self._check_inputs = _check_inputs.load_unchecked()
        self._set_thresholds = _set_thresholds.load_unchecked()
        self._decide, self._learn = _decide.load_unchecked(), _learn.load_unchecked()
        self._bias_pace = cycle / BIAS_TIME if adapt and parts.bias else 0.0
        self._model_pace = cycle / CORRECTION_TIME
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        n = len(self.no_model)
        self._predictor.reset()
        self._threshold.reset()
        self._torque.reset()
        if self._loads is not None:
            self._loads.reset()
        self._channels.reset()
        if self._base is not None:
            self._base.reset()
        self._blind_ticks = np.zeros(n, dtype=np.int64)
        self._blind_countdown = 0
        self._confirmation.reset()
        self._doubts = make_records(DoubtState, n)
        self._change, self._bias = np.zeros(n), np.zeros(n)
        self._settling_ticks = np.zeros(n, dtype=np.int64)
        self._settling_countdown = 0

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick."""
        measurement, reference, n = tick.measurement, tick.reference, len(self.no_model)
        target, load_torque = tick.sent.position, reference.load_torque
        velocity, acceleration = reference.velocity, reference.acceleration
        measured, current = measurement.position, measurement.current
        limited, good = tick.limited, np.empty(n, np.bool_)
        count = self._check_inputs(
            target,
            load_torque,
            velocity,
            acceleration,
            measured,
            current,
            tick.sent.stiffness,
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
            if count == n:
                self._loads.step(target, velocity, acceleration)
            elif not lost:
                # A limp joint hangs elsewhere than its command.
                moves = np.where(good, (velocity, acceleration), 0.0)
                self._loads.step(np.where(good, target, measured), *moves)
            load_torque = load_torque + self._loads.torque
        self._predictor.step(target, load_torque, velocity, acceleration, measured)
        # A late sample is the response to an older command.
        prediction = self._predictor.before(late_ticks)
        channels = self._channels.step(
            self._predictor.joints,
            prediction,
            measured,
            current,
            self._bias,
            good,
            pushed=self._confirmation.pushed,
        )
        self._change = channels.change
        blind = self._blind(channels.bad, measured)
        thresholds, torques = self._threshold, self._torque
        own, alone = np.empty((2, n))
        self._set_thresholds(
            thresholds.spreads,
            thresholds.states,
            thresholds.factors,
            thresholds.smallest,
            thresholds.rest_ticks,
            self._limbs,
            self._doubts,
            prediction.model,
            prediction.velocity,
            self._no_doubt if self._loads is None else self._loads.doubt,
            limited,
            own,
            alone,
        )
        threshold = alone.copy()
        base = (np.nan, np.nan)
        if self._base is not None:
            base = self._base.step(tick, late_ticks > 0, lost, channels.falls_behind)
            if self._confirmation.step(base[1]) and self._parts.confirmation:
                # Quiet when a push began that shows only now.
                fresh = self._doubts["loud_ticks"] <= PUSH_TICKS
                self._confirmation.lower(threshold, channels.residual, fresh, blind)
        (torque, torque_std, expected, band), doubtful = np.empty((4, n)), np.empty(n, np.bool_)
        self._decide(
            self._limbs,
            self._limb_count,
            self._predictor.joints,
            thresholds.states,
            torques.states,
            torques.currents,
            torques.count,
            self._doubts,
            self._channels.hands,
            prediction.target,
            prediction.load_torque,
            prediction.model,
            channels.filtered,
            self._bias,
            measured,
            current,
            own,
            blind,
            channels.residual,
            threshold,
            torque,
            torque_std,
            expected,
            band,
            doubtful,
        )
        torques.count += 1
        return Residuals(
            expected=expected,
            raw=channels.raw,
            residual=channels.residual,
            threshold=threshold,
            torque=torque,
            torque_std=torque_std,
            friction_band=band,
            blind=blind,
            doubtful=doubtful,
            base_raw=base[0],
            base_residual=base[1],
            base_drives=self._base is not None and self._base.drives,
            detail=_Detail(prediction, measured, limited, alone),
        )

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

    @property
    def phase(self) -> IntArray:
        """(n,) phase of the motion of each joint; see :mod:`~pepper_driver.observer.detection.threshold`."""
        return self._threshold.states["phase"]

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
        self._settle(settled, blind, detail.measured)
        sliding = np.empty(len(residual), np.bool_)
        self._learn(
            self._predictor.joints,
            self._predictor.states,
            self._threshold.spreads,
            self._threshold.states,
            residual,
            detail.threshold,
            detail.prediction.model,
            free,
            blind,
            residuals.doubtful,
            detail.limited,
            self._bias_pace if untouched else 0.0,
            self._model_pace,
            self._adapt and untouched,
            self._bias,
            sliding,
        )
        self._confirmation.untouched = untouched
        if untouched:
            if self._loads is not None:
                self._loads.learn(residual, detail.threshold, sliding)
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
        rests = ~self._threshold.states["moving"] & (np.abs(self._change) <= REST_SPEED)
        settles = (self._settling_ticks > 0) & rests & ~blind
        self._settling_ticks[settles] = 0
        self._reset_models(settles, measured)

    def _reset_models(self, where: BoolArray, measured: FloatArray) -> None:
        """Reset the stick-slip models to the measured positions."""
        if np.count_nonzero(where):
            self._channels.put(where, self._predictor.before(0).target - measured)
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
