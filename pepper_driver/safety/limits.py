"""Limits that every command is kept within: of joints, and of the base and its wheels.

With s the step of a command from the one before it and A the largest change of that step (acceleration times cycle
squared), a joint that brakes takes the steps s - A, s - 2 A, ... to rest. Of the room D to its limit it needs

    T(s) = n s - A n (n - 1) / 2,   n = ceil(s / A),

so that the largest step it may take is, with n = ceil((sqrt(1 + 8 D / A) - 1) / 2),

    s(D) = D / n + A (n - 1) / 2.

After a step with T(s) <= D the next one can be s - A: T(s - A) = T(s) - s <= D - s. A command inside these limits
therefore always has a successor inside them, for any request.
"""

from __future__ import annotations

import logging
from math import isfinite

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.backends.readiness import PRESSED
from pepper_driver.config import RobotConfig, SafetySettings
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller import desaturate

ANGLE_ROUNDING = 1e-9
"""[rad] A reference may lie this far beyond a limit: what rounding does."""


class JointLimits:
    """Range of the next command of n joints, after their last command.

    Args:
        lower, upper: (n,) position limits [rad].
        speed: (n,) limits [rad/s].
        acceleration: (n,) limits [rad/s2].
        cycle: Time between two commands [s].

    Attributes:
        position: (n,) last command [rad]; replaced, never changed in place.
    """

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        speed: FloatArray,
        acceleration: FloatArray,
        cycle: float,
    ) -> None:
        n = len(lower)
        self._n = n
        self._lower, self._upper = lower, upper
        self._largest_step = speed * cycle
        self._largest_change = acceleration * cycle**2
        self._half_inverse = 0.5 / self._largest_change
        # Of the change of the step, then of the step: one comparison serves both.
        self._most = np.concatenate([self._largest_change, self._largest_step]) + ANGLE_ROUNDING
        self._sizes = np.zeros(2 * n)
        self._kept = np.zeros(2 * n, dtype=np.bool_)
        self._step, self._rest = np.zeros(n), np.zeros(n)
        self._change, self._size = self._sizes[:n], self._sizes[n:]
        self._low_kept, self._high_kept = self._kept[:n], self._kept[n:]
        self.start(np.zeros(n))

    def start(self, position: FloatArray) -> None:
        """Stand at (n,) positions [rad], or at the limits they are beyond."""
        self.position = np.clip(position, self._lower, self._upper)
        self._last_step = np.zeros(self._n)

    def keep(self, requested: FloatArray) -> bool:
        """Take (n,) positions [rad] as the last command and return true if they are surely within all limits.

        Near position limits some valid commands may count as outside; NaN never passes.
        """
        step, rest, every = self._step, self._rest, 2 * self._n
        np.subtract(requested, self.position, step)
        np.subtract(step, self._last_step, self._change)
        np.abs(self._change, self._change)
        np.abs(step, self._size)
        np.less_equal(self._sizes, self._most, self._kept)
        if np.count_nonzero(self._kept) != every:
            return False
        # Where braking ends, no less far out than in truth: s^2 / (2 A) >= T(s) - s.
        np.multiply(step, self._size, rest)
        rest *= self._half_inverse
        rest += requested
        np.less_equal(self._lower, rest, self._low_kept)
        np.less_equal(rest, self._upper, self._high_kept)
        if np.count_nonzero(self._kept) != every:
            return False
        self.position = requested.copy()  # a copy: callers may change theirs
        self._step, self._last_step = self._last_step, step
        return True

    def clamp(self, requested: FloatArray) -> BoolArray:
        """Move as near to (n,) finite positions [rad] as the limits allow; return (n,) True where limited."""
        before, last = self.position, self._last_step
        requested_step = requested - before
        change = self._largest_change
        low = np.maximum(last - change, -self._largest_step)
        high = np.minimum(last + change, self._largest_step)
        # Position counts most: it is the last to be asked.
        np.minimum(high, _reach(self._upper - before, change), out=high)
        np.maximum(low, -_reach(before - self._lower, change), out=low)
        changed: BoolArray = (requested_step > high + ANGLE_ROUNDING) | (
            requested_step < low - ANGLE_ROUNDING
        )
        sent = np.where(
            changed, before + np.minimum(np.maximum(requested_step, low), high), requested
        )
        self.position = np.clip(sent, self._lower, self._upper)
        self._last_step = self.position - before
        return changed


