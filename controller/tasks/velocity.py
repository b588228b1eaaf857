"""Tasks that approach a velocity with a first-order lag: of the base, and the momentum of the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.tasks.task import Task, TaskRows


class LagTask(Task):
    """Task of a rate: a* = damping (target - rate). Its target is the reference velocity of the task."""

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Set the error of the rows to zero: the feedback is that of the rate alone."""
        super().attach(model, rows)
        rows.error[:] = 0.0

    def _update_gains(self) -> None:
        super()._update_gains()
        self.gains = replace(self.gains, stiffness=0.0)

    @property
    def error(self) -> FloatArray:
        """(rows,) target minus rate in the last cycle; NaN before the first."""
        error: FloatArray = self.reference_velocity - self._rate
        return error

    @checked_arguments
    def reached(self, tolerance: ArrayLike) -> bool:
        """Return True if every row with weight is within a tolerance of its target.

        Args:
            tolerance: One number or (rows,), in the unit of the task.

        Raises:
            TargetError: Not a number above 0, or not as many.
        """
        near = np.abs(self.error) <= self._tolerance(tolerance)
        return bool(near[self._dim_weight > 0].all())


RELAXED_BASE_RATIO = 0.01
"""Factor on the weight of the base task while another task moves the base: it then equals that of the posture."""


@checked_arguments
class BaseVelocityTask(LagTask):
    """Twist of the base with a first-order lag: a* = damping (target - twist).

    The controller has its own. While a task in use moves the base, the weight of that own task is a hundredth, unless
    its target is a motion.

    Args:
        stiffness: [1/s2]; the rate is the damping that follows from it.
        weight: Weight in the cost.
        name: Name in reports.
    """

    needs_kinematics = False
    _relaxed = False

    def __init__(
        self, *, stiffness: float = 3.0, weight: float = 1e3, name: str = "base velocity"
    ) -> None:
        super().__init__(BASE, stiffness=stiffness, weight=weight, name=name)

    @property
    def target(self) -> FloatArray:
        """(3,) vx [m/s], vy [m/s], wz [rad/s] of base_link in its own axes; it is checked when it is set.

        Raises:
            TargetError: Not three finite numbers; the previous target stays.
        """
        return self.reference_velocity

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self.reference_velocity = finite_vector("a base twist (vx, vy, wz)", value, BASE)

    def relax(self, relaxed: bool) -> None:
        """Reduce the weight while other tasks move the base; the controller calls it when it allocates its tasks."""
        if relaxed is not self._relaxed:
            self._relaxed = relaxed
            self._update_gains()

    def _update_gains(self) -> None:
        super()._update_gains()
        if self._relaxed and self._reference_velocity is None:
            self.gains = replace(self.gains, weight=RELAXED_BASE_RATIO * self.gains.weight)

    def _update_has_reference(self) -> None:
        super()._update_has_reference()
        if self._relaxed:  # the target may be a motion now, or rest again
            self._update_gains()

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Write one row for each of vx, vy, wz."""
        super().attach(model, rows)
        rows.jacobian[:, :BASE] = np.eye(BASE)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Do nothing: the rate is the velocity of the model, by the constant rows."""


@checked_arguments
class MomentumTask(LagTask):
    r"""Centroidal momentum h with a first-order lag: A qdd + dA/dt qd = damping (target - h).

    Rows are linear [kg m/s], then angular [kg m2/s] momentum, in world axes. With
    ``task.dim_weight = (0, 0, 0, 1, 1, 1)`` arms and torso balance each other's swing. All six rows at zero keep the
    centre of mass at rest as well. A large weight stops all motion.

    Args:
        joints: Joints that may move for it, by default all.
        base: True to let the base move for it too.
        stiffness: [1/s2]; the rate is the damping that follows from it.
        weight: Weight in the cost, by default below that of a posture: other tasks then have precedence.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such joint.
    """

    needs_kinematics = False

    def __init__(
        self,
        *,
        joints: Sequence[str] | None = None,
        base: bool = False,
        stiffness: float = 5.0,
        weight: float = 1.0,
        name: str = "momentum",
        robot: RobotConfig | None = None,
    ) -> None:
        super().__init__(6, stiffness=stiffness, weight=weight, name=name)
        self.select(load_robot() if robot is None else robot, joints, base=base)

    @property
    def target(self) -> FloatArray:
        """(6,) linear [kg m/s], then angular [kg m2/s] momentum, zero at first; it is checked when it is set.

        Raises:
            TargetError: Not six finite numbers; the previous target stays.
        """
        return self.reference_velocity

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self.reference_velocity = finite_vector("a momentum (linear, angular)", value, self.rows)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the rows of the momentum, which is linear in the velocities."""
        rows.jacobian[:], _, rows.bias[:] = model.centroidal_momentum()
