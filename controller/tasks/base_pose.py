"""Base pose: position and heading of the base on the floor."""

from __future__ import annotations

from math import atan2, pi

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.targets import Target, finite_vector
from pepper_driver.controller.tasks.task import Task, TaskRows
from pepper_driver.controller.trajectory import Trajectory, vector_trajectory


@checked_arguments
class BasePoseTask(Task):
    """Pose of the base in the plane by a critically damped PD law, with the shorter turn.

    Errors, reference velocities and accelerations are in world axes. While it is in use, the controller's own base
    velocity task has less weight.

    Args:
        stiffness: [1/s2].
        weight: Weight in the cost.
        name: Name in reports.
    """

    needs_kinematics = False

    def __init__(
        self, *, stiffness: float = 3.0, weight: float = 1e4, name: str = "base pose"
    ) -> None:
        super().__init__(BASE, stiffness=stiffness, weight=weight, name=name)
        self.moves_base = True
        self._target: FloatArray | None = None

    @property
    def target(self) -> FloatArray:
        """(3,) x [m], y [m], heading [rad] of base_link in the world; until it is set, the pose at first use.

        Raises:
            TargetError: Not three finite numbers; the previous target stays.
        """
        return np.full(BASE, np.nan) if self._target is None else self._target.copy()

    @target.setter
    def target(self, value: ArrayLike) -> None:
        target = self.checked(value)

        def change() -> None:
            self._target = target  # as given: only a trajectory's heading is wrapped
            self._stop_moving()

        self.change(change)

    def checked(self, target: Target) -> FloatArray:
        """Return the target; see :meth:`Task.checked`."""
        return finite_vector("a base pose (x, y, heading)", target, BASE)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the rows. The velocities are in the axes of the base, which turn: d/dt (R v) = R (dv/dt + w x v)."""
        if self._target is None:
            self._target = model.base_pose(model.q)
        x, y, cosine, sine = model.q[:4].tolist()
        vx, vy, wz = model.v[:BASE].tolist()
        goal_x, goal_y, heading = self._target.tolist()
        turn = _wrapped(heading - atan2(sine, cosine))
        rows.error[:] = goal_x - x, goal_y - y, turn
        rows.bias[:] = wz * (-sine * vx - cosine * vy), wz * (cosine * vx - sine * vy), 0.0
        jacobian = rows.jacobian
        jacobian[0, 0] = jacobian[1, 1] = cosine
        jacobian[0, 1], jacobian[1, 0] = -sine, sine
        jacobian[2, 2] = 1.0

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        points = [model.base_pose(model.q)]
        for target in targets:  # each by the shorter turn from the previous one
            point = target.copy()
            point[2] = points[-1][2] + _wrapped(target[2] - points[-1][2])
            points.append(point)
        cosine, sine = model.q[2], model.q[3]
        rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return vector_trajectory(np.array(points), rotation @ model.v[:BASE], durations, dt)

    def _follow(self, target: FloatArray) -> None:
        x, y, heading = target.tolist()
        self._target = np.array([x, y, _wrapped(heading)])


def _wrapped(angle: float) -> float:
    """Return ``angle`` in [-pi, pi)."""
    return float((angle + pi) % (2 * pi) - pi)
