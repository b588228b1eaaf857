"""Base velocity: the base moves with a given twist."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.lag import LagTask
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.tasks.task import TaskRows

FloatArray = NDArray[np.float64]


class BaseVelocityTask(LagTask):
    """The base reaches a twist as a first-order lag: a* = damping (target - twist).

    Args:
        stiffness: [1/s2]; the rate is the damping that follows from it.
        weight: In the cost.
        name: For reports.
    """

    needs_kinematics = False

    def __init__(
        self, *, stiffness: float = 3.0, weight: float = 1e3, name: str = "base velocity"
    ) -> None:
        super().__init__(BASE, stiffness=stiffness, weight=weight, name=name)

    @property
    def target(self) -> FloatArray:
        """(3,) vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes; setting it checks it.

        Raises:
            TargetError: Not three finite numbers; the old target stays.
        """
        return self.reference_velocity

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self.reference_velocity = finite_vector("a base twist (vx, vy, wz)", value, BASE)

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """One row for each of vx, vy, wz."""
        super().attach(model, rows)
        self._jacobian[:, :BASE] = np.eye(BASE)

    def measure(self, model: RobotModel) -> None:
        """What there is to know is the rate, and that is the model's velocity."""
