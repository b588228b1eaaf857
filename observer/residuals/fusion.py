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
    HELD_FACTOR,
    MIN_SPREAD,
    PUSH_TICKS,
    QUIET_RATIO,
    REST_SPEED,
    SETTLING_TICKS,
)
from pepper_driver.observer.detection.confirmation import BaseConfirmation
from pepper_driver.observer.detection.disturbance import Disturbance
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
from pepper_driver.observer.models.stick_slip import WEAK_GAIN, StickSlipState
from pepper_driver.observer.residuals.board_law import BoardLaw
from pepper_driver.observer.residuals.channels import ChannelComparison, follow_hand
from pepper_driver.observer.residuals.doubt import DoubtState, raise_threshold, step_doubt
from pepper_driver.observer.residuals.hand_loads import HandLoads
from pepper_driver.observer.residuals.joint_tick import JointCommand, JointTick
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


EXPECTED, RAW, RESIDUAL, THRESHOLD, TORQUE, TORQUE_STD, FRICTION_BAND = range(7)
"""Rows of the values that ``_decide`` computes."""


@kernel
def _take_in(
    target: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    measured: FloatArray,
    current: FloatArray,
    stiffness: FloatArray,
    limited: BoolArray,
    commands: Out[Records[JointCommand]],
    ticks: Out[Records[JointTick]],
) -> int:
    """Take in the values of a tick, and mark the joints that can be judged; return how many."""
    count = 0
    for j in range(len(ticks)):
        command, tick = commands[j], ticks[j]
        command.target, command.load_torque = target[j], load_torque[j]
        command.velocity, command.acceleration = velocity[j], acceleration[j]
        tick.measured, tick.current, tick.limited = measured[j], current[j], limited[j]
        # One sum finds NaN and infinity in any of its terms; NaN compares as False.
        inputs = abs(target[j]) + abs(load_torque[j]) + abs(velocity[j]) + abs(acceleration[j])
        inputs = inputs + abs(measured[j]) + abs(current[j])
        tick.good = inputs < MAX_PLAUSIBLE and stiffness[j] >= MIN_OBSERVED_STIFFNESS
        count += tick.good
    return count


@kernel
def _join_limbs(limbs: IntArray, count: int, ticks: Out[Records[JointTick]]) -> None:
    """Lower the thresholds of joints of a limb together, so that the largest ratio becomes the norm of all of them."""
    for limb in range(count):
        largest, square = 0.0, 0.0
        for j in range(len(limbs)):
            if limbs[j] == limb:
                ratio = abs(ticks[j].residual) / ticks[j].threshold
                if math.isfinite(ratio):
                    largest, square = max(largest, ratio), square + ratio * ratio
        if square > 0.0:
            fraction = largest / math.sqrt(square)
            for j in range(len(limbs)):
                if limbs[j] == limb:
                    ticks[j].threshold *= fraction


@kernel
def _set_thresholds(
    spreads: Records[SpreadState],
    states: Out[Records[ThresholdState]],
    factors: Matrix[FloatArray],
    min_thresholds: Matrix[FloatArray],
    rest_ticks: int,
    limbs: IntArray,
    doubts: Records[DoubtState],
    commands: Records[JointCommand],
    model: Records[StickSlipState],
    load_doubt: FloatArray,
    ticks: Out[Records[JointTick]],
) -> None:
    """Compute the threshold of each joint alone, and the same raised where it is in doubt."""
    for j in range(len(ticks)):
        ticks[j].own_threshold = step_threshold(
            spreads,
            states,
            factors,
            min_thresholds,
            j,
            model[j].velocity,
            commands[j].velocity,
            ticks[j].limited,
            rest_ticks,
        )
    for j in range(len(ticks)):
        tick = ticks[j]
        tick.own_threshold += load_margin(states, limbs, j, load_doubt[j], rest_ticks)
        tick.raised_threshold = raise_threshold(doubts, j, tick.own_threshold)
        tick.threshold = tick.raised_threshold


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
    commands: Records[JointCommand],
    model: Records[StickSlipState],
    ticks: Out[Records[JointTick]],
    values: Out[Matrix[FloatArray]],
    doubtful: Out[BoolArray],
) -> None:
    """Compute ``values`` and ``doubtful`` of :class:`Residuals`, and in ``ticks`` those that ``_learn`` needs."""
    _join_limbs(limbs, limb_count, ticks)
    for j in range(len(ticks)):
        tick, command, moving = ticks[j], commands[j], thresholds[j].moving
        residual = follow_hand(hands, j, tick.residual, tick.by_current, tick.threshold)
        torque, torque_std = estimate_torque(
            torques,
            currents,
            count,
            j,
            tick.by_model,
            tick.by_current,
            model[j].friction,
            tick.threshold,
            tick.measured,
            moving,
            command.load_torque,
            tick.current,
        )
        tick.doubtful = step_doubt(
            doubts,
            j,
            tick.by_model,
            residual,
            tick.own_threshold,
            moving,
            tick.blind,
            tick.jumps,
        )
        expected = command.target - model[j].position + joints[j].bias
        band = friction_band(joints, j, command.load_torque, moving)
        if tick.blind:
            expected = residual = tick.threshold = torque = torque_std = math.nan
        tick.residual = residual
        values[EXPECTED, j], values[RAW, j], values[RESIDUAL, j] = expected, tick.raw, residual
        values[THRESHOLD, j], values[FRICTION_BAND, j] = tick.threshold, band
        values[TORQUE, j], values[TORQUE_STD, j] = torque, torque_std
        doubtful[j] = tick.doubtful


