"""Momentum: of the whole robot about its centre of mass."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.lag import LagTask
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.tasks.task import TaskRows


@checked_arguments
class MomentumTask(LagTask):
    r"""The centroidal momentum h goes to a target as a first-order lag: A qdd + dA/dt qd = damping (target - h).

    Rows are linear [kg m/s], then angular [kg m2/s] momentum, in the world's axes. The use it is mostly put to is to
    let the arms and the torso balance each other's swing: ``task.dim_weight = (0, 0, 0, 1, 1, 1)``. All six rows at
    zero hold the centre of mass still as well. A large weight freezes the robot.

    Args:
        joints: What may move for it, by default all joints.
        base: True to let the base move for it too.
        stiffness: [1/s2]; the rate is the damping that follows from it.
        weight: In the cost, by default below that of a posture: momentum is then what other tasks leave free.
        name: For reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such joint.
    """

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
        """(6,) linear [kg m/s], then angular [kg m2/s] momentum, zero at first; setting it checks it.

        Raises:
            TargetError: Not six finite numbers; the old target stays.
        """
        return self.reference_velocity

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self.reference_velocity = finite_vector("a momentum (linear, angular)", value, self.rows)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """The rate is the momentum: it is linear in the velocities."""
        rows.jacobian[:], _, rows.bias[:] = model.centroidal_momentum()
