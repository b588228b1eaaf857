"""Expected and measured motion of the base: contacts on it, and on a stiff trunk.

The speed controllers of the wheels are nearly linear, and so is the response of the base to the motion of the limbs. A
finite impulse response predicts the twist that the wheels measure, and what the inertial unit measures, from the
commanded wheel speeds and the load on the legs.
"""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray, contiguous
from pepper_driver.config.kernels import Block, Matrix, Out, Records, kernel, make_records
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    QUIET_RATIO,
    ROCKING_SPEED,
    SETTLING_TICKS,
    SHAKING_ACCELERATION,
    STANDSTILL_SPEED,
    TAIL,
)
from pepper_driver.observer.detection.threshold import (
    SpreadState,
    learn_spread,
    threshold_factor,
)
from pepper_driver.observer.interface import MAX_PLAUSIBLE
from pepper_driver.observer.models.fusion_model import OUTPUTS, TAPS, BaseModel
from pepper_driver.observer.running_filters import RunningMedian

FROZEN_TICKS = 2
"""From which on values that the inertial unit repeats count as missing: the filter takes out fewer."""

STILL, MOVING, SHAKING, DRIVING = range(4)
"""Phases of the base: neither it nor joints move; joints move; they shake it; it drives."""

MIN_SPREADS = np.array([0.0005, 0.0005, 0.002, 0.0005, 0.005, 0.005])
"""Smallest spread of each output: a step of its sensor."""


@kernel
def _respond(
    inputs: Out[Matrix[FloatArray]],
    count: int,
    sent_speed: FloatArray,
    load_torque: FloatArray,
    legs: IntArray,
    inverse: Matrix[FloatArray],
    response: Block[FloatArray],
    predicted: Out[FloatArray],
) -> float:
    """Take in the tick number ``count``; return the size of the largest commanded base velocity.

    Args:
        inputs: Ring of one row per tick: commanded base twist, load of the legs.
        count: Number of the tick. In the first one, 0, the load is taken as constant before.
        sent_speed: (3,) commanded wheel speeds [rad/s].
        load_torque: (n,) of the joints [N m].
        legs: Indices of the leg joints.
        inverse: (3, 3) from wheel speeds to the base twist.
        response: By tick and input, (6,) response of the outputs.
        predicted: (6,) outputs.
    """
    newest = -count % TAPS  # rows after it are older
    now, total = inputs[newest], 0.0
    for axis in range(3):
        now[axis] = 0.0
        for wheel in range(3):
            now[axis] += inverse[axis, wheel] * sent_speed[wheel]
        total += abs(now[axis])
    for i in range(len(legs)):
        now[3 + i] = load_torque[legs[i]]
        total += abs(now[3 + i])
    if not total < MAX_PLAUSIBLE:  # also for NaN
        # An input that is not valid would spoil the response for TAPS ticks.
        now[:] = inputs[(newest + 1) % TAPS]
    if count == 0:
        inputs[:, 3:] = now[3:]
    predicted[:] = 0.0
    for tap in range(TAPS):
        then = inputs[(newest + tap) % TAPS]
        for i in range(len(then)):
            for output in range(len(predicted)):
                predicted[output] += then[i] * response[tap, i, output]
    return float(max(abs(now[0]), abs(now[1]), abs(now[2])))


@kernel
def _compare(
    predicted: FloatArray,
    wheel_speed: FloatArray,
    inverse: Matrix[FloatArray],
    inertial: FloatArray,
    memory: int,
    repeats: int,
    before: Out[FloatArray],
    missing: Out[IntArray],
    level: Out[FloatArray],
    error: Out[FloatArray],
) -> int:
    """Compute predicted minus measured outputs (6,); return for how many ticks the inertial unit repeats its values.

    Args:
        predicted: (6,) outputs.
        wheel_speed: (3,) measured [rad/s].
        inverse: (3, 3) from wheel speeds to the base twist.
        inertial: (3,) yaw rate [rad/s] and horizontal acceleration [m/s2] as measured.
        memory: Ticks without a value after which its level is unknown.
        repeats: Result for the previous sample.
        before: (3,) ``inertial`` of the previous sample; is set to this one.
        missing: (3,) ticks for which a value of the inertial unit has been missing.
        level: (3,) of the inertial unit; NaN before the first sample, and when a value is missing for long.
        error: (6,) is set; 0 where a value is missing.
    """
    repeats += 1
    for axis in range(3):
        # NaN differs from itself.
        if inertial[axis] != before[axis]:
            repeats = 0
        before[axis] = inertial[axis]
    for axis in range(3):
        error[axis] = predicted[axis]
        for wheel in range(3):
            error[axis] -= inverse[axis, wheel] * wheel_speed[wheel]
        beyond = inertial[axis] - predicted[3 + axis]
        if repeats >= FROZEN_TICKS or not abs(beyond) < MAX_PLAUSIBLE:
            error[3 + axis] = 0.0
            missing[axis] += 1
            if missing[axis] > memory:
                level[axis] = math.nan
            continue
        missing[axis] = 0
        if math.isnan(level[axis]):
            level[axis] = beyond
        error[3 + axis] = level[axis] - beyond
    return repeats


