"""Expected and measured motion of the wheels: contacts on the base, and on a stiff trunk.

The speed controllers of the wheels are nearly linear, and so is the response of the base to the motion of the limbs. A
finite impulse response predicts the measured twist from the commanded wheel speeds and
the load on the legs.
"""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.detection.threshold import START_FACTOR, ResidualEnvelope
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel
from pepper_driver.observer.running_filters import RunningMedian

BUFFER_ROWS = 10 * TAPS
"""Rows of the buffer of inputs: its content is moved once in nine lengths of the response."""

STANDSTILL_SPEED = 0.005
"""[m/s], [rad/s] Commanded speed below which, for the length of the response, the base counts as standing."""

AXIS_HYSTERESIS = 0.5
"""Fraction of the largest residual down to which the previous axis remains the reported one."""

POST_DRIVE_TIME = 0.3
"""[s] After the response to a drive, in which the bound for driving still applies."""


class BaseGenerator:
    """Residual of the base in units of its bound: a size above 1 indicates a push.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
        adapt: True to widen the bounds by a residual envelope, separately for standing and driving.
    """

    def __init__(self, model: BaseModel, robot: RobotConfig, window: int, *, adapt: bool) -> None:
        response = np.array(model.coefficients).reshape(TAPS, -1, 3)
        # The load enters by its change over the response: accelerations of the limbs move the base, weight does not.
        response[-1, 3:] -= response[:, 3:].sum(axis=0)
        self._response = response.reshape(-1, 3)
        self._inputs_per_tick = response.shape[1]
        self._standing, self._driving = np.array(model.standing), np.array(model.driving)
        self._legs = leg_indices(robot)
        self._inverse = np.asarray(robot.wheels.inverse)
        self._window, self._standing_delay = window, TAPS + round(POST_DRIVE_TIME / robot.cycle)
        self._adapt = adapt
        # Envelopes of the residual in units of its bound, for driving and for standing.
        bound, start = np.ones(3), np.full(3, START_FACTOR)
        self._envelopes = (ResidualEnvelope(bound, start), ResidualEnvelope(bound, start))
        self._everything = np.ones(3, dtype=np.bool_)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        # The newest TAPS rows begin at `_newest`, which moves up: the window of inputs is then a view without a copy.
        self._inputs = np.zeros((BUFFER_ROWS, self._inputs_per_tick))
        self._newest = BUFFER_ROWS - TAPS
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
        inputs = self._append_inputs(tick.sent.wheel_speed, tick.reference.load_torque)
        twist = self._inverse @ tick.measurement.wheel_speed
        seen = math.isfinite(twist[0] + twist[1] + twist[2])
        if late or self._count < TAPS or not seen:
            self._blind = self._window
        error = inputs.ravel() @ self._response - twist
        stands = self._standing_ticks >= self._standing_delay
        ratio = error / (self._standing if stands else self._driving)
        # The median must take in a number: a NaN would spoil the whole window.
        self._filtered = self._median.push(ratio if seen else np.zeros(3))
        self._judged = self._blind == 0
        if not self._judged:
            self._blind -= 1
            return np.nan, np.nan
        factor = self._envelopes[stands].factor if self._adapt else 1.0
        ratio, filtered = ratio / factor, self._filtered / factor
        size = np.abs(filtered)
        # The sign of the reported axis is that of the contact: it must not change between axes of similar size.
        if size[self._axis] < AXIS_HYSTERESIS * size.max():
            self._axis = int(np.argmax(size))
        return float(ratio[self._axis]), float(filtered[self._axis])

    def learn(self, untouched: bool, moving: bool) -> None:
        """Learn from the last tick: whether the robot was untouched, and whether joints were to move."""
        stands = self._standing_ticks >= self._standing_delay
        if not untouched:
            for envelope in self._envelopes:
                envelope.touched()
        elif self._judged:
            moved = self._everything & (moving or not stands)
            self._envelopes[stands].learn(self._filtered, self._everything, moved)

    def _append_inputs(self, wheel_speed: FloatArray, load_torque: FloatArray) -> FloatArray:
        """Append commanded wheel speeds and load of the legs; return the inputs of the response, newest first."""
        if self._newest == 0:
            self._newest = BUFFER_ROWS - TAPS
            self._inputs[self._newest + 1 :] = self._inputs[: TAPS - 1]
        else:
            self._newest -= 1
        inputs = self._inputs[self._newest : self._newest + TAPS]
        now = inputs[0]
        now[:3] = self._inverse @ wheel_speed
        now[3:] = load_torque.take(self._legs)
        # An input that is not finite would spoil the response for TAPS ticks.
        if not math.isfinite(now.sum()):
            now[:] = inputs[1]
        if self._count == 0:
            inputs[:, 3:] = now[3:]
        self._count += 1
        fastest = max(abs(sent) for sent in now[:3].tolist())
        self._standing_ticks = self._standing_ticks + 1 if fastest < STANDSTILL_SPEED else 0
        return inputs


def leg_indices(robot: RobotConfig) -> list[int]:
    """Return the indices of the leg joints."""
    return [robot.joint_index(name) for name in robot.chains["legs"]]
