"""A task of your own: the hands keep a distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.controller import RobotModel, TargetError, Task, TaskRows

HANDS = ("l_gripper", "r_gripper")
NEAREST = 0.05  # [m] below that the line between the hands has no direction to speak of


class HandsApart(Task):
    """The distance of the two hands [m]: one row.

    Args:
        distance: To be kept [m].
        joints: What may move for it, by default both arms.
        stiffness: [1/s2].
        weight: In the cost; the posture's is 1 to 10.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        TargetError: No distance above 5 cm.
        UnknownNameError: No such joint.
    """

    def __init__(
        self,
        distance: float,
        *,
        joints: Sequence[str] | None = None,
        stiffness: float = 20.0,
        weight: float = 1e4,
        robot: RobotConfig | None = None,
    ) -> None:
        super().__init__(1, stiffness=stiffness, weight=weight, name="hands apart")
        robot = robot or load_robot()
        arms = (*robot.chains["left_arm"], *robot.chains["right_arm"])
        self.select(robot, arms if joints is None else joints, base=False)
        self._distance = _checked(distance)

    @property
    def distance(self) -> float:
        """To be kept [m]; may be set from any thread, between two ticks."""
        return self._distance

    @distance.setter
    def distance(self, value: float) -> None:
        distance = _checked(value)

        def change() -> None:
            self._distance, self.up_to_date = distance, False

        self.change(change)

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Look the frames up, once for a model."""
        super().attach(model, rows)
        self._left, self._right = (model.body_frame(link) for link in HANDS)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """With n from the right hand to the left, at distance d: d' = n (v_l - v_r), d'' = n (a_l - a_r) + |w|^2 / d.

        w is the part of the relative velocity across n.
        """
        left, right = self._left, self._right
        way = model.pose(left).translation - model.pose(right).translation
        distance = max(float(np.linalg.norm(way)), NEAREST)
        n = way / distance
        jacobian = (model.jacobian(left) - model.jacobian(right))[:3]
        velocity = jacobian @ model.v
        across = velocity - n * (n @ velocity)
        bias = n @ (model.bias(left) - model.bias(right))[:3] + across @ across / distance
        rows.error = np.array([self._distance - distance])
        rows.jacobian = (n @ jacobian)[None, :]
        rows.bias = np.array([bias])


def _checked(value: float) -> float:
    if not (isinstance(value, int | float) and NEAREST < value < 2.0):
        raise TargetError(f"the hands can be {NEAREST:g} to 2 m apart, got {value!r}")
    return float(value)
