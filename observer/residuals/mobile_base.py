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


class BaseTicks:
    """Ticks since an event of the commands.

    Attributes:
        standing: Since a wheel was commanded to turn faster than REST_SPEED.
        still: Since a joint was commanded to move faster than ROCKING_SPEED.
        smooth: Since a joint was commanded to accelerate faster than SHAKING_ACCELERATION.
    """

    standing: int
    still: int
    smooth: int


@kernel
def _respond(
    inputs: Out[Matrix[FloatArray]],
    count: int,
    sent_speed: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    legs: IntArray,
    inverse: Matrix[FloatArray],
    response: Block[FloatArray],
    settling: int,
    ticks: Out[Records[BaseTicks]],
    predicted: Out[FloatArray],
) -> int:
    """Take in the commands of the tick number ``count``; return the phase of the base.

    Args:
        inputs: Ring of one row per tick: commanded base twist, load of the legs.
        count: Number of the tick. In the first one, 0, the load is taken as constant before.
        sent_speed: (3,) commanded wheel speeds [rad/s].
        load_torque: (n,) of the joints [N m].
        velocity: (n,) desired [rad/s].
        acceleration: (n,) desired [rad/s2].
        legs: Indices of the leg joints.
        inverse: (3, 3) from wheel speeds to the base twist.
        response: By tick and input, (6,) response of the outputs.
        settling: Ticks after which the base has settled from a command to move, or from joints that shook it.
        ticks: (1,) since events.
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
    since = ticks[0]
    since.standing += 1
    since.still += 1
    since.smooth += 1
    # NaN compares as False.
    for wheel in range(3):
        if not abs(sent_speed[wheel]) < REST_SPEED:
            since.standing = 0
    for j in range(len(velocity)):
        if not abs(velocity[j]) < ROCKING_SPEED:
            since.still = 0
        if not abs(acceleration[j]) < SHAKING_ACCELERATION:
            since.smooth = 0
    if since.standing < settling:
        return DRIVING
    if since.smooth < settling:
        return SHAKING
    return MOVING if since.still < TAPS else STILL


@kernel
def _compare(
    predicted: FloatArray,
    wheel_speed: FloatArray,
    inverse: Matrix[FloatArray],
    angular_velocity: FloatArray,
    acceleration: FloatArray,
    memory: int,
    inertial: Out[FloatArray],
    repeats: Out[IntArray],
    missing: Out[IntArray],
    level: Out[FloatArray],
    seen: Out[BoolArray],
    error: Out[FloatArray],
) -> bool:
    """Compute predicted minus measured outputs (6,), all 0 if they are not valid; return True if they are.

    Args:
        predicted: (6,) outputs.
        wheel_speed: (3,) measured [rad/s].
        inverse: (3, 3) from wheel speeds to the base twist.
        angular_velocity: (3,) of the inertial unit [rad/s].
        acceleration: (3,) of the inertial unit [m/s2].
        memory: Ticks without a value after which its level is unknown.
        inertial: (3,) yaw rate and horizontal acceleration of the previous sample; is set to those of this one.
        repeats: (1,) ticks for which the inertial unit has repeated its values.
        missing: (3,) ticks for which a value of the inertial unit has been missing.
        level: (3,) of the inertial unit; NaN before the first sample, and when a value is missing for long.
        seen: (6,) outputs that were measured.
        error: (6,) is set; 0 where a value is missing.
    """
    repeats[0] += 1
    for axis in range(3):
        value = angular_velocity[2] if axis == 0 else acceleration[axis - 1]
        # NaN differs from itself.
        if value != inertial[axis]:
            repeats[0] = 0
        inertial[axis] = value
    valid = True
    for axis in range(3):
        error[axis] = predicted[axis]
        for wheel in range(3):
            error[axis] -= inverse[axis, wheel] * wheel_speed[wheel]
        beyond = inertial[axis] - predicted[3 + axis]
        seen[3 + axis] = repeats[0] < FROZEN_TICKS and abs(beyond) < MAX_PLAUSIBLE
        valid = valid and abs(error[axis]) < MAX_PLAUSIBLE
        if not seen[3 + axis]:
            error[3 + axis] = 0.0
            missing[axis] += 1
            if missing[axis] > memory:
                level[axis] = math.nan
            continue
        missing[axis] = 0
        if math.isnan(level[axis]):
            level[axis] = beyond
        error[3 + axis] = level[axis] - beyond
        valid = valid and abs(error[3 + axis]) < MAX_PLAUSIBLE
    if not valid:
        error[:] = 0.0
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
def _step(
    inputs: Out[Matrix[FloatArray]],
    count: int,
    sent_speed: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    desired_acceleration: FloatArray,
    legs: IntArray,
    inverse: Matrix[FloatArray],
    response: Block[FloatArray],
    settling: int,
    ticks: Out[Records[BaseTicks]],
    sampled: bool,
    wheel_speed: FloatArray,
    angular_velocity: FloatArray,
    acceleration: FloatArray,
    memory: int,
    inertial: Out[FloatArray],
    repeats: Out[IntArray],
    missing: Out[IntArray],
    level: Out[FloatArray],
    seen: Out[BoolArray],
    rings: Out[Matrix[FloatArray]],
    samples: int,
    ordered: Out[FloatArray],
    spreads: Records[SpreadState],
    factor: float,
    axis: int,
    pace: float,
    filtered: Out[FloatArray],
) -> tuple[int, bool, int, float, float]:
    """Take in the commands of a tick; if it is ``sampled``, compare its sample with the prediction, and filter it.

    The arguments are those of ``_respond``, ``_compare`` and ``push_median``.

    Returns:
        The phase of the base; True if all values are valid; the output to report; the norms before and after the
        filter.
    """
    predicted, error = np.empty_like(filtered), np.empty_like(filtered)
    phase = _respond(
        inputs,
        count,
        sent_speed,
        load_torque,
        velocity,
        desired_acceleration,
        legs,
        inverse,
        response,
        settling,
        ticks,
        predicted,
    )
    if not sampled:
        return phase, True, axis, math.nan, math.nan
    valid = _compare(
        predicted,
        wheel_speed,
        inverse,
        angular_velocity,
        acceleration,
        memory,
        inertial,
        repeats,
        missing,
        level,
        seen,
        error,
    )
    for output in range(len(filtered)):
        # The median must take in a number: a NaN would spoil the whole window.
        filtered[output] = push_median(rings, output, samples, error[output], ordered)
    for i in range(len(level)):
        # After the filter: a single sample that is wrong would move the level for seconds.
        level[i] -= pace * filtered[3 + i]
    if phase in (MOVING, SHAKING):
        # A joint that breaks away sooner or later than its model pushes the base.
        factor *= HELD_FACTOR
    axis, residual = _norm(filtered, spreads, phase, factor, axis)
    _, raw = _norm(error, spreads, phase, factor, axis)
    return phase, valid, axis, raw, residual


@kernel
def _learn(
    spreads: Out[Records[SpreadState]],
    phase: int,
    filtered: FloatArray,
    smallest: FloatArray,
    seen: BoolArray,
) -> None:
    count = len(filtered)
    for output in range(count):
        if seen[output]:
            learn_spread(spreads, phase * count + output, filtered[output], smallest[output])


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
        self._step, self._learn = _step.load_unchecked(), _learn.load_unchecked()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        self._inputs = np.zeros(self._response.shape[:2])
        self._median = RunningMedian(self._window, len(OUTPUTS))
        self._level, self._inertial = np.full(3, np.nan), np.full(3, np.nan)
        self._missing, self._repeats = np.zeros(3, dtype=np.int64), np.zeros(1, dtype=np.int64)
        self._spreads = make_records(
            SpreadState, len(self._identified), identified=self._identified, today=self._identified
        )
        self.phase = 0
        self._count = 0
        self._ticks = make_records(
            BaseTicks, 1, standing=self._settling, still=TAPS, smooth=self._settling
        )
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
        measurement, reference, median = tick.measurement, tick.reference, self._median
        sampled = not (late or lost)
        if sampled:
            self.filtered = np.empty(len(OUTPUTS))
        self.phase, valid, axis, raw, filtered = self._step(
            self._inputs,
            self._count,
            tick.sent.wheel_speed,
            reference.load_torque,
            reference.velocity,
            reference.acceleration,
            self._legs,
            self._inverse,
            self._response,
            self._settling,
            self._ticks,
            sampled,
            measurement.wheel_speed,
            measurement.imu.angular_velocity,
            measurement.imu.acceleration,
            self._memory,
            self._inertial,
            self._repeats,
            self._missing,
            self._level,
            self.seen,
            median.rings,
            median.count,
            median.ordered,
            self._spreads,
            self._factor,
            self._axis,
            self._pace,
            self.filtered,
        )
        self._count += 1
        self._judged = False
        if wrong_load:
            self._blind = TAPS + self._window
        elif lost or self._count < TAPS:
            self._blind = max(self._blind, self._window)
        if not sampled:
            return (np.nan, np.nan) if self._blind else self._last
        median.count += 1
        if not valid:
            self._blind = max(self._blind, self._window)
        if self._blind:
            self._blind -= 1
            return np.nan, np.nan
        self._judged, self._axis, self._last = True, axis, (raw, filtered)
        return self._last

    @property
    def drives(self) -> bool:
        """True while the base is commanded to drive, or has just been."""
        return self.phase == DRIVING

    def learn(self) -> None:
        """Learn from the last tick, in which no part of the robot was touched."""
        if self._adapt and self._judged:
            self._learn(self._spreads, self.phase, self.filtered, MIN_SPREADS, self.seen)

    @property
    def misses_inertial_unit(self) -> bool:
        """True if an inertial unit that the model knows has given no values, or the same ones, for CORRECTION_TIME."""
        return self._has_unit and bool((self._missing > self._memory).any())


def leg_indices(robot: RobotConfig) -> list[int]:
    """Return the indices of the leg joints."""
    return [robot.joint_index(name) for name in robot.chains["legs"]]
