"""The wheels: no faster and no more abrupt than the base may, and not at all while something is in its way."""

from __future__ import annotations

import logging
from math import isfinite

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig, SafetySettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import desaturated

logger = logging.getLogger("pepper_driver")

PRESSED = 0.5
"""Between 0, not pressed, and 1."""

ROUNDING = 1e-6
"""[rad/s] Wheels may be so much too fast: what the controller's solver rounds to."""


class BaseGuard:
    """Slows the wheels, and stops the base while a bumper is pressed, some time beyond, and over an open charging flap.

    Wheels too fast, or that change their speed too fast, are slowed by one factor: the base keeps its direction, or
    changes it the way it was to. A stop is at once.

    Args:
        robot: Its description.
        settings: Of the gate.

    Attributes:
        stopped: Why the base has to stand, for people; empty when it may roll.
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
        self._still = np.zeros(3)  # goes into many commands
        self._still.setflags(write=False)
        self.reset()

    def reset(self) -> None:
        """The base stands, and may roll."""
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

    def limit(self, wanted: FloatArray) -> FloatArray | None:
        """(3,) wheel speeds to send [rad/s]; ``wanted`` itself where it may be sent, None where it is not finite."""
        a, b, c = wanted.tolist()
        if not (isfinite(a) and isfinite(b) and isfinite(c)):
            return None
        if self.stopped:
            self.stop()
            return wanted if a == b == c == 0.0 else self._still
        if a == b == c == 0.0 and self._last is self._still:
            return wanted
        limit = self._speed_limit + ROUNDING
        speeds = wanted
        if not (-limit <= a <= limit and -limit <= b <= limit and -limit <= c <= limit):
            speeds = desaturated(wanted, self._speed_limit)
            a, b, c = speeds.tolist()
        share = 1.0
        for speed, last, most in zip(
            (a, b, c), self._last_speeds, self._largest_change, strict=True
        ):
            change = abs(speed - last)
            if change > most:
                share = min(share, most / change)
        if share < 1.0:
            speeds = self._last + share * (speeds - self._last)
            a, b, c = speeds.tolist()
        self._last, self._last_speeds = speeds, [a, b, c]
        return speeds

    def stop(self) -> FloatArray:
        """Stand at once; returns (3,) zeros [rad/s]."""
        self._last, self._last_speeds = self._still, [0.0, 0.0, 0.0]
        return self._still
