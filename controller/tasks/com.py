"""Centre of mass of the whole robot, in the world or in base_link."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, UnknownNameError, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.task import Task, TaskRows
from pepper_driver.controller.trajectory import Trajectory, vector_trajectory

BASE_LINK = "base_link"


@checked_arguments
class ComTask(Task):
    """Position of the centre of mass.

    Args:
        root: ``base_link`` for a target in it; None for the world, which is the start of the base.
        joints: Joints that may move for it, by default all.
        base: True to let the base move for it too; without effect for a target in base_link.
        stiffness: [1/s2].
        weight: Weight in the cost. Use ``dim_weight`` (1, 1, 0) to leave the height free.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such joint; a root other than ``base_link``.
    """

    def __init__(
        self,
        *,
        root: str | None = None,
        joints: Sequence[str] | None = None,
        base: bool = False,
        stiffness: float = 10.0,
        weight: float = 1e4,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        if root not in (None, BASE_LINK):
            raise UnknownNameError("root of a centre of mass", str(root), [BASE_LINK])
        label = "centre of mass" if root is None else f"centre of mass from {root}"
        super().__init__(3, stiffness=stiffness, weight=weight, name=name or label)
        self._in_base = root is not None
        self._target: FloatArray | None = None
        self.select(load_robot() if robot is None else robot, joints, base=base)

    @property
    def target(self) -> FloatArray:
        """(3,) target [m], a copy; until it is set, the position at first use of the task (NaN before that).

        Raises:
            TargetError: Not three finite numbers; the previous target stays.
        """
        return np.full(3, np.nan) if self._target is None else self._target.copy()

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._set_target(self.checked(value))

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the error: target minus centre of mass [m]."""
        position, full, velocity, bias = model.com()
        if self._in_base:
            position, _, bias = _in_base_link(model, position, velocity, bias)
            # The base is a rigid body here: joints alone move the centre of mass in it.
            rows.jacobian[:, BASE:] = _rotation_world_to_base(model) @ full[:, BASE:]
        else:
            rows.jacobian[...] = full
        if self._target is None:
            self._target = position.copy()
        np.subtract(self._target, position, rows.error)
        rows.bias[...] = bias

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        position, _, velocity, bias = model.com()
        if self._in_base:
            position, velocity, _ = _in_base_link(model, position, velocity, bias)
        return vector_trajectory(np.array([position, *targets]), velocity.copy(), durations, dt)

    def _follow(self, target: FloatArray) -> None:
        self._target = target


def _rotation_world_to_base(model: RobotModel) -> FloatArray:
    cosine, sine = model.q[2], model.q[3]
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _in_base_link(
    model: RobotModel, position: FloatArray, velocity: FloatArray, bias: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity and bias of a point in base_link, which moves with the twist of the model."""
    rotation = _rotation_world_to_base(model)
    vx, vy, w = model.v[:BASE].tolist()
    # The base moves in the plane: its height is 0.
    origin = np.array([model.q[0], model.q[1], 0.0])
    x, y, z = (rotation @ (position - origin)).tolist()
    ux, uy, uz = (rotation @ velocity).tolist()
    ax, ay, az = (rotation @ bias).tolist()
    ux, uy = ux - vx + w * y, uy - vy - w * x
    # The origin's own bias is w x v; then the centripetal and the Coriolis part.
    ax, ay = ax + w * vy + w * w * x + 2 * w * uy, ay - w * vx + w * w * y - 2 * w * ux
    return np.array([x, y, z]), np.array([ux, uy, uz]), np.array([ax, ay, az])
