"""Expected and measured motion of the base: contacts on it, and on a stiff trunk.

The speed controllers of the wheels are nearly linear, and so is the response of the base to the motion of the limbs. A
finite impulse response predicts the twist that the wheels measure, and what the inertial unit measures, from the
commanded wheel speeds and the load on the legs.
"""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Block, Matrix, Out, Records, kernel, make_records
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    HELD_FACTOR,
    QUIET_RATIO,
    REPORT_DELAY,
    REST_SPEED,
    ROCKING_SPEED,
    SETTLING_TICKS,
    SHAKING_ACCELERATION,
    TAIL,
)
from pepper_driver.observer.detection.threshold import (
    SpreadState,
    learn_spread,
    threshold_factor,
)
from pepper_driver.observer.interface import MAX_PLAUSIBLE
from pepper_driver.observer.models.fusion_model import OUTPUTS, TAPS, BaseModel
from pepper_driver.observer.running_filters import RunningMedian, push_median

FROZEN_TICKS = 2
"""From which on values that the inertial unit repeats count as missing: the filter takes out fewer."""

STILL, MOVING, SHAKING, DRIVING = range(4)
"""Phases of the base: neither it nor joints move; joints move; they shake it; it drives."""

MIN_SPREADS = np.array([0.0005, 0.0005, 0.002, 0.0005, 0.005, 0.005])
"""Smallest spread of each output: a step of its sensor."""


class BaseState:
    """Constants and state of the base.

    Attributes:
        settling: Ticks after which it has settled from a command to move, or from joints that shook it.
        memory: Ticks without a value of the inertial unit after which its level is unknown.
        pace: Fraction of a residual by which the level of the inertial unit follows it in a tick.
        factor: Of thresholds over spreads.
        standing: Ticks since a wheel was commanded to turn faster than REST_SPEED.
        still: Ticks since a joint was commanded to move faster than ROCKING_SPEED, or to accelerate or brake so that
            it changes its speed by as much within REPORT_DELAY.
        smooth: Ticks since a joint was commanded to accelerate faster than SHAKING_ACCELERATION.
        repeats: Ticks for which the inertial unit has repeated its values.
    """

    settling: int
    memory: int
    pace: float
    factor: float
    standing: int
    still: int
    smooth: int
    repeats: int


class BaseOutput:
    """One output of the base. The last three values are of the inertial unit, whose outputs alone have them.

    Attributes:
        predicted: By the commands of the last tick.
        error: Predicted minus measured, in the last sample; 0 where it is not measured.
        filtered: The same, filtered.
        seen: True if it was measured.
        value: In the previous sample; NaN before the first one.
        missing: Ticks for which it has been missing.
        level: Mean of the value that was not predicted; NaN before the first sample, and when it is missing for long.
    """

    predicted: float
    error: float
    filtered: float
    seen: bool
    value: float
    missing: int
    level: float