def _reach(room: FloatArray, change: FloatArray) -> FloatArray:
    """(n,) largest steps towards limits that are ``room`` away, from which joints can still stop: s(D)."""
    n = np.maximum(np.ceil((np.sqrt(1.0 + 8.0 * room / change) - 1.0) / 2.0), 1.0)
    reach: FloatArray = room / n + change * (n - 1.0) / 2.0
    return reach


logger = logging.getLogger("pepper_driver")

SPEED_ROUNDING = 1e-6
"""[rad/s] Wheels may be so much too fast: what the controller's solver rounds to."""


class BaseGuard:
    """Slows the wheels, and stops the base while a bumper is pressed, some time beyond, and over an open charging flap.

    Wheels too fast, or that change their speed too fast, are slowed by one factor: the base keeps its direction, or
    changes it in the requested direction. A stop is immediate.

    Args:
        robot: Its description.
        settings: Of the gate.

    Attributes:
        stopped: Human-readable reason why the base must stand; empty when it may roll.
    """

    def __init__(self, robot: RobotConfig, settings: SafetySettings) -> None:
        self._names = tuple(robot.sensors.bumpers)
        self._release_ticks = round(settings.bumper_release / robot.cycle)
        self._speed_limit = robot.wheels.speed_limit
        base = robot.limits.base
        linear, angular = base.linear_acceleration, base.angular_acceleration
        # The largest that the base's own limits ask of each wheel.
        acceleration = np.abs(robot.wheels.matrix) @ np.array([linear, linear, angular])
        largest_change = settings.acceleration_margin * acceleration * robot.cycle
        self._largest_change: list[float] = largest_change.tolist()
        self._still = np.zeros(3)  # shared by many commands
        self._still.setflags(write=False)
        self.reset()

    def reset(self) -> None:
        """Start with a base that stands, and may roll."""
        self.stopped = ""
        self._wait = 0
        self._last, self._last_speeds = self._still, [0.0, 0.0, 0.0]

    def see(self, measurement: Measurement) -> None:
        """Take in bumpers and charging flap; a bumper that is not a number counts as pressed."""
        bumpers = measurement.bumpers
        if bumpers.dot(bumpers) != 0.0 or measurement.charging_flap > 0.5:
            blocked = self._blocked(measurement)
            if blocked:
                if not self.stopped:
                    logger.warning("the base stands still: %s", blocked)
                self.stopped, self._wait = blocked, self._release_ticks
                return
        if self.stopped:
            self._wait -= 1
            if self._wait < 0:
                self.stopped = ""

    def _blocked(self, measurement: Measurement) -> str:
        reasons = [
            f"bumper {name} is pressed"
            for name, value in zip(self._names, measurement.bumpers.tolist(), strict=True)
            if not value <= PRESSED
        ]
        if measurement.charging_flap > PRESSED:
            reasons.append("the charging flap is open")
        return " and ".join(reasons)

    def limit(self, requested: FloatArray) -> FloatArray | None:
        """(3,) wheel speeds to send [rad/s]; ``requested`` itself where it may be sent, None where it is not finite."""
        a, b, c = requested.tolist()
        if not (isfinite(a) and isfinite(b) and isfinite(c)):
            return None
        if self.stopped:
            self.stop()
            return requested if a == b == c == 0.0 else self._still
        if a == b == c == 0.0 and self._last is self._still:
            return requested
        limit = self._speed_limit + SPEED_ROUNDING
        speeds = requested
        if not (-limit <= a <= limit and -limit <= b <= limit and -limit <= c <= limit):
            speeds = desaturate(requested, self._speed_limit)
            a, b, c = speeds.tolist()
        fraction = 1.0
        for speed, last, most in zip(
            (a, b, c), self._last_speeds, self._largest_change, strict=True
        ):
            change = abs(speed - last)
            if change > most:
                fraction = min(fraction, most / change)
        if fraction < 1.0:
            speeds = self._last + fraction * (speeds - self._last)
            a, b, c = speeds.tolist()
        self._last, self._last_speeds = speeds, [a, b, c]
        return speeds

    def stop(self) -> FloatArray:
        """Stand at once; returns (3,) zeros [rad/s]."""
        self._last, self._last_speeds = self._still, [0.0, 0.0, 0.0]
        return self._still
