"""From the base's twist to wheel speeds and back."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray


def desaturated(wheel_speed: FloatArray, limit: float) -> FloatArray:
    """Wheel speeds (3,) within a limit [rad/s]: all slowed by one factor, so that the base keeps its direction."""
    fastest = float(np.abs(wheel_speed).max())
    if fastest <= limit:
        return wheel_speed
    slowed: FloatArray = np.clip(wheel_speed / fastest, -1.0, 1.0) * limit
    return slowed


class Odometry:
    """Where the base has rolled to, from its wheel speeds. Slip is not seen, nor is being pushed with wheels that slip.

    Args:
        robot: Its description.

    Attributes:
        pose: (3,) x [m], y [m], heading [rad] since the last reset; replaced, never changed in place.
        twist: (3,) vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._wheel_to_twist = robot.wheels.inverse
        self.reset()

    def reset(self) -> None:
        """The base is at the origin from now on."""
        self.pose: FloatArray = np.zeros(3)
        self.twist: FloatArray = np.zeros(3)

    def update(self, wheel_speed: FloatArray, dt: float) -> None:
        """Roll on for one cycle [s] at (3,) wheel speeds [rad/s], along an arc; stay if they are not finite."""
        twist = self._wheel_to_twist @ wheel_speed
        if not np.isfinite(twist).all():
            return
        self.twist = twist
        vx, vy, wz = self.twist.tolist()
        x, y, heading = self.pose.tolist()
        turn = wz * dt
        # The chord of the arc, exact for a constant twist: v dt turned by half the angle, shortened by sinc.
        middle = heading + turn / 2
        length = dt * (sin(turn / 2) / (turn / 2) if abs(turn) > 1e-6 else 1.0)
        c, s = cos(middle) * length, sin(middle) * length
        self.pose = np.array([x + c * vx - s * vy, y + s * vx + c * vy, heading + turn])
