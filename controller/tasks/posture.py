"""Posture: all joints go to given angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.task import Task

FloatArray = NDArray[np.float64]

TOLERANCE = 1e-6
"""[rad] A target may lie this far beyond a limit: what rounding does to a limit itself."""


class PostureTask(Task):
    """The joints as critically damped springs: qdd* = stiffness (target - q) - damping qd.

    Args:
        robot: Its description.
        stiffness: [1/s2].
        weight: In the cost.
    """

    needs_kinematics = False

    def __init__(self, robot: RobotConfig, *, stiffness: float, weight: float) -> None:
        super().__init__(len(robot.joint_names), stiffness=stiffness, weight=weight)
        self._robot = robot
        self._target = (robot.lower + robot.upper) / 2
        self._selection: FloatArray | None = None

    @property
    def target(self) -> FloatArray:
        """(17,) angles to go to [rad]; setting them checks them.

        Raises:
            TargetError: Not 17 finite numbers, or outside a joint's limits; the old target stays.
        """
        return self._target.copy()

    @target.setter
    def target(self, value: FloatArray) -> None:
        self.check_target(value)
        self._target = np.clip(value, self._robot.lower, self._robot.upper)

    def check_target(self, value: FloatArray) -> None:
        """Raise a TargetError unless ``value`` is a posture the robot can take."""
        robot = self._robot
        if np.shape(value) != (self.rows,):
            raise TargetError(f"a posture takes {self.rows} angles, got shape {np.shape(value)}")
        inside = (value >= robot.lower - TOLERANCE) & (value <= robot.upper + TOLERANCE)
        if inside.all():  # a NaN is never inside
            return
        joint = robot.joints[int(np.argmin(inside))]
        angle = value[int(np.argmin(inside))]
        raise TargetError(
            f"{joint.name} cannot go to {angle:.4g} rad: its limits are {joint.lower:.4g} to {joint.upper:.4g} rad"
        )

    def write(self, model: RobotModel, jacobian: FloatArray, acceleration: FloatArray) -> None:
        """One row a joint."""
        if self._selection is None:
            self._selection = np.zeros((self.rows, model.nv))
            self._selection[np.arange(self.rows), model.joint_columns] = 1.0
        jacobian[:] = self._selection
        np.subtract(self._target, model.joint_position, out=acceleration)
        acceleration *= self.stiffness
        acceleration -= self.damping * model.joint_velocity

    def error(self, model: RobotModel) -> FloatArray:
        """(17,) target minus position [rad]."""
        return self._target - model.joint_position