@kernel
def _respond(
    state: Out[Records[BaseState]],
    outputs: Out[Records[BaseOutput]],
    inputs: Out[Matrix[FloatArray]],
    count: int,
    sent_speed: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    legs: IntArray,
    inverse: Matrix[FloatArray],
    response: Block[FloatArray],
) -> int:
    """Take in the commands of the tick number ``count``; return the phase of the base.

    Args:
        state: (1,) of the base.
        outputs: (6,) whose predictions are set.
        inputs: Ring of one row per tick: commanded base twist, load of the legs.
        count: Number of the tick. In the first one, 0, the load is taken as constant before.
        sent_speed: (3,) commanded wheel speeds [rad/s].
        load_torque: (n,) of the joints [N m].
        velocity: (n,) desired [rad/s].
        acceleration: (n,) desired [rad/s2].
        legs: Indices of the leg joints.
        inverse: (3, 3) from wheel speeds to the base twist.
        response: By tick and input, (6,) response of the outputs.
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
    predicted = np.zeros(len(outputs))
    for tap in range(TAPS):
        then = inputs[(newest + tap) % TAPS]
        for i in range(len(then)):
            for output in range(len(predicted)):
                predicted[output] += then[i] * response[tap, i, output]
    for output in range(len(outputs)):
        outputs[output].predicted = predicted[output]
    base = state[0]
    base.standing += 1
    base.still += 1
    base.smooth += 1
    # NaN compares as False.
    for wheel in range(3):
        if not abs(sent_speed[wheel]) < REST_SPEED:
            base.standing = 0
    for j in range(len(velocity)):
        if not (
            abs(velocity[j]) < ROCKING_SPEED and REPORT_DELAY * abs(acceleration[j]) < ROCKING_SPEED
        ):
            base.still = 0
        if not abs(acceleration[j]) < SHAKING_ACCELERATION:
            base.smooth = 0
    if base.standing < base.settling:
        return DRIVING
    if base.smooth < base.settling:
        return SHAKING
    return MOVING if base.still < TAPS else STILL


@kernel
def _compare(
    state: Out[Records[BaseState]],
    outputs: Out[Records[BaseOutput]],
    inverse: Matrix[FloatArray],
    wheel_speed: FloatArray,
    angular_velocity: FloatArray,
    acceleration: FloatArray,
) -> bool:
    """Compute the errors of the outputs, all 0 if they are not valid; return True if they are.

    Args:
        state: (1,) of the base.
        outputs: (6,) with their predictions.
        inverse: (3, 3) from wheel speeds to the base twist.
        wheel_speed: (3,) measured [rad/s].
        angular_velocity: (3,) of the inertial unit [rad/s].
        acceleration: (3,) of the inertial unit [m/s2].
    """
    base = state[0]
    base.repeats += 1
    for axis in range(3):
        value = angular_velocity[2] if axis == 0 else acceleration[axis - 1]
        # NaN differs from itself.
        if value != outputs[3 + axis].value:
            base.repeats = 0
        outputs[3 + axis].value = value
    valid = True
    for axis in range(3):
        by_wheels, by_unit = outputs[axis], outputs[3 + axis]
        by_wheels.error = by_wheels.predicted
        for wheel in range(3):
            by_wheels.error -= inverse[axis, wheel] * wheel_speed[wheel]
        beyond = by_unit.value - by_unit.predicted
        by_unit.seen = base.repeats < FROZEN_TICKS and abs(beyond) < MAX_PLAUSIBLE
        valid = valid and abs(by_wheels.error) < MAX_PLAUSIBLE
        if not by_unit.seen:
            by_unit.error = 0.0
            by_unit.missing += 1
            if by_unit.missing > base.memory:
                by_unit.level = math.nan
            continue
        by_unit.missing = 0
        if math.isnan(by_unit.level):
            by_unit.level = beyond
        by_unit.error = by_unit.level - beyond
        valid = valid and abs(by_unit.error) < MAX_PLAUSIBLE
    if not valid:
        for output in range(len(outputs)):
            outputs[output].error = 0.0
    return valid


@kernel
def _norm(
    filtered: FloatArray, spreads: Records[SpreadState], phase: int, factor: float, axis: int
) -> tuple[int, float]:
    """Return the output to report, and the norm of all residuals over their thresholds, with its sign.

    The sign of the reported output is that of the contact: it must not change between outputs of similar size.
    ``axis`` is the one reported before.
    """
    largest, square, first = 0, 0.0, phase * len(filtered)
    for output in range(len(filtered)):
        ratio = filtered[output] / spreads[first + output].today
        square += ratio * ratio
        if abs(ratio) > abs(filtered[largest] / spreads[first + largest].today):
            largest = output
    before = abs(filtered[axis] / spreads[first + axis].today)
    if before < QUIET_RATIO * abs(filtered[largest] / spreads[first + largest].today):
        axis = largest
    return axis, math.copysign(math.sqrt(square) / factor, filtered[axis])


@kernel
def _take_in(
    state: Out[Records[BaseState]],
    outputs: Out[Records[BaseOutput]],
    inverse: Matrix[FloatArray],
    wheel_speed: FloatArray,
    angular_velocity: FloatArray,
    acceleration: FloatArray,
    rings: Out[Matrix[FloatArray]],
    count: int,
    ordered: Out[FloatArray],
    spreads: Records[SpreadState],
    phase: int,
    axis: int,
) -> tuple[bool, int, float, float]:
    """Compare a sample with the prediction, and filter it.

    The arguments are those of ``_compare``, ``push_median`` and ``_norm``.

    Returns:
        True if all values are valid; the output to report; the norms before and after the filter.
    """
    valid = _compare(state, outputs, inverse, wheel_speed, angular_velocity, acceleration)
    base, error, filtered = state[0], np.empty(len(outputs)), np.empty(len(outputs))
    for i in range(len(outputs)):
        output = outputs[i]
        error[i] = output.error
        # The median must take in a number: a NaN would spoil the whole window.
        filtered[i] = output.filtered = push_median(rings, i, count, output.error, ordered)
        # After the filter: a single sample that is wrong would move the level for seconds.
        output.level -= base.pace * output.filtered
    factor = base.factor
    if phase in (MOVING, SHAKING):
        # A joint that breaks away sooner or later than its model pushes the base.
        factor *= HELD_FACTOR
    axis, residual = _norm(filtered, spreads, phase, factor, axis)
    _, raw = _norm(error, spreads, phase, factor, axis)
    return valid, axis, raw, residual


@kernel
def _learn(
    spreads: Out[Records[SpreadState]],
    phase: int,
    outputs: Records[BaseOutput],
    min_spreads: FloatArray,
) -> None:
    count = len(outputs)
    for i in range(count):
        if outputs[i].seen:
            learn_spread(spreads, phase * count + i, outputs[i].filtered, min_spreads[i])


class BaseGenerator:
    """Residual of the base in units of its threshold: a size above 1 indicates a push.

    It is the norm of the residuals of all outputs, each over its spread (:mod:`~.threshold`): while neither base nor
    joints move, while joints move, while they shake the base, and while it drives. While joints move its threshold is
    HELD_FACTOR times as high. Values that the inertial unit does
    not give, or repeats for FROZEN_TICKS, add nothing to it.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
        false_contacts: That are allowed in an hour.
        adapt: True to follow the spreads of the robot of today.

    Attributes:
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
        # By phase and output.
        spreads = np.array((model.still, model.moving, model.shaking, model.driving))
        self._identified = np.maximum(spreads, MIN_SPREADS).ravel()
        self._factor, self._adapt = threshold_factor(false_contacts, TAIL), adapt
        self._legs = np.array(leg_indices(robot), dtype=np.int64)
        self._inverse = np.array(robot.wheels.inverse, dtype=np.float64, order="C")
        self._window, self._settling = window, TAPS + SETTLING_TICKS
        self._pace, self._memory = (
            robot.cycle / CORRECTION_TIME,
            round(CORRECTION_TIME / robot.cycle),
        )
        self._respond, self._take_in = _respond.load_unchecked(), _take_in.load_unchecked()
        self._learn = _learn.load_unchecked()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        self._inputs = np.zeros(self._response.shape[:2])
        self._median = RunningMedian(self._window, len(OUTPUTS))
        self._state = make_records(
            BaseState,
            1,
            settling=self._settling,
            memory=self._memory,
            pace=self._pace,
            factor=self._factor,
            standing=self._settling,
            still=TAPS,
            smooth=self._settling,
        )
        # Levels of the first three outputs, which have none, stay NaN.
        self._outputs = make_records(
            BaseOutput, len(OUTPUTS), seen=True, value=np.nan, level=np.nan
        )
        self._spreads = make_records(
            SpreadState, len(self._identified), identified=self._identified, today=self._identified
        )
        self.phase = 0
        self._count = 0
        self._blind, self._judged = 0, False
        self._last = (np.nan, np.nan)
        self._axis = 0

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
        measurement, reference, median = tick.measurement, tick.reference, self._median
        self.phase = self._respond(
            self._state,
            self._outputs,
            self._inputs,
            self._count,
            tick.sent.wheel_speed,
            reference.load_torque,
            reference.velocity,
            reference.acceleration,
            self._legs,
            self._inverse,
            self._response,
        )
        self._count += 1
        self._judged = False
        if wrong_load:
            self._blind = TAPS + self._window
        elif lost or self._count < TAPS:
            self._blind = max(self._blind, self._window)
        if late or lost:
            return (np.nan, np.nan) if self._blind else self._last
        valid, axis, raw, filtered = self._take_in(
            self._state,
            self._outputs,
            self._inverse,
            measurement.wheel_speed,
            measurement.imu.angular_velocity,
            measurement.imu.acceleration,
            median.rings,
            median.count,
            median.ordered,
            self._spreads,
            self.phase,
            self._axis,
        )
        median.count += 1
        if not valid:
            self._blind = max(self._blind, self._window)
        if self._blind:
            self._blind -= 1
            return np.nan, np.nan
        self._judged, self._axis, self._last = True, axis, (raw, filtered)
        return self._last

    @property
    def filtered(self) -> FloatArray:
        """(6,) residuals of the outputs after the filter."""
        return self._outputs["filtered"].copy()

    @property
    def seen(self) -> BoolArray:
        """(6,) outputs that were measured."""
        return self._outputs["seen"].copy()

    @property
    def drives(self) -> bool:
        """True while the base is commanded to drive, or has just been."""
        return self.phase == DRIVING

    @property
    def shakes(self) -> bool:
        """True while joints shake the base, or have just done so."""
        return self.phase == SHAKING

    def learn(self) -> None:
        """Learn from the last tick, in which no part of the robot was touched."""
        if self._adapt and self._judged:
            self._learn(self._spreads, self.phase, self._outputs, MIN_SPREADS)

    @property
    def misses_inertial_unit(self) -> bool:
        """True if an inertial unit that the model knows has given no values, or the same ones, for CORRECTION_TIME."""
        return self._has_unit and bool((self._outputs["missing"] > self._memory).any())


def leg_indices(robot: RobotConfig) -> list[int]:
    """Return the indices of the leg joints."""
    return [robot.joint_index(name) for name in robot.chains["legs"]]
