"""Position, velocity and acceleration limits of base and joints, merged into one box of accelerations.

The box holds lo <= hi by construction: each limit is an interval, and the box of what matters less is projected onto
the interval of what matters more. Position counts more than velocity, velocity more than acceleration.

Position limits are kept by braking distance: the velocity after this cycle, v+ = v + a dt, must still let the joint
stop before its limit with the deceleration b, where the position moves by (v + v+) dt / 2 in the cycle:
v+^2 / (2 b) <= d - (v + v+) dt / 2, with d the distance to the limit now, solved for v+. The velocity damper of older
controllers lets joints as fast as Pepper's run past their limits at 12 ms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller.model import BASE, RobotModel

FloatArray = NDArray[np.float64]

BRAKE_SHARE = 0.9
"""Of the acceleration limit: what the braking distance is reckoned with."""


class AccelerationBox:
    """Bounds on the 20 accelerations.

    A joint that starts beyond a limit is brought back at b dt / 2, a few hundredths of a radian a second.

    Args:
        robot: Position limits of joints, velocity and acceleration limits of the base.
        settings: Velocity and acceleration limits of joints, margin of position limits.
        model: For the order of the joints.
        dt: Cycle [s].

    Attributes:
        lower: (20,) of the last update [m/s2], [rad/s2].
        upper: (20,) likewise.
        joint_velocity_limit: (17,) in joint order [rad/s].
    """

    def __init__(
        self, robot: RobotConfig, settings: ControllerSettings, model: RobotModel, dt: float
    ) -> None:
        self._dt = dt
        self._columns = model.joint_columns
        base, names = robot.limits.base, robot.joint_names
        self.joint_velocity_limit = np.array([settings.velocity_limit[name] for name in names])
        acceleration = np.array([settings.acceleration_limit[name] for name in names])
        self._velocity = np.empty(model.nv)
        self._velocity[:BASE] = base.linear_velocity, base.linear_velocity, base.angular_velocity
        self._velocity[self._columns] = self.joint_velocity_limit
        self._acceleration = np.empty(model.nv)
        self._acceleration[:BASE] = (
            base.linear_acceleration,
            base.linear_acceleration,
            base.angular_acceleration,
        )
        self._acceleration[self._columns] = acceleration
        # A margin wider than the joint's range would leave no place to be.
        margin = np.minimum(settings.position_margin, (robot.upper - robot.lower) / 4)
        self._limits = np.stack([robot.upper - margin, -(robot.lower + margin)])
        self._brake = BRAKE_SHARE * acceleration
        self._brake_step = self._brake * dt
        self.lower = np.empty(model.nv)
        self.upper = np.empty(model.nv)

    def update(self, model: RobotModel) -> None:
        """Compute the box for the model's state."""
        dt, v = self._dt, model.v
        fastest = (self._velocity - v) / dt
        slowest = (-self._velocity - v) / dt
        np.clip(self._acceleration, slowest, fastest, out=self.upper)
        np.clip(-self._acceleration, slowest, fastest, out=self.lower)
        # Both limits at once, the lower one mirrored: rows upper, lower.
        q, qd = model.joint_position, model.joint_velocity
        position, velocity = np.stack([q, -q]), np.stack([qd, -qd])
        room = 8.0 * self._brake * (self._limits - position) - 4.0 * self._brake_step * velocity
        root = np.sqrt(np.maximum(self._brake_step**2 + room, 0.0))
        most = ((root - self._brake_step) / 2.0 - velocity) / dt
        columns, highest, lowest = self._columns, most[0], -most[1]
        self.upper[columns] = np.maximum(np.minimum(self.upper[columns], highest), lowest)
        self.lower[columns] = np.minimum(
            np.maximum(self.lower[columns], lowest), self.upper[columns]
        )
