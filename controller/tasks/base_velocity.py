"""Base velocity: the base moves with a given twist."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.task import Task, finite_vector

FloatArray = NDArray[np.float64]


class BaseVelocityTask(Task):
    """The base reaches a twist as a first-order lag: a* = damping (target - twist).

    Args:
        stiffness: [1/s2]; the rate is the damping that follows from it.
        weight: In the cost.
    """

    needs_kinematics = False

    def __init__(self, *, stiffness: float, weight: float) -> None:
        super().__init__(BASE, stiffness=stiffness, weight=weight)
        self._target = np.zeros(BASE)

    @property
    def target(self) -> FloatArray:
        """(3,) vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes; setting it checks it.

        Raises:
            TargetError: Not three finite numbers; the old target stays.
        """
        return self._target.copy()

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = finite_vector("a base twist (vx, vy, wz)", value, BASE)

    def write(self, model: RobotModel, jacobian: FloatArray, acceleration: FloatArray) -> None:
        """One row for each of vx, vy, wz."""
        jacobian[:] = 0.0
        jacobian[0, 0] = jacobian[1, 1] = jacobian[2, 2] = 1.0
        np.subtract(self._target, model.v[:BASE], out=acceleration)
        acceleration *= self.damping

    def error(self, model: RobotModel) -> FloatArray:
        """(3,) target minus twist."""
        return self._target - model.v[:BASE]
