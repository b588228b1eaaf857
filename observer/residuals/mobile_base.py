"""Expected and measured motion of the wheels: contacts on the base, and on a stiff trunk.

The speed controllers of the wheels are nearly linear, and so is the response of the base to the motion of the limbs. A
finite impulse response predicts the measured twist from the commanded wheel speeds and
the load on the legs.
"""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray, IntArray, contiguous
from pepper_driver.config.kernels import Block, Matrix, Out, Records, kernel
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.detection.threshold import START_FACTOR, Envelope, ResidualEnvelope
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel
from pepper_driver.observer.running_filters import RunningMedian

STANDSTILL_SPEED = 0.005
"""[m/s], [rad/s] Commanded speed below which, for the length of the response, the base counts as standing."""

AXIS_HYSTERESIS = 0.5
"""Fraction of the largest residual down to which the previous axis remains the reported one."""

POST_DRIVE_TIME = 0.3
"""[s] After the response to a drive, in which the bound for driving still applies."""


@kernel
def _respond(
    inputs: Out[Matrix[FloatArray]],
    count: int,
    sent_speed: FloatArray,
    measured_speed: FloatArray,
    load_torque: FloatArray,
    legs: IntArray,
    inverse: Matrix[FloatArray],
    response: Block[FloatArray],
    error: Out[FloatArray],
) -> float:
    """Take in the tick number ``count``; return the size of the largest commanded base velocity.

    Args:
        inputs: Ring of one row per tick: commanded base twist, load of the legs.
        count: Number of the tick. In the first one, 0, the load is taken as constant before.
        sent_speed: (3,) commanded wheel speeds [rad/s].
        measured_speed: (3,) measured wheel speeds [rad/s].
        load_torque: (n,) of the joints [N m].
        legs: Indices of the leg joints.
        inverse: (3, 3) from wheel speeds to the base twist.
        response: By tick and input, (3,) response of the base twist.
        error: (3,) predicted minus measured twist of the base.
    """
    newest = -count % TAPS  # rows after it are older
    now, total = inputs[newest], 0.0
    for axis in range(3):
        now[axis], error[axis] = 0.0, 0.0
        for wheel in range(3):
            now[axis] += inverse[axis, wheel] * sent_speed[wheel]
            error[axis] -= inverse[axis, wheel] * measured_speed[wheel]
        total += now[axis]
    for i in range(len(legs)):
        now[3 + i] = load_torque[legs[i]]
        total += now[3 + i]
    if not math.isfinite(total):
        # An input that is not finite would spoil the response for TAPS ticks.
        now[:] = inputs[(newest + 1) % TAPS]
    if count == 0:
        inputs[:, 3:] = now[3:]
    vx, vy, wz = 0.0, 0.0, 0.0
    for tap in range(TAPS):
        then = inputs[(newest + tap) % TAPS]
        for i in range(len(then)):
            vx += then[i] * response[tap, i, 0]
            vy += then[i] * response[tap, i, 1]
            wz += then[i] * response[tap, i, 2]
    error[0], error[1], error[2] = error[0] + vx, error[1] + vy, error[2] + wz
    return float(max(abs(now[0]), abs(now[1]), abs(now[2])))


@kernel
def _select_axis(
    ratio: FloatArray, filtered: FloatArray, envelopes: Records[Envelope], axis: int
) -> tuple[int, float, float]:
    """Return the axis to report, and its residual before and after the filter, in units of its widened bound.

    The sign of the reported axis is that of the contact: it must not change between axes of similar size.

    Args:
        ratio: (3,) residual of the twist in units of its bound.
        filtered: (3,) the same after the filter.
        envelopes: Of the axes.
        axis: The one reported before.
    """
    largest = 0
    for other in range(1, 3):
        size = abs(filtered[other] / envelopes[other].factor)
        if size > abs(filtered[largest] / envelopes[largest].factor):
            largest = other
    size = abs(filtered[axis] / envelopes[axis].factor)
    if size < AXIS_HYSTERESIS * abs(filtered[largest] / envelopes[largest].factor):
        axis = largest
    factor = envelopes[axis].factor
    return axis, ratio[axis] / factor, filtered[axis] / factor