@kernel
def _learn(
    joints: Out[Records[PredictedJoint]],
    states: Out[Records[StickSlipState]],
    spreads: Out[Records[SpreadState]],
    thresholds: Out[Records[ThresholdState]],
    model: Records[StickSlipState],
    free: BoolArray,
    bias_pace: float,
    model_pace: float,
    learns_spread: bool,
    ticks: Out[Records[JointTick]],
) -> None:
    """Learn from the joints without touch that can be judged; mark those that slide, and those that are touched."""
    n = len(ticks)
    for j in range(n):
        tick = ticks[j]
        thresholds[j].touched = not (free[j] or tick.blind or tick.doubtful)
        seen = free[j] and not (tick.blind or tick.limited)
        tick.sliding = seen and abs(model[j].velocity) > REST_SPEED
        if not seen:
            continue
        if abs(tick.residual) < QUIET_RATIO * tick.raised_threshold:
            joints[j].bias += bias_pace * tick.residual
            if not tick.sliding:
                rest(joints, states, j, tick.residual, model_pace)
        if learns_spread:
            learn_spread(spreads, thresholds[j].phase * n + j, tick.residual, MIN_SPREAD)


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
        law: False for currents that are not compared with the law of the boards; nor are they with one channel alone.
    """

    model: bool = True
    current: bool = True
    limbs: bool = True
    confirmation: bool = True
    bias: bool = True
    loads: bool = True
    law: bool = True


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
        carries = _carries(n, limbs)
        self._limbs = limb_numbers if parts.limbs else np.arange(n)
        self._limb_count = int(self._limbs.max()) + 1
        self._channels = ChannelComparison(
            models,
            cycle,
            window=window,
            carries=carries,
            uses_model=parts.model,
            uses_current=parts.current,
        )
        self._law = BoardLaw(
            self._channels.by_current
            & (gain < WEAK_GAIN)
            & (parts.law and parts.model and parts.current),
            limb_numbers,
            carries,
            self._channels.gain,
            window,
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
        self._disturbance = Disturbance(limb_numbers, cycle)
        self._take_in = _take_in.load_unchecked()
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
        self._law.reset()
        self._jolt_ticks = 0
        if self._base is not None:
            self._base.reset()
        self._blind_ticks = np.zeros(n, dtype=np.int64)
        self._blind_countdown = 0
        self._confirmation.reset()
        self._disturbance.reset()
        self._doubts = make_records(DoubtState, n)
        self._command = make_records(JointCommand, n)
        self._ticks = make_records(JointTick, n, blind=self.no_model)
        self._prediction: Prediction | None = None
        self._settling_ticks = np.zeros(n, dtype=np.int64)
        self._settling_countdown = 0

    def step(self, tick: Tick) -> Residuals:
        """Take in one tick."""
        measurement, reference, n = tick.measurement, tick.reference, len(self.no_model)
        command, ticks = self._command, self._ticks
        count = self._take_in(
            tick.sent.position,
            reference.load_torque,
            reference.velocity,
            reference.acceleration,
            measurement.position,
            measurement.current,
            tick.sent.stiffness,
            tick.limited,
            command,
            ticks,
        )
        late = measurement.age / self._cycle
        lost = not 0.0 <= late < MAX_LATE_TICKS + 0.5  # also for NaN
        late_ticks = 0 if lost else round(late)
        if lost:
            ticks["good"], count = False, 0
        if count < n:
            self._replace_invalid()
        if self._loads is not None:
            if count == n:
                self._loads.step(tick.sent.position, reference.velocity, reference.acceleration)
            elif not lost:
                # A limp joint hangs elsewhere than its command.
                good = ticks["good"]
                moves = np.where(good, (command["velocity"], command["acceleration"]), 0.0)
                self._loads.step(np.where(good, command["target"], ticks["measured"]), *moves)
            load_torque = command["load_torque"]
            load_torque += self._loads.torque
        self._predictor.step(command, ticks["measured"])
        # A late sample is the response to an older command.
        self._prediction = prediction = self._predictor.before(late_ticks)
        falls_behind = self._channels.step(
            self._predictor.joints, prediction, ticks, pushed=self._confirmation.pushed
        )
        good_count, jump, catches_up = self._law.step(
            prediction.command, self._threshold.states, self._channels.hands, ticks
        )
        jolt = jump or catches_up
        self._jolt_ticks = SETTLING_TICKS if jolt else max(self._jolt_ticks - 1, 0)
        blind = self._blind(None if good_count == n else ~ticks["good"])
        thresholds, torques = self._threshold, self._torque
        self._set_thresholds(
            thresholds.spreads,
            thresholds.states,
            thresholds.factors,
            thresholds.min_thresholds,
            thresholds.rest_ticks,
            self._limbs,
            self._doubts,
            prediction.command,
            prediction.model,
            self._no_doubt if self._loads is None else self._loads.doubt,
            ticks,
        )
        base, disturbance, confirmed = (np.nan, np.nan), self._disturbance, False
        jolts = self._jolt_ticks > 0
        if self._base is not None:
            base = self._base.step(tick, late_ticks > 0, lost, falls_behind or catches_up)
            if disturbance.base or jolts:
                base = base[0] / HELD_FACTOR, base[1] / HELD_FACTOR
            jolts = jolts or self._base.shakes
            confirmed = self._confirmation.step(base[1]) and self._parts.confirmation
        shaken = ~thresholds.states["touched"] if jolts else disturbance.joints
        if shaken is not None:
            ticks["threshold"][shaken] *= HELD_FACTOR
        if confirmed:
            # Quiet when a push began that shows only now.
            fresh = self._doubts["loud_ticks"] <= PUSH_TICKS
            self._confirmation.lower(ticks["threshold"], ticks["residual"], fresh, blind)
        values, doubtful = np.empty((FRICTION_BAND + 1, n)), np.empty(n, np.bool_)
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
            prediction.command,
            prediction.model,
            ticks,
            values,
            doubtful,
        )
        torques.count += 1
        expected, raw, residual, threshold, torque, torque_std, band = values
        return Residuals(
            expected=expected,
            raw=raw,
            residual=residual,
            threshold=threshold,
            torque=torque,
            torque_std=torque_std,
            friction_band=band,
            blind=blind,
            doubtful=doubtful,
            base_raw=base[0],
            base_residual=base[1],
            base_drives=self._base is not None and self._base.drives,
        )

    def _blind(self, bad: BoolArray | None) -> BoolArray:
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
        self._reset_models(still_blind & ~self.no_model)
        blind: BoolArray = still_blind | self.no_model
        self._ticks["blind"] = blind
        return blind

    def _replace_invalid(self) -> None:
        """Replace positions that are not valid by those of the models, at first by the target; other values by 0."""
        # NaN would stay in the states of models and filters for ever.
        command, ticks, here = self._command, self._ticks, self._predictor.position
        target, measured = command["target"], ticks["measured"]
        harmless = _zero_invalid(target) if here is None else np.nan_to_num(here)
        measured[:] = np.where(np.abs(measured) < MAX_PLAUSIBLE, measured, harmless)
        target[:] = np.where(np.abs(target) < MAX_PLAUSIBLE, target, measured)
        for name in ("load_torque", "velocity", "acceleration"):
            command[name] = _zero_invalid(command[name])
        ticks["current"] = _zero_invalid(ticks["current"])

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

    def learn(self, free: BoolArray, settled: BoolArray, untouched: bool) -> None:
        """Learn from the last tick, once its events are known; see :class:`ResidualGenerator`."""
        ticks, prediction = self._ticks, self._prediction
        assert prediction is not None  # of the last tick
        self._settle(settled)
        self._learn(
            self._predictor.joints,
            self._predictor.states,
            self._threshold.spreads,
            self._threshold.states,
            prediction.model,
            free,
            self._bias_pace if untouched else 0.0,
            self._model_pace,
            self._adapt and untouched,
            ticks,
        )
        self._confirmation.untouched = untouched
        self._disturbance.step(free, ticks["blind"], untouched)
        if untouched:
            if self._loads is not None:
                self._loads.learn(ticks["residual"], ticks["raised_threshold"], ticks["sliding"])
            if self._base is not None:
                self._base.learn()

    def _settle(self, settled: BoolArray) -> None:
        """Reset the stick-slip models of joints that come to rest after a contact."""
        if np.count_nonzero(settled):
            self._settling_ticks[settled] = self._settling_countdown = SETTLING_TICKS + 1
        if not self._settling_countdown:
            return
        self._settling_countdown -= 1
        self._settling_ticks = np.maximum(self._settling_ticks - 1, 0)
        # A model that starts during a motion would have its friction in the wrong direction.
        slow = np.abs(self._ticks["change"]) <= REST_SPEED
        rests = slow & ~self._threshold.states["moving"] & ~self._ticks["blind"]
        settles = (self._settling_ticks > 0) & rests
        self._settling_ticks[settles] = 0
        self._reset_models(settles)

    def _reset_models(self, where: BoolArray) -> None:
        """Reset the stick-slip models to the measured positions."""
        if np.count_nonzero(where):
            measured = self._ticks["measured"].copy()
            self._channels.put(where, self._predictor.before(0).command["target"] - measured)
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
