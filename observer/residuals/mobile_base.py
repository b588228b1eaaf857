"""Expected and measured motion of the wheels: contacts on the base, and on a stiff trunk.

The wheels' speed controllers answer their set-points nearly linearly, and so does the base to the limbs that the robot
throws about: a finite impulse response from what was sent, and from the load on the legs, predicts the measured twist.
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

ROWS = 10 * TAPS
"""Of the memory of inputs: it is moved once in nine responses."""


STANDSTILL_SPEED = 0.005
"""[m/s], [rad/s] A base that has been sent no faster for the length of the response stands."""


AXIS_HYSTERESIS = 0.5
"""Share of the largest residual at which the axis that told before goes on to tell."""

POST_DRIVE_TIME = 0.3
"""[s] After the response to a drive, for which its bound stays."""


class BaseGenerator:
    """Residual of the base, as a share of its bound: beyond 1 in size, something pushes.

    Args:
        model: Of the base.
        robot: Its description.
        window: Samples of the median.
        adapt: Whether to follow how far the base strays today, standing and driving.
    """

    def __init__(self, model: BaseModel, robot: RobotConfig, window: int, *, adapt: bool) -> None:
        response = np.array(model.coefficients).reshape(TAPS, -1, 3)
        # The load enters by its change over the response: the base feels accelerations, not weight.
        response[-1, 3:] -= response[:, 3:].sum(axis=0)
        self._response = response.reshape(-1, 3)
        self._inputs_per_tick = response.shape[1]
        self._standing, self._driving = np.array(model.standing), np.array(model.driving)
        self._legs = leg_indices(robot)
        self._inverse = np.asarray(robot.wheels.inverse)
        self._window, self._still = window, TAPS + round(POST_DRIVE_TIME / robot.cycle)
        self._adapt = adapt
        # Of the residual as a share of its bound: standing is the second.
        bound, start = np.ones(3), np.full(3, START_FACTOR)
        self._strays = (ResidualEnvelope(bound, start), ResidualEnvelope(bound, start))
        self._everything = np.ones(3, dtype=np.bool_)
        self.reset()

    def reset(self) -> None:
        """Forget everything but the model."""
        # The newest TAPS rows stand at `_newest`; it moves up, and back to the end when it has come to the top.
        self._inputs = np.zeros((ROWS, self._inputs_per_tick))
        self._newest = ROWS - TAPS
        self._median = RunningMedian(self._window, 3)
        self._count = 0
        self._standing_ticks = self._still
        self._blind = 0
        self._axis = 0
        for strays in self._strays:
            strays.reset()
        self._judged = False

    def step(self, tick: Tick, late: bool) -> tuple[float, float]:
        """Take in one tick; the residual before and after the filter, NaN while it cannot be judged.

        Args:
            tick: The cycle.
            late: Whether its sample is late: wheels tell their speed of now only.
        """
        inputs = self._remember(tick.sent.wheel_speed, tick.reference.load_torque)
        twist = self._inverse @ tick.measurement.wheel_speed
        seen = math.isfinite(twist[0] + twist[1] + twist[2])
        if late or self._count < TAPS or not seen:
            self._blind = self._window
        error = inputs.ravel() @ self._response - twist
        stands = self._standing_ticks >= self._still
        share = error / (self._standing if stands else self._driving)
        self._filtered = self._median.push(share if seen else np.zeros(3))
        self._judged = self._blind == 0
        if not self._judged:
            self._blind -= 1
            return np.nan, np.nan
        wider = self._strays[stands].factor if self._adapt else 1.0
        share, filtered = share / wider, self._filtered / wider
        size = np.abs(filtered)
        # An axis keeps telling while it tells nearly as much as any: its sign is that of the contact.
        if size[self._axis] < AXIS_HYSTERESIS * size.max():
            self._axis = int(np.argmax(size))
        return float(share[self._axis]), float(filtered[self._axis])

    def learn(self, untouched: bool, moving: bool) -> None:
        """Take in what the last tick was: whether nothing touched the robot, and whether joints of it were to move."""
        stands = self._standing_ticks >= self._still
        if not untouched:
            for strays in self._strays:
                strays.touched()
        elif self._judged:
            moved = self._everything & (moving or not stands)
            self._strays[stands].learn(self._filtered, self._everything, moved)

    def _remember(self, wheel_speed: FloatArray, load_torque: FloatArray) -> FloatArray:
        """Take in what was sent and what the legs bear; the inputs of the response, newest first."""
        if self._newest == 0:
            self._newest = ROWS - TAPS
            self._inputs[self._newest + 1 :] = self._inputs[: TAPS - 1]
        else:
            self._newest -= 1
        inputs = self._inputs[self._newest : self._newest + TAPS]
        now = inputs[0]
        now[:3] = self._inverse @ wheel_speed
        now[3:] = load_torque.take(self._legs)
        if not math.isfinite(now.sum()):
            now[:] = inputs[1]
        if self._count == 0:
            inputs[:, 3:] = now[3:]
        self._count += 1
        fastest = max(abs(sent) for sent in now[:3].tolist())
        self._standing_ticks = self._standing_ticks + 1 if fastest < STANDSTILL_SPEED else 0
        return inputs


def leg_indices(robot: RobotConfig) -> list[int]:
    """Return the places of the leg joints in the order of joints."""
    return [robot.joint_index(name) for name in robot.chains["legs"]]
