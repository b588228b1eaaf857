"""Wheels: speeds within their limit, odometry of the base, and feedback of the measured configuration."""

from __future__ import annotations

from math import cos, isfinite, sin

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel
from pepper_driver.controller.model import RobotModel


class Feedback:
    """Configuration of the controller minus the tracking error of the robot, with the base pose of the odometry.

    Each measurement is compared with the command that it answers, so the transport between them causes no error. The
    error is smoothed: the effects of acceleration and lag would otherwise reduce the damping of the motion. At rest the
    result is the measured configuration.

    Args:
        model: Of the controller.
        odometry: Of the controller.
        fraction: Of a new error that is taken over in each cycle: cycle over smoothing time, 1 at most.
    """

    def __init__(self, model: RobotModel, odometry: Odometry, fraction: float) -> None:
        self._model, self._odometry, self._fraction = model, odometry, fraction
        self.reset()

    def reset(self) -> None:
        """Forget the measurements."""
        self._error: FloatArray = np.zeros(len(self._model.joint_columns))

    def configuration(
        self, q: FloatArray, measurement: Measurement, answered: FloatArray | None
    ) -> FloatArray:
        """Return the configuration for tasks in place of the controller's ``q``.

        Args:
            q: Configuration of the controller.
            measurement: The newest measurement.
            answered: (17,) positions of the command that it answers [rad]; by default those of ``q``.
        """
        model = self._model
        position = model.joints_of_configuration(q)
        error = (position if answered is None else answered) - measurement.position
        if np.isfinite(error).all():  # else the safety gate stops the robot
            self._error = self._error + self._fraction * (error - self._error)
        shifted = model.with_joint_position(q, position - self._error)
        return model.with_base_pose(shifted, self._odometry.pose)


def desaturate(wheel_speed: FloatArray, limit: float) -> FloatArray:
    """Scale wheel speeds (3,) to a limit [rad/s], all by one factor, so that the base keeps its direction."""
    fastest = float(np.abs(wheel_speed).max())
    if fastest <= limit:
        return wheel_speed
    slowed: FloatArray = np.clip(wheel_speed / fastest, -1.0, 1.0) * limit
    return slowed


class Odometry:
    """Pose of the base from its wheel speeds. Slip of the wheels is not measured.

    Args:
        robot: Its description.

    Attributes:
        pose: (3,) x [m], y [m], heading [rad] since the last reset; replaced, never changed in place.
        twist: (3,) vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._wheel_to_twist = np.ascontiguousarray(robot.wheels.inverse)
        self._drive = _drive.load()
        self.reset()

    def reset(self) -> None:
        """Put the base at the origin."""
        self.pose: FloatArray = np.zeros(3)
        self.twist: FloatArray = np.zeros(3)

    def update(self, wheel_speed: FloatArray, dt: float) -> None:
        """Move by one cycle [s] at (3,) wheel speeds [rad/s], along an arc; stay if they are not finite."""
        speed = np.ascontiguousarray(wheel_speed, dtype=np.float64)
        twist, pose = np.empty(3), np.empty(3)
        if self._drive(self._wheel_to_twist, speed, dt, self.pose, twist, pose):
            self.twist, self.pose = twist, pose


@kernel
def _drive(
    wheel_to_twist: Matrix[FloatArray],
    wheel_speed: FloatArray,
    dt: float,
    before: FloatArray,
    twist: Out[FloatArray],
    pose: Out[FloatArray],
) -> bool:
    """Write the twist of the base and its pose after a cycle; return False where the twist is not finite."""
    for i in range(3):
        twist[i] = 0.0
        for wheel in range(3):
            twist[i] += wheel_to_twist[i, wheel] * wheel_speed[wheel]
    if not (isfinite(twist[0]) and isfinite(twist[1]) and isfinite(twist[2])):
        return False
    vx, vy, wz = twist[0], twist[1], twist[2]
    turn = wz * dt
    # Chord of the arc, exact for a constant twist: v dt turned by half the angle, shortened by sinc.
    middle = before[2] + turn / 2
    length = dt * (sin(turn / 2) / (turn / 2) if abs(turn) > 1e-6 else 1.0)
    c, s = cos(middle) * length, sin(middle) * length
    pose[0] = before[0] + c * vx - s * vy
    pose[1] = before[1] + s * vx + c * vy
    pose[2] = before[2] + turn
    return True
