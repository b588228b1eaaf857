"""Base velocity: the base moves with a given twist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.lag import LagTask
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.tasks.task import TaskRows

RELAXED_BASE_RATIO = 0.01
"""Of the weight, for a base at rest that gives way to a task: then it weighs as much as the posture does."""


@checked_arguments
class BaseVelocityTask(LagTask):
    """The base reaches a twist as a first-order lag: a* = damping (target - twist).

    The controller has one of its own, which it relaxes while a task in use moves the base: then it has a hundredth of
    its weight, except while its target is a motion.

    Args:
        stiffness: [1/s2]; the rate is the damping that follows from it.
        weight: In the cost.
        name: For reports.
    """

    needs_kinematics = False
    _relaxed = False

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

    def relax(self, relaxed: bool) -> None:
        """Give way to tasks that move the base, or no longer; called by the controller when it lays out its tasks."""
        if relaxed is not self._relaxed:
            self._relaxed = relaxed
            self._update_gains()

    def _update_gains(self) -> None:
        super()._update_gains()
        if self._relaxed and self._reference_velocity is None:
            self.gains = replace(self.gains, weight=RELAXED_BASE_RATIO * self.gains.weight)

    def _update_driven(self) -> None:
        super()._update_driven()
        if self._relaxed:  # the target may have begun or ceased to be a motion
            self._update_gains()

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """One row for each of vx, vy, wz."""
        super().attach(model, rows)
        rows.jacobian[:, :BASE] = np.eye(BASE)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """What there is to know is the rate, and that is the model's velocity."""
