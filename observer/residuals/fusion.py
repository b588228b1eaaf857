"""Residuals of mode ``fusion``: stick-slip model, tree, momentum and base, and the torque of the contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray, contiguous
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.detection.threshold import (
    POST_CONTACT_TICKS,
    REST_SPEED,
    FusionThreshold,
)
from pepper_driver.observer.interface import MIN_OBSERVED_STIFFNESS, HandLoad, Residuals
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import stick_slip_constants
from pepper_driver.observer.residuals.adaptation import (
    LEARN_PERIOD,
    MIN_MOVING_TICKS,
    Adaptation,
    HandLoads,
)
from pepper_driver.observer.residuals.doubt import DoubtDetector
from pepper_driver.observer.residuals.mobile_base import BaseGenerator
from pepper_driver.observer.residuals.momentum import (
    DerivativeFilter,
    ErrorDerivatives,
    MomentumChannel,
    differentiate,
    momentum_channels,
    momentum_residual,
)
from pepper_driver.observer.residuals.prediction import (
    MAX_LATE_TICKS,
    MIN_MOVING_SPEED,
    ErrorPredictor,
    PredictedJoint,
    Prediction,
    update_integral,
)
from pepper_driver.observer.running_filters import RunningMaximum, RunningMedian

FRICTION_RATIO = 0.5
"""Fraction of the reversed friction that counts as external torque: gears keep some of it."""

DAHL_DISTANCE = 0.003
"""[rad] of motion within which friction reverses."""

TOUCHED_RATIO = 0.5
"""Fraction of its threshold above which a residual counts as touch."""


class TorqueState:
    """External torque estimate of one joint.

    Attributes:
        stiffness: K [N m/rad], NaN for a joint without a model.
        friction: F / K [rad].
        spread: Standard deviation of the residual in free motion [rad].
        offset: Constant part of the load [rad].
        held: Friction at rest / K without load [rad].
        held_per_load: Its increase with the size of the load [rad/rad].
        torque_per_ampere: Motor torque / K per current [rad/A]; 0 where the current does not show it.
        motor_torque: Largest that the motor can give [N m].
        slip: Friction that acts, while it reverses [rad].
        residual: In the last tick [rad].
    """

    stiffness: float
    friction: float
    spread: float
    offset: float
    held: float
    held_per_load: float
    torque_per_ampere: float
    motor_torque: float
    slip: float
    residual: float


@kernel
def _bounded_torque(
    states: Records[TorqueState], j: int, torque: float, load_torque: float, current: float
) -> float:
    """Return the external torque [N m], at most as large as motor, friction and load [N m] can oppose."""
    state = states[j]
    motor = state.motor_torque
    if state.torque_per_ampere > 0.0:
        motor = min(motor, state.stiffness * state.torque_per_ampere * current)
    load = load_torque + state.stiffness * state.offset
    opposed = motor + state.stiffness * state.held + state.held_per_load * abs(load)
    # Never further from 0: a current that does not carry the load is no evidence of a hand.
    return min(max(torque, min(load - opposed, 0.0)), max(load + opposed, 0.0))


@kernel
def _estimate_torque(
    states: Out[Records[TorqueState]],
    residual: FloatArray,
    friction: FloatArray,
    threshold: FloatArray,
    load_torque: FloatArray,
    current: FloatArray,
    torque: Out[FloatArray],
    torque_std: Out[FloatArray],
) -> None:
    for j in range(len(residual)):
        state = states[j]
        motion = state.residual - residual[j]  # of the joint, relative to its free motion
        state.residual = residual[j]
        reversed_part, uncertain = 0.0, 0.0
        if abs(residual[j]) > TOUCHED_RATIO * threshold[j]:
            slip = state.slip + motion * (state.friction / DAHL_DISTANCE)
            state.slip = min(max(slip, -state.friction), state.friction)
            reversed_part = FRICTION_RATIO * (state.slip - friction[j])
            uncertain = FRICTION_RATIO * state.friction
        else:
            state.slip = friction[j]
        estimate = state.stiffness * (reversed_part - residual[j])
        torque[j] = _bounded_torque(states, j, estimate, load_torque[j], current[j])
        torque_std[j] = state.stiffness * math.hypot(state.spread, uncertain)


class TorqueEstimate:
    """External torque tau_ext = -K r, plus a part of the friction that the push has reversed.

    A push on a joint also reverses its friction, which then acts against the push. The friction reverses with the
    motion that the residual shows (Dahl's model).

    -K r is the torque that a board without limits would have given. Once a motor board gives no more, the joint is
    moved by any torque beyond it, and r no longer shows how large this is. The estimate is therefore at most what can
    oppose a hand: the torque of the motor, friction, and the load. The current shows the torque of the motor, where
    identification found that it does; in any case it is at most the documented one.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        window: Samples of the median of the residual.
        spread: (n,) standard deviation of the residual in free motion [rad].
        motor_torque: (n,) largest torque of the motors, at the joints [N m]; infinite where it is unknown.
    """

    def __init__(
        self,
        models: Sequence[FusionModel | None],
        cycle: float,
        *,
        window: int,
        spread: FloatArray,
        motor_torque: FloatArray | float = math.inf,
    ) -> None:
        twins = stick_slip_constants([None if m is None else m.twin for m in models])
        self._states = make_records(
            TorqueState,
            len(models),
            stiffness=1.0 / twins["load_gain"],
            friction=twins["friction"],
            spread=spread,
            offset=twins["offset"],
            held=twins["breakaway"] * twins["friction"],
            held_per_load=twins["breakaway"] * twins["load_friction"],
            torque_per_ampere=[
                0.0 if m is None or m.momentum.source != "current" else m.momentum.torque_per_ampere
                for m in models
            ],
            motor_torque=motor_torque,
        )
        self._memory = window * cycle
        self._cycle = cycle
        self._estimate = _estimate_torque.load()
        self.reset()

    def reset(self) -> None:
        """Forget the previous ticks."""
        self._states["slip"], self._states["residual"] = 0.0, 0.0
        # The residual is filtered: the current that belongs to it may be over.
        self._currents = RunningMaximum(self._memory, self._cycle, len(self._states))

    def step(
        self,
        residual: FloatArray,
        friction: FloatArray,
        threshold: FloatArray,
        load_torque: FloatArray,
        current: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Take in one tick.

        Args:
            residual: (n,) [rad].
            friction: (n,) friction of the joints without touch, over K [rad].
            threshold: (n,) of a contact [rad].
            load_torque: (n,) desired [N m].
            current: (n,) measured, without its sign [A].

        Returns:
            (n,) external torque and its standard deviation [N m].
        """
        torque, torque_std = np.empty(len(residual)), np.empty(len(residual))
        self._estimate(
            self._states,
            residual,
            friction,
            threshold,
            load_torque,
            self._currents.push(np.abs(current)),
            torque,
            torque_std,
        )
        return torque, torque_std


MAX_PLAUSIBLE = 1e4
"""[rad], [rad/s], [rad/s2], [N m] or [A]: larger commands and measurements are not valid."""

SETTLING_TICKS = 40
"""Ticks after a contact in which its joint must come to rest for its model to start again there."""

UNCERTAINTY_PERIOD = 4
"""Ticks between two computations of the uncertainty: a threshold that it raises stays up longer than this."""


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
        inputs = target[j] + load_torque[j] + velocity[j] + acceleration[j]
        inputs = inputs + measured[j] + current[j]
        good[j] = abs(inputs) < MAX_PLAUSIBLE and stiffness[j] >= MIN_OBSERVED_STIFFNESS
        count += good[j]
    return count


@kernel
def _fuse(
    joints: Out[Records[PredictedJoint]],
    filters: Out[Records[DerivativeFilter]],
    channels: Records[MomentumChannel],
    weight_at_rest: FloatArray,
    weight_in_motion: FloatArray,
    target: FloatArray,
    board_target: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    position: FloatArray,
    speed: FloatArray,
    friction: FloatArray,
    remainder: FloatArray,
    measured: FloatArray,
    current: FloatArray,
    gain: float,
    cycle: float,
    good: Out[BoolArray],
    change: Out[FloatArray],
    residual: Out[FloatArray],
) -> int:
    """Compute the fused residual and the derivative of the error; return how many joints are good.

    The arguments are those of :class:`Prediction`, ``momentum_residual`` and ``differentiate``. Where a joint with a
    model has no residual, it is no longer ``good``.
    """
    count = 0
    for j in range(len(residual)):
        joint = joints[j]
        error, board_error = target[j] - measured[j], board_target[j] - measured[j]
        model_residual = position[j] - measured[j] - remainder[j]
        change[j], curvature = differentiate(filters, j, error, gain, cycle)
        load = joint.load_gain * load_torque[j] * joint.load_factor
        momentum, motor = momentum_residual(
            channels,
            j,
            current[j] if good[j] else 0.0,
            board_error + joint.board_integral,
            velocity[j] - change[j],
            acceleration[j] - curvature,
            friction[j] + load + joint.extra_load,
            model_residual,
        )
        if good[j]:
            update_integral(joints, j, board_error, motor, cycle)
        moves = abs(speed[j]) > MIN_MOVING_SPEED
        weight = weight_in_motion[j] if moves else weight_at_rest[j]
        residual[j] = weight * model_residual + (1.0 - weight) * momentum
        # The weight of a joint without a model is NaN.
        good[j] = good[j] and (math.isfinite(residual[j]) or math.isnan(weight))
        count += good[j]
    return count


@kernel
def _judge(
    residual: FloatArray,
    speed: FloatArray,
    free: BoolArray,
    blind: BoolArray,
    limited: BoolArray,
    quiet_bound: FloatArray,
    moving_ticks: Out[IntArray],
    judged: Out[BoolArray],
    quiet: Out[BoolArray],
    resting: Out[BoolArray],
) -> None:
    """Mark the joints that can be judged, those that are quiet too, and those of them whose models are at rest."""
    for j in range(len(residual)):
        moves = abs(speed[j]) > MIN_MOVING_SPEED
        judged[j] = not (blind[j] or limited[j])
        seen = free[j] and judged[j]
        quiet[j] = seen and abs(residual[j]) < quiet_bound[j]
        resting[j] = quiet[j] and not moves
        moving_ticks[j] = moving_ticks[j] + 1 if seen and moves else 0


@dataclass(slots=True)
class _Detail:
    """Values of a tick, (n,) each: prediction, measured position [rad], joints altered by the safety gate."""

    prediction: Prediction
    measured: FloatArray
    limited: BoolArray


class FusionGenerator:
    """r = w r_model + (1 - w) r_momentum, filtered by a short running median.

    A joint is blind

    - if it has no model;
    - if its stiffness is below MIN_OBSERVED_STIFFNESS;
    - if its sample is later than MAX_LATE_TICKS;
    - if a value is not finite.

    It stays blind until the median window has none of these samples. Its model then starts from the measured position.

    While the safety gate alters the command of a joint, and shortly after, its threshold rises by LIMITED_FACTOR.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        window: Samples of the median.
        adapt: True to adapt the constants of the joints.
        hands: Estimate of the loads of the hands, None for no such estimate.
        base: Residual of the base, None without a model of it.
        motor_torque: (n,) largest torque of the motors, at the joints [N m].
    """

    def __init__(
        self,
        models: list[FusionModel | None],
        cycle: float,
        *,
        window: int,
        adapt: bool,
        hands: HandLoads | None = None,
        base: BaseGenerator | None = None,
        motor_torque: FloatArray | float = math.inf,
    ) -> None:
        self._cycle, self._window, self._adapt = cycle, window, adapt
        self._hands = hands if adapt else None
        self._base = base
        self._predictor = ErrorPredictor(models, cycle)
        self._channels = momentum_channels(
            [None if m is None else m.momentum for m in models], self._predictor.integrates
        )
        self._derivatives = ErrorDerivatives(len(models), cycle)
        self.no_model = np.array([m is None for m in models])
        self._threshold = FusionThreshold(models, cycle, adapt=adapt)
        self.bounds = self._threshold.bounds

        def pairs(name: str) -> tuple[FloatArray, FloatArray]:
            both = np.array([(np.nan, np.nan) if m is None else getattr(m, name) for m in models])
            return both[:, 0], both[:, 1]

        self._weight_at_rest, self._weight_in_motion = map(np.copy, pairs("weight"))
        spread = np.maximum(*pairs("spread"))
        self._adaptation = Adaptation(
            [None if m is None else m.twin for m in models], spread, cycle
        )
        self._torque = TorqueEstimate(
            models, cycle, window=window, spread=spread, motor_torque=motor_torque
        )
        self._doubt = DoubtDetector(models)
        self._median = RunningMedian(window, len(models))
        self._check_inputs, self._fuse = _check_inputs.load(), _fuse.load()
        self._judge = _judge.load()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        n = len(self.no_model)
        self._predictor.reset()
        self._adaptation.reset()
        if self._hands is not None:
            self._hands.reset()
        self._threshold.reset()
        self._torque.reset()
        self._doubt.reset()
        self._free = np.ones(n, dtype=np.bool_)
        self._derivatives.reset()
        self._median.reset()
        if self._base is not None:
            self._base.reset()
        self._blind_ticks = np.zeros(n, dtype=np.int64)
        self._blind_countdown = 0
        self._change = np.zeros(n)
        self._settling_ticks = np.zeros(n, dtype=np.int64)
        self._settling_countdown = 0
        self._moving_ticks = np.zeros(n, dtype=np.int64)
        self._untouched = POST_CONTACT_TICKS
        self._prediction_std = np.zeros(n)
        self._count = 0

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
        if self._hands is not None:
            load_torque = load_torque + self._hands.step(measured, velocity, acceleration)
        self._predictor.step(target, load_torque, velocity, acceleration, measured)
        # A late sample is the response to an older command.
        prediction = self._predictor.before(late_ticks)
        residual, count = self._residual(prediction, measured, current, good)
        bad = None
        if count == n:
            filtered = self._median.push(residual)
        else:
            bad = ~good
            filtered = self._median.push(np.where(bad, 0.0, residual))
            residual[bad] = np.nan
        blind = self._blind(bad, measured)
        if self._adapt and self._count % UNCERTAINTY_PERIOD == 0:
            self._prediction_std = self._uncertainty(prediction)
        threshold = self._threshold.step(
            velocity, acceleration, limited, self._prediction_std, self._unsettled()
        )
        torque, torque_std = self._torque.step(
            filtered, prediction.friction, threshold, prediction.load_torque, current
        )
        doubtful = self._doubt.step(
            self._predictor.joints,
            prediction,
            measured,
            prediction.velocity - self._change,
            current,
            filtered,
            threshold,
            good & ~self._threshold.moving,
            self._free,
        )
        if np.count_nonzero(doubtful):
            doubtful &= ~blind
        expected_error = prediction.target - prediction.position + prediction.remainder
        if np.count_nonzero(blind):
            for values in (expected_error, filtered, threshold, torque, torque_std):
                values[blind] = np.nan
        base = (np.nan, np.nan)
        if self._base is not None:
            base = self._base.step(tick, lost or late_ticks > 0)
        return Residuals(
            expected=expected_error,
            raw=residual,
            residual=filtered,
            threshold=threshold,
            torque=torque,
            torque_std=torque_std,
            friction_band=self._predictor.friction_band(prediction, self._threshold.moving),
            blind=blind,
            doubtful=doubtful,
            base_raw=base[0],
            base_residual=base[1],
            detail=_Detail(prediction, measured, limited),
        )

    def _unsettled(self) -> FloatArray | None:
        """Return (n,) 1 just after a touch, falling to 0, where motor boards integrate; None if all have settled."""
        if not 0 < self._untouched < POST_CONTACT_TICKS:
            return None
        return self._predictor.integrates * (1.0 - self._untouched / POST_CONTACT_TICKS)

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
        """Return both with the model's position in place of values that are not valid."""
        # NaN would stay in the states of models and filters for ever.
        here = self._predictor.position
        harmless = np.zeros(len(measured)) if here is None else np.nan_to_num(here)
        measured = np.where(np.abs(measured) < MAX_PLAUSIBLE, measured, harmless)
        return np.where(np.abs(target) < MAX_PLAUSIBLE, target, measured), measured

    def _residual(
        self, prediction: Prediction, measured: FloatArray, current: FloatArray, good: BoolArray
    ) -> tuple[FloatArray, int]:
        """Return the fused residual [rad], and how many joints are good; clear ``good`` where there is none."""
        derivatives = self._derivatives
        if not derivatives.started:
            derivatives.start(prediction.target - measured)
        change, residual = np.empty(len(good)), np.empty(len(good))
        count = self._fuse(
            self._predictor.joints,
            derivatives.filters,
            self._channels,
            self._weight_at_rest,
            self._weight_in_motion,
            prediction.target,
            prediction.board_target,
            prediction.load_torque,
            prediction.velocity,
            prediction.acceleration,
            prediction.position,
            prediction.speed,
            prediction.friction,
            prediction.remainder,
            measured,
            current,
            derivatives.gain,
            self._cycle,
            good,
            change,
            residual,
        )
        self._change = change
        return residual, count

    @property
    def worn(self) -> BoolArray:
        """(n,) joints whose friction or lag has grown by more than WEAR_RATIO."""
        return self._adaptation.worn

    @property
    def hand_loads(self) -> dict[str, HandLoad]:
        """Load of each hand, by arm."""
        return {} if self._hands is None else self._hands.by_arm()

    def learn(
        self, residuals: Residuals, free: BoolArray, settled: BoolArray, untouched: bool
    ) -> None:
        """Learn from a tick, once its events are known; see :class:`ResidualGenerator`."""
        detail, residual, blind = residuals.detail, residuals.residual, residuals.blind
        assert isinstance(detail, _Detail)
        prediction, n = detail.prediction, len(residual)
        self._free = free
        self._settle(settled, blind, detail.measured)
        judged, quiet, resting = np.empty(n, np.bool_), np.empty(n, np.bool_), np.empty(n, np.bool_)
        self._judge(
            residual,
            prediction.speed,
            free,
            blind,
            detail.limited,
            self._threshold.quiet_bound,
            self._moving_ticks,
            judged,
            quiet,
            resting,
        )
        # Also without adaptation: this corrects the state of the models, not their constants.
        self._predictor.rest(resting, residual)
        if not self._adapt:
            return
        self._untouched = self._untouched + 1 if untouched else 0
        self._threshold.learn(residual, judged if untouched else None)
        if self._base is not None:
            self._base.learn(untouched, bool(np.count_nonzero(self._threshold.moving)))
        self._count += 1
        # Half a period after the joints, so that no tick makes both updates.
        if self._count % LEARN_PERIOD == LEARN_PERIOD // 2 and self._untouched > POST_CONTACT_TICKS:
            use = free & judged & (np.abs(residual) < self._threshold.learning_bound)
            self._reconcile_hands(use, detail)
            self._learn_hands(use, prediction, residual)
        if self._count % LEARN_PERIOD == 0:
            other = np.zeros(n) if self._hands is None else self._hands.variance()
            # A joint at rest shows none of its constants: friction may hold it anywhere within its band.
            moving = quiet & ~resting
            self._adaptation.update(residual, self._effects(prediction), other, moving)
            self._predictor.adopt(self._adaptation.deviation)

    def _learn_hands(self, use: BoolArray, prediction: Prediction, residual: FloatArray) -> None:
        """Update the loads of the hands, only without touch: a touch on an arm looks like a load."""
        if self._hands is None:
            return
        noise = self._adaptation.variance(self._effects(prediction))
        explained = self._hands.update(
            residual, noise, use & (self._moving_ticks >= MIN_MOVING_TICKS)
        )
        # At once: until the stick-slip models had moved there, the same residual would be learned again.
        self._predictor.shift(explained)

    def _reconcile_hands(self, use: BoolArray, detail: _Detail) -> None:
        """Correct the loads by joints at rest: these do not show a load, but may contradict one."""
        if self._hands is None:
            return
        still = ~self._threshold.moving & (np.abs(self._change) <= REST_SPEED)
        beyond = self._predictor.beyond_friction(detail.prediction, detail.measured)
        explained = self._hands.reconcile(beyond, use & still & (self._moving_ticks == 0))
        if explained is not None:
            self._predictor.shift(explained)

    def _effects(self, prediction: Prediction) -> FloatArray:
        return self._adaptation.effects(
            prediction.friction,
            self._predictor.model_velocity,
            self._predictor.identified["load_gain"] * prediction.load_torque,
        )

    def _uncertainty(self, prediction: Prediction) -> FloatArray:
        """Return the (n,) standard deviation of the expected error from unknown constants and loads [rad]."""
        variance = self._adaptation.variance(self._effects(prediction))
        if self._hands is not None:
            variance = variance + self._hands.variance()
        return np.sqrt(np.maximum(variance, 0.0))

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
            self._median.clear(where)
            self._derivatives.put(where, self._predictor.before(0).target - measured)
            self._predictor.put(where, measured)


def _zero_invalid(values: FloatArray) -> FloatArray:
    """Return ``values`` with 0 where they are not finite or exceed MAX_PLAUSIBLE."""
    return np.where(np.abs(values) < MAX_PLAUSIBLE, values, 0.0)
