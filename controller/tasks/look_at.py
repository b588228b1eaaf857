"""Look-at: an axis of a link points at a place in the world or on the robot."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.model import BodyFrame, RobotModel
from pepper_driver.controller.tasks.frame import OWN_AXES, cross
from pepper_driver.controller.tasks.targets import Target, check_link, finite_vector
from pepper_driver.controller.tasks.task import Task, TaskRows
from pepper_driver.controller.trajectory import Trajectory, vector_trajectory

MIN_GAZE_DISTANCE = 0.05
"""[m] A target nearer to the eye than this has no direction to speak of: the line of sight stops turning."""

DEFAULT_GAZE_DISTANCE = 1.0
"""[m] How far ahead a link looks that was given nothing to look at."""


TINY = 1e-12
"""Sine of an angle that no float tells from 0."""


@checked_arguments
class LookAtTask(Task):
    """An axis of a link, the line of sight, points at a target.

    Two rows: the turn of the link relative to the way to the target, about two axes of the link across the line of
    sight; the turn about the line itself stays free. The error is the rotation vector that brings the line onto the
    target [rad]. Being opposite to the target is no special case: the line then starts to turn about one of the axes.
    While the target is nearer than 5 cm to the eye, the line of sight holds still and the error is 0.

    Args:
        link: Which looks.
        axis: (3,) of the link that points at the target.
        eye: (3,) point of the link where the line of sight starts [m], by default the link's origin.
        target_link: Link of the robot that the target belongs to: look at your own hand; None for the world, which is
            where the base started.
        joints: What may move for it, by default all joints; ``("HeadYaw", "HeadPitch")`` for the head alone, which
            answers what the other joints do by its spring: a little late while they speed up or slow down.
        base: True to let the base move for it too.
        stiffness: [1/s2].
        weight: In the cost.
        name: For reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such link or joint.
        TargetError: The axis or eye is none; the target would be on the link that looks.
    """

    def __init__(
        self,
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
        robot: RobotConfig | None = None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        check_link(robot, link)
        if target_link is not None:
            check_link(robot, target_link)
        if target_link == link:
            raise TargetError(f"{link} cannot look at a point of its own")
        label = f"look-at {link}" + (f" at {target_link}" if target_link is not None else "")
        super().__init__(2, stiffness=stiffness, weight=weight, name=name or label)
        line = finite_vector(f"the axis of {self.name}", axis, 3)
        if np.linalg.norm(line) < 1e-6:
            raise TargetError(f"the axis of {self.name} has no direction: {line.tolist()}")
        self._axes = _axes_about(line)
        self._lines = np.eye(2, 6, 3)  # from the eye's velocity and angular velocity to the rows
        self._link, self._target_link = link, target_link
        self._eye = None if eye is None else finite_vector(f"the eye of {self.name}", eye, 3)
        self._target = None if target_link is None else np.zeros(3)
        self._target_motion: tuple[FloatArray, FloatArray] | None = None
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
        self._set_target(self.checked(value))

    def checked(self, target: Target) -> FloatArray:
        """Return the target; see :meth:`Task.checked`."""
        return finite_vector(f"the target of {self.name}", target, 3)

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Look the frames up."""
        super().attach(model, rows)
        self._frame = model.body_frame(self._link, self._eye, self._axes.T)
        self._seen: BodyFrame | None = None
        self._seen_point: FloatArray | None = None

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Turn of the link minus turn of the way to the target, w - s with s = d x d' / d^2 and d that way.

        All in the axes of the eye, the third of which is the line of sight. They turn with w, so that the rows y are
        differentiated as d/dt (w - s) = dw/dt - ds/dt + w x s, each derivative seen from the world. To that comes
        (w - s)_3 e_3 x y: the law holds in axes that do not turn about the line of sight, or else a turn about it,
        which is free, would bend the way of the error.
        """
        frame = self._frame
        eye = model.pose(frame)
        rotation = eye.rotation
        place = self._target
        if place is None:
            place = self._target = eye.translation + DEFAULT_GAZE_DISTANCE * rotation[:, 2]
        of_frame = (model.pin, model.data, frame.joint, frame.placement, OWN_AXES)
        jacobian = pin.getFrameJacobian(*of_frame)
        bias = pin.getFrameClassicalAcceleration(*of_frame).vector
        vx, vy, vz, wx, wy, wz = jacobian.dot(model.v).tolist()
        # What moves the target: its link, and a motion by the user.
        link, motion = self._target_link, self._target_motion
        other, velocity, acceleration = None, None, None
        if link is not None:
            seen = self._frame_of_target(model, link)
            at = model.pose(seen)
            place = at.translation
            full = model.jacobian(seen)
            other = rotation.T.dot(full[:3])
            velocity, acceleration = other.dot(model.v), model.bias(seen)[:3].dot(rotation)
            if motion is not None:
                motion = _carried(motion, at.rotation, full[3:].dot(model.v))
        if motion is not None:
            motion = motion[0].dot(rotation), motion[1].dot(rotation)
            velocity = motion[0] if velocity is None else velocity + motion[0]
            acceleration = motion[1] if acceleration is None else acceleration + motion[1]
        x, y, z = (place - eye.translation).dot(rotation).tolist()
        square = x * x + y * y + z * z
        if square < MIN_GAZE_DISTANCE**2:
            rows.error[:] = 0.0
            rows.jacobian[:], rows.bias[:] = jacobian[3:5], bias[3:5]
            if motion is not None:
                self._reference_velocity = None
            return
        if velocity is not None:
            tx, ty, tz = velocity.tolist()
            vx, vy, vz = vx - tx, vy - ty, vz - tz
        # From here on v is that of the eye relative to the target, -d'.
        sx, sy = (z * vy - y * vz) / square, (x * vz - z * vx) / square
        sz = (y * vx - x * vy) / square
        approach = -2.0 * (x * vx + y * vy + z * vz) / square
        lines = self._lines
        lines[0, 1], lines[0, 2] = -z / square, y / square
        lines[1, 0], lines[1, 2] = z / square, -x / square
        lines.dot(jacobian, rows.jacobian)
        twist, first, second = wz - sz, wx - sx, wy - sy
        rows.bias[:] = (
            wy * sz - wz * sy + approach * sx - twist * second,
            wz * sx - wx * sz + approach * sy + twist * first,
        )
        rows.bias += lines.dot(bias)
        if other is not None:
            rows.jacobian -= lines[:, :3].dot(other)
        if acceleration is not None:
            rows.bias -= lines[:, :3].dot(acceleration)
        if motion is not None:
            self._reference_velocity = lines[:, :3].dot(motion[0])
        rows.error[:] = _turn_left(x, y, z)

    def _frame_of_target(self, model: RobotModel, link: str) -> BodyFrame:
        """Return the frame at the target; found again only when the target was set."""
        if self._seen is None or self._seen_point is not self._target:
            self._seen, self._seen_point = model.body_frame(link, self._target), self._target
        return self._seen

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        """Return the way starts on the line of sight as far away as the first target, and moves with it."""
        pose, twist = model.pose(self._frame), model.velocity(self._frame)
        place, velocity = pose.translation, twist[:3]
        back, origin, origin_twist = np.eye(3), np.zeros(3), np.zeros(6)
        if self._target_link is not None:
            frame = model.body_frame(self._target_link)
            at, origin_twist = model.pose(frame), model.velocity(frame)
            back, origin = at.rotation.T, at.translation
        distance = float(np.linalg.norm(back.T @ targets[0] + origin - place))
        ahead = max(distance, 2 * MIN_GAZE_DISTANCE) * pose.rotation[:, 2]
        way = place + ahead - origin
        speed = velocity + cross(twist[3:], ahead) - origin_twist[:3] - cross(origin_twist[3:], way)
        return vector_trajectory(np.array([back @ way, *targets]), back @ speed, durations, dt)

    def _follow(self, target: FloatArray) -> None:
        self._target = target

    def _refer_to(self, velocity: FloatArray | None, acceleration: FloatArray | None) -> None:
        """Add nothing: the target's own motion is part of the rows, by :meth:`compute`."""
        if velocity is None or acceleration is None:
            self._target_motion = None
        else:
            self._target_motion = velocity, acceleration
        self._reference_velocity = self._reference_acceleration = None


def _turn_left(x: float, y: float, z: float) -> tuple[float, float]:
    """First two numbers of the rotation vector from the third axis to (x, y, z) [rad]; its third number is 0."""
    sine = hypot(x, y)
    angle = atan2(sine, z)
    if sine <= TINY * abs(z):  # along the axis, or opposite: then any axis across will do
        return (0.0, 0.0) if z > 0 else (angle, 0.0)
    return -y / sine * angle, x / sine * angle


def _carried(
    motion: tuple[FloatArray, FloatArray], rotation: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Velocity and acceleration, in the world's axes, that a motion within a turning link adds to the link's."""
    velocity = rotation.dot(motion[0])
    return velocity, rotation.dot(motion[1]) + 2.0 * cross(w, velocity)


def _axes_about(axis: FloatArray) -> FloatArray:
    """(3, 3) right-handed unit axes as rows, the last of them along ``axis``."""
    last = axis / np.linalg.norm(axis)
    first = np.cross(np.eye(3)[np.argmin(np.abs(last))], last)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(last, first), last])
