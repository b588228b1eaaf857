"""The base moves no faster than its wheels can turn."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.controller.constraints.braking_limits import BrakingLimits
from pepper_driver.controller.constraints.constraint import Constraint, LinearInequality
from pepper_driver.controller.model import BASE, RobotModel


@checked_arguments
class WheelSpeedLimit(Constraint):
    """Wheel speeds after each cycle within the wheels' limit, so that none has to be slowed on its way out.

    Wheels that are too fast at the start slow down as fast as the base may brake without leaving its direction.

    Args:
        robot: Its wheels.
    """

    name = "wheel speed"
    priority = 2
    needs_kinematics = False

    def __init__(self, robot: RobotConfig) -> None:
        self._matrix, self._limit = robot.wheels.matrix, robot.wheels.speed_limit
        self._names = tuple(f"{self.name} {name}" for name in robot.wheels.names)
        self._fastest = tuple(np.abs(self._matrix).max(axis=0).tolist())
        self._for: BrakingLimits | None = None
        self._enough = 0.0

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Rows of the wheels that could become too fast in this cycle."""
        if braking_limits is not self._for:
            self._for = braking_limits
            step = braking_limits.acceleration[:BASE] * braking_limits.dt
            self._gained = np.abs(self._matrix) @ step
            self._enough = self._limit - float(self._gained.max())
        x, y, turn = self._fastest
        item = model.v.item
        if x * abs(item(0)) + y * abs(item(1)) + turn * abs(item(2)) <= self._enough:
            return None
        twist, dt = model.v[:BASE], braking_limits.dt
        speed = self._matrix @ twist
        size = np.abs(speed)
        (near,) = np.nonzero(size + self._gained > self._limit)
        if not len(near):
            return None
        # Of a twist that is too fast, the share that is left when it is braked for a cycle.
        left = 1.0 - float(
            np.min(braking_limits.brake[:BASE] * dt / np.maximum(np.abs(twist), 1e-9))
        )
        sign = np.where(speed[near] < 0, -1.0, 1.0)
        matrix = np.zeros((len(near), model.nv))
        matrix[:, :BASE] = sign[:, None] * self._matrix[near]
        allowed = np.maximum(self._limit, left * size[near])
        return LinearInequality(
            matrix, (allowed - size[near]) / dt, tuple(self._names[i] for i in near)
        )