class BaseGenerator:
    """Residual of the base in units of its bound: a size above 1 indicates a push.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
        adapt: True to widen the bounds by a residual envelope, separately for standing and driving.
    """

    def __init__(self, model: BaseModel, robot: RobotConfig, window: int, *, adapt: bool) -> None:
        response = np.array(model.coefficients, dtype=np.float64).reshape(TAPS, -1, 3)
        # The load enters by its change over the response: accelerations of the limbs move the base, weight does not.
        response[-1, 3:] -= response[:, 3:].sum(axis=0)
        self._response = response
        self._standing, self._driving = np.array(model.standing), np.array(model.driving)
        self._legs = np.array(leg_indices(robot), dtype=np.int64)
        self._inverse = np.array(robot.wheels.inverse, dtype=np.float64, order="C")
        self._window, self._standing_delay = window, TAPS + round(POST_DRIVE_TIME / robot.cycle)
        # Envelopes of the residual in units of its bound, for driving and for standing.
        bound, start = np.ones(3), np.full(3, START_FACTOR if adapt else 1.0)
        self._envelopes = (ResidualEnvelope(bound, start), ResidualEnvelope(bound, start))
        self._everything, self._nothing = np.ones(3, dtype=np.bool_), np.zeros(3, dtype=np.bool_)
        self._no_residual = np.zeros(3)
        self._respond, self._select_axis = _respond.load(), _select_axis.load()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        self._inputs = np.zeros(self._response.shape[:2])
        self._median = RunningMedian(self._window, 3)
        self._count = 0
        self._standing_ticks = self._standing_delay
        self._blind = 0
        self._axis = 0
        for envelope in self._envelopes:
            envelope.reset()
        self._judged = False

    def step(self, tick: Tick, late: bool) -> tuple[float, float]:
        """Take in one tick; return the residual before and after the filter, NaN while it cannot be judged.

        Args:
            tick: The tick.
            late: True if its sample is late: the response is computed for the present time only.
        """
        error = self._error(tick)
        seen = all(map(math.isfinite, error.tolist()))
        if late or self._count < TAPS or not seen:
            self._blind = self._window
        stands = self._standing_ticks >= self._standing_delay
        # The median must take in a number: a NaN would spoil the whole window.
        ratio = self._no_residual
        if seen:
            ratio = error / (self._standing if stands else self._driving)
        self._filtered = self._median.push(ratio)
        self._judged = self._blind == 0
        if not self._judged:
            self._blind -= 1
            return np.nan, np.nan
        self._axis, raw, filtered = self._select_axis(
            ratio, self._filtered, self._envelopes[stands].envelopes, self._axis
        )
        return raw, filtered

    def learn(self, untouched: bool, moving: bool) -> None:
        """Learn from the last tick: whether the robot was untouched, and whether joints were to move."""
        stands = self._standing_ticks >= self._standing_delay
        if not untouched:
            for envelope in self._envelopes:
                envelope.touched()
        elif self._judged:
            moved = self._everything if moving or not stands else self._nothing
            self._envelopes[stands].learn(self._filtered, self._everything, moved)

    def _error(self, tick: Tick) -> FloatArray:
        """Take in a tick; return the (3,) predicted minus the measured twist."""
        error = np.empty(3)
        fastest = self._respond(
            self._inputs,
            self._count,
            contiguous(tick.sent.wheel_speed),
            contiguous(tick.measurement.wheel_speed),
            contiguous(tick.reference.load_torque),
            self._legs,
            self._inverse,
            self._response,
            error,
        )
        self._count += 1
        self._standing_ticks = self._standing_ticks + 1 if fastest < STANDSTILL_SPEED else 0
        return error


def leg_indices(robot: RobotConfig) -> list[int]:
    """Return the indices of the leg joints."""
    return [robot.joint_index(name) for name in robot.chains["legs"]]