@kernel
def _judge_base(
    filtered: FloatArray, spreads: Records[SpreadState], factor: float, axis: int
) -> tuple[int, float]:
    """Return the output to report, and the norm of all residuals over their thresholds, with its sign.

    The sign of the reported output is that of the contact: it must not change between outputs of similar size.
    ``axis`` is the one reported before.
    """
    largest, square = 0, 0.0
    for output in range(len(filtered)):
        ratio = filtered[output] / spreads[output].today
        square += ratio * ratio
        if abs(ratio) > abs(filtered[largest] / spreads[largest].today):
            largest = output
    before = abs(filtered[axis] / spreads[axis].today)
    if before < QUIET_RATIO * abs(filtered[largest] / spreads[largest].today):
        axis = largest
    return axis, math.copysign(math.sqrt(square) / factor, filtered[axis])


@kernel
def _learn_base(
    spreads: Out[Records[SpreadState]], filtered: FloatArray, smallest: FloatArray, seen: BoolArray
) -> None:
    for output in range(len(filtered)):
        if seen[output]:
            learn_spread(spreads, output, filtered[output], smallest[output])


class BaseGenerator:
    """Residual of the base in units of its threshold: a size above 1 indicates a push.

    It is the norm of the residuals of all outputs, each over its spread (:mod:`~.threshold`): while neither base nor
    joints move, while joints move, while they shake the base, and while it drives. Values that the inertial unit does
    not give, or repeats for FROZEN_TICKS, add nothing to it.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
        false_contacts: That are allowed in an hour.
        adapt: True to follow the spreads of the robot of today.

    Attributes:
        filtered: (6,) residuals of the outputs after the filter.
        seen: (6,) outputs that were measured.
        phase: STILL, MOVING, SHAKING or DRIVING.
    """

    def __init__(
        self,
        model: BaseModel,
        robot: RobotConfig,
        window: int,
        *,
        false_contacts: float,
        adapt: bool,
    ) -> None:
        response = np.array(model.coefficients, dtype=np.float64).reshape(TAPS, -1, len(OUTPUTS))
        # The load enters by its change over the response: accelerations of the limbs move the base, weight does not.
        response[-1, 3:] -= response[:, 3:].sum(axis=0)
        self._response, self._has_unit = response, model.has_inertial_unit
        self._identified = [
            np.maximum(np.array(spread), MIN_SPREADS)
            for spread in (model.still, model.moving, model.shaking, model.driving)
        ]
        self._factor, self._adapt = threshold_factor(false_contacts, TAIL), adapt
        self._legs = np.array(leg_indices(robot), dtype=np.int64)
        self._inverse = np.array(robot.wheels.inverse, dtype=np.float64, order="C")
        self._window, self._standing_delay = window, TAPS + SETTLING_TICKS
        self._pace, self._memory = (
            robot.cycle / CORRECTION_TIME,
            round(CORRECTION_TIME / robot.cycle),
        )
        self._respond, self._compare = _respond.load(), _compare.load()
        self._judge, self._learn = _judge_base.load(), _learn_base.load()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        self._inputs = np.zeros(self._response.shape[:2])
        self._median = RunningMedian(self._window, len(OUTPUTS))
        self._level, self._before = np.full(3, np.nan), np.full(3, np.nan)
        self._missing, self._repeats = np.zeros(3, dtype=np.int64), 0
        self._spreads = [
            make_records(SpreadState, len(OUTPUTS), identified=spread, today=spread)
            for spread in self._identified
        ]
        self.phase = 0
        self._count = 0
        self._standing_ticks, self._still_ticks = self._standing_delay, TAPS
        self._smooth_ticks = TAPS
        self._blind, self._judged = 0, False
        self._last = (np.nan, np.nan)
        self._axis = 0
        self.filtered = np.zeros(len(OUTPUTS))
        self.seen = np.ones(len(OUTPUTS), dtype=np.bool_)

    def step(
        self, tick: Tick, late: bool = False, lost: bool = False, wrong_load: bool = False
    ) -> tuple[float, float]:
        """Take in one tick; return the residual before and after the filter, NaN while it cannot be judged.

        Args:
            tick: The tick.
            late: True if its sample is late. The response is computed for the present time only: the sample is not
                used, and the residual stays as it was.
            lost: True if the sample is too late for that as well.
            wrong_load: True if joints do not follow their commands: the response to their load is not known.
        """
        predicted = self._predict(tick)
        self._judged = False
        if wrong_load:
            self._blind = TAPS + self._window
        elif lost or self._count < TAPS:
            self._blind = max(self._blind, self._window)
        if late or lost:
            return (np.nan, np.nan) if self._blind else self._last
        error = self._error(tick, predicted)
        if not (np.abs(error) < MAX_PLAUSIBLE).all():
            self._blind = max(self._blind, self._window)
            # The median must take in a number: a NaN would spoil the whole window.
            error = np.zeros(len(OUTPUTS))
        self.filtered = self._median.push(error)
        # After the filter: a single sample that is wrong would move the level for seconds.
        self._level -= self._pace * self.filtered[3:]
        if self._standing_ticks < self._standing_delay:
            self.phase = DRIVING
        elif self._smooth_ticks < TAPS:
            self.phase = SHAKING
        else:
            self.phase = MOVING if self._still_ticks < TAPS else STILL
        if self._blind:
            self._blind -= 1
            return np.nan, np.nan
        self._judged = True
        spreads = self._spreads[self.phase]
        self._axis, filtered = self._judge(self.filtered, spreads, self._factor, self._axis)
        _, raw = self._judge(error, spreads, self._factor, self._axis)
        self._last = raw, filtered
        return self._last

    @property
    def drives(self) -> bool:
        """True while the base is commanded to drive, or has just been."""
        return self.phase == DRIVING

    def learn(self) -> None:
        """Learn from the last tick, in which no part of the robot was touched."""
        if self._adapt and self._judged:
            self._learn(self._spreads[self.phase], self.filtered, MIN_SPREADS, self.seen)

    @property
    def misses_inertial_unit(self) -> bool:
        """True if an inertial unit that the model knows has given no values, or the same ones, for CORRECTION_TIME."""
        return self._has_unit and bool((self._missing > self._memory).any())

    def _predict(self, tick: Tick) -> FloatArray:
        """Take in the commands of a tick; return the (6,) predicted outputs."""
        predicted = np.empty(len(OUTPUTS))
        fastest = self._respond(
            self._inputs,
            self._count,
            contiguous(tick.sent.wheel_speed),
            contiguous(tick.reference.load_torque),
            self._legs,
            self._inverse,
            self._response,
            predicted,
        )
        self._count += 1
        self._standing_ticks = self._standing_ticks + 1 if fastest < STANDSTILL_SPEED else 0
        slow = np.abs(tick.reference.velocity).max() < ROCKING_SPEED
        self._still_ticks = self._still_ticks + 1 if slow else 0
        smooth = np.abs(tick.reference.acceleration).max() < SHAKING_ACCELERATION
        self._smooth_ticks = self._smooth_ticks + 1 if smooth else 0
        return predicted

    def _error(self, tick: Tick, predicted: FloatArray) -> FloatArray:
        """Take in the measurement of a tick; return the (6,) predicted minus the measured outputs."""
        measurement, error = tick.measurement, np.empty(len(OUTPUTS))
        inertial = np.empty(3)
        inertial[0] = measurement.imu.angular_velocity[2]
        inertial[1:] = measurement.imu.acceleration[:2]
        self._repeats = self._compare(
            predicted,
            contiguous(measurement.wheel_speed),
            self._inverse,
            inertial,
            self._memory,
            self._repeats,
            self._before,
            self._missing,
            self._level,
            error,
        )
        self.seen[3:] = self._missing == 0
        return error


def leg_indices(robot: RobotConfig) -> list[int]:
    """Return the indices of the leg joints."""
    return [robot.joint_index(name) for name in robot.chains["legs"]]
