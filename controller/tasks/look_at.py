"""Look-at: an axis of a link points at a place in the world or on the robot."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.task import Task, TaskRows, finite_vector
from pepper_driver.controller.trajectory import Trajectory, vector_trajectory

FloatArray = NDArray[np.float64]

NEAREST = 0.05
"""[m] A target nearer to the eye than this has no direction to speak of: the line of sight stops turning."""

AHEAD = 1.0
"""[m] How far ahead a link looks that was given nothing to look at."""


class LookAtTask(Task):
    """An axis of a link, the line of sight, points at a target.

    Two rows: the turn of the link relative to the way to the target, about two axes of the link across the line of
    sight; the turn about the line itself stays free. The error is the rotation vector that brings the line onto the
    target [rad]. Being opposite to the target is no special case: the line then starts to turn about one of the axes.
    While the target is nearer than 5 cm to the eye, the line of sight holds still and the error is 0.

    Args:
        robot: Its description.
        link: Which looks.
        axis: (3,) of the link that points at the target.
        eye: (3,) point of the link where the line of sight starts [m], by default the link's origin.
        target_link: Link of the robot that the target belongs to: look at your own hand; None for the world, which is
            where the base started.
        joints: What may move for it, by default all joints; ``("HeadYaw", "HeadPitch")`` for the head alone.
        base: Whether the base may move for it too.
        stiffness: [1/s2].
        weight: In the cost.
        name: For reports.

    Raises:
        UnknownNameError: No such link or joint.
        TargetError: The axis or eye is none; the target would be on the link that looks.
    """

    def __init__(
        self,
        robot: RobotConfig,
        link: str = "Head",
        *,
        axis: ArrayLike = (1.0, 0.0, 0.0),
        eye: ArrayLike | None = None,
        target_link: str | None = None,
        joints: Sequence[str] | None = None,
        base: bool = False,
        stiffness: float = 10.0,
        weight: float = 1e3,
        name: str | None = None,
    ) -> None:
        for given in (link, target_link):
            if given is not None and given not in robot.links:
                raise UnknownNameError("link", given, robot.links)
        if target_link == link:
            raise TargetError(f"{link} cannot look at a point of its own")
        label = f"look-at {link}" + (f" at {target_link}" if target_link is not None else "")
        super().__init__(2, stiffness=stiffness, weight=weight, name=name or label)
        self._axis = finite_vector(f"the axis of {self.name}", axis, 3)
        length = float(np.linalg.norm(self._axis))
        if length < 1e-6:
            raise TargetError(f"the axis of {self.name} has no direction: {self._axis.tolist()}")
        self._axis /= length
        self._across = _across(self._axis)
        self._link, self._target_link = link, target_link
        self._eye = None if eye is None else finite_vector(f"the eye of {self.name}", eye, 3)
        self._target = None if target_link is None else np.zeros(3)
        self._target_velocity: FloatArray | None = None
        self._target_acceleration: FloatArray | None = None
        self.select(robot, joints, base=base)

    @property
    def target(self) -> FloatArray:
        """(3,) where to look [m], a copy: in the world, or a point of the target's link, by default its origin.

        In the world it is, until it is set, 1 m ahead of the eye where the task was first used (NaN before that).

        Raises:
            TargetError: Not three finite numbers; the old target stays.
        """
        return np.full(3, np.nan) if self._target is None else self._target.copy()

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._target = self.checked(value)
        self._stop_moving()

    def checked(self, target: Target) -> FloatArray:
        """The target; see :meth:`Task.checked`."""
        return finite_vector(f"the target of {self.name}", target, 3)

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Look the frames up."""
        super().attach(model, rows)
        self._frame = model.body_frame(self._link, self._eye)
        self._other = None if self._target_link is None else model.body_frame(self._target_link)

    def measure(self, model: RobotModel) -> None:
        """Turn of the link minus turn of the way to the target, d x d' / d^2 with d that way.

        In the link's axes, which turn with the link's w: d/dt R'(w - s) = R' (dw/dt - ds/dt + w x s).
        """
        pose = model.pose(self._frame)
"""
TODO
"""
