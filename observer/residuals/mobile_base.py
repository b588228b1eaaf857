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
from pepper_driver.config.kernels import Block, Matrix, Out, kernel
from pepper_driver.controller.tick import Tick
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
def _select_axis(filtered: FloatArray, axis: int) -> int:
    """Return the axis to report, with the largest (3,) residual in units of its bound.

    The sign of the reported axis is that of the contact: it must not change between axes of similar size. ``axis`` is
    the one reported before.
    """
    largest = 0
    for other in range(1, 3):
        if abs(filtered[other]) > abs(filtered[largest]):
            largest = other
    return largest if abs(filtered[axis]) < AXIS_HYSTERESIS * abs(filtered[largest]) else axis


class BaseGenerator:
    """Residual of the base in units of its bound: a size above 1 indicates a push.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
    """

    def __init__(self, model: BaseModel, robot: RobotConfig, window: int) -> None:
        response = np.array(model.coefficients, dtype=np.float64).reshape(TAPS, -1, 3)
        # The load enters by its change over the response: accelerations of the limbs move the base, weight does not.
        response[-1, 3:] -= response[:, 3:].sum(axis=0)
        self._response = response
        self._standing, self._driving = np.array(model.standing), np.array(model.driving)
        self._legs = np.array(leg_indices(robot), dtype=np.int64)
        self._inverse = np.array(robot.wheels.inverse, dtype=np.float64, order="C")
        self._window, self._standing_delay = window, TAPS + round(POST_DRIVE_TIME / robot.cycle)
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
        filtered = self._median.push(ratio)
        if self._blind:
            self._blind -= 1
            return np.nan, np.nan
        self._axis = self._select_axis(filtered, self._axis)
        return float(ratio[self._axis]), float(filtered[self._axis])

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
