"""Posture: all joints go to given angles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.task import Task, finite_vector

FloatArray = NDArray[np.float64]

TOLERANCE = 1e-6
"""[rad] A target may lie this far beyond a limit: what rounding does to a limit itself."""


class PostureTask(Task):
    """The joints as critically damped springs about a reference motion.

    qdd* = acceleration + damping (velocity - qd) + stiffness (target - q); at rest as a reference, the set-point law.

    Args:
        robot: Its description.
        stiffness: [1/s2]. At 0 the damping is 0 too: joints then keep their speed unless ``damping`` is set.
        weight: In the cost.
    """

    needs_kinematics = False

    def __init__(self, robot: RobotConfig, *, stiffness: float, weight: float) -> None:
        super().__init__(len(robot.joint_names), stiffness=stiffness, weight=weight)
        self._robot = robot
        self._target = (robot.lower + robot.upper) / 2
        self._velocity, self._acceleration = np.zeros(self.rows), np.zeros(self.rows)
        self._selection: FloatArray | None = None

    @property
    def target(self) -> FloatArray:
        """(17,) angles to go to [rad]; setting them checks them.

        Joints by name with their angles [rad] are taken too; the others keep theirs.

        Raises:
            TargetError: Not 17 finite numbers, or outside a joint's limits; the old target stays.
            UnknownNameError: No such joint; the old target stays.
        """
        return self._target.copy()

    @target.setter
    def target(self, value: ArrayLike | Mapping[str, float]) -> None:
        self._target = self.check_target(value)

    @property
    def velocity(self) -> FloatArray:
        """(17,) velocity of the reference motion [rad/s]; the target does not move by itself.

        Raises:
            TargetError: Not 17 finite numbers; the old one stays.
        """
        return self._velocity.copy()

    @velocity.setter
    def velocity(self, value: ArrayLike) -> None:
        self._velocity = finite_vector("a reference velocity", value, self.rows)

    @property
    def acceleration(self) -> FloatArray:
        """(17,) acceleration of the reference motion [rad/s2].

        Raises:
            TargetError: Not 17 finite numbers; the old one stays.
        """
        return self._acceleration.copy()

    @acceleration.setter
    def acceleration(self, value: ArrayLike) -> None:
        self._acceleration = finite_vector("a reference acceleration", value, self.rows)

    def check_target(self, value: ArrayLike | Mapping[str, float]) -> FloatArray:
        """(17,) the posture that ``value`` means [rad]; the task's target stays. Raises as :attr:`target` does."""
        robot = self._robot
        if isinstance(value, Mapping):
            angles = self._target.tolist()
            for name, angle in value.items():
                angles[robot.joint_index(name)] = angle
        else:
            angles = value
        posture = finite_vector("a posture", angles, self.rows, names=robot.joint_names)
        outside = (posture < robot.lower - TOLERANCE) | (posture > robot.upper + TOLERANCE)
        if outside.any():
            index = int(np.argmax(outside))
            joint, angle = robot.joints[index], float(posture[index])
            raise TargetError(
                f"{joint.name} cannot go to {angle:.4g} rad:"
                f" its limits are {joint.lower:.4g} to {joint.upper:.4g} rad",
                joint=joint.name,
                value=angle,
                lower=joint.lower,
                upper=joint.upper,
            )
        return np.clip(posture, robot.lower, robot.upper)

    def write(self, model: RobotModel, jacobian: FloatArray, acceleration: FloatArray) -> None:
        """One row a joint."""
        if self._selection is None:
            self._selection = np.zeros((self.rows, model.nv))
            self._selection[np.arange(self.rows), model.joint_columns] = 1.0
        jacobian[:] = self._selection
        np.subtract(self._target, model.joint_position, out=acceleration)
        acceleration *= self.stiffness
        acceleration += self.damping * (self._velocity - model.joint_velocity)
        acceleration += self._acceleration

    def error(self, model: RobotModel) -> FloatArray:
        """(17,) target minus position [rad]."""
        return self._target - model.joint_position
