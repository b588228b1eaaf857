"""Look-at: an axis of a link points at a point in the world or on the robot."""

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
"""[m] The direction to a nearer target is undefined within rounding: the line of sight stops turning."""

DEFAULT_GAZE_DISTANCE = 1.0
"""[m] Distance of the default target, ahead of the link."""

MIN_SINE = 1e-12
"""Sine of an angle that is 0 within rounding."""


@checked_arguments
class LookAtTask(Task):
    """Line of sight: an axis of a link points at a target.

    It has two rows: the turn of the link relative to the line to the target, about two axes of the link that are normal
    to the line of sight. The turn about the line itself is free. The error is the rotation vector that moves the line
    onto the target [rad]. If the target is opposite, the line starts to turn about one of the axes. While the target is
    nearer than 5 cm to the eye, the line of sight stops and the error is 0.

    Args:
        link: Link with the line of sight.
        axis: (3,) axis of the link that points at the target.
        eye: (3,) point of the link where the line of sight starts [m], by default the origin of the link.
        target_link: Link of the robot that the target belongs to, for example a hand; None for the world, which is the
            start of the base.
        joints: Joints that may move for it, by default all; ``("HeadYaw", "HeadPitch")`` for the head alone. Its PD law
            then follows the other joints, with a small delay while they accelerate.
        base: True to let the base move for it too.
        stiffness: [1/s2].
        weight: Weight in the cost.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such link or joint.
        TargetError: Invalid axis or eye; a target on the link itself.
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
        self._lines = np.eye(2, 6, 3)  # from velocity and angular velocity of the eye to the rows
        self._link, self._target_link = link, target_link
        self._eye = None if eye is None else finite_vector(f"the eye of {self.name}", eye, 3)
        self._target = None if target_link is None else np.zeros(3)
        self._target_motion: tuple[FloatArray, FloatArray] | None = None
        self.select(robot, joints, base=base)

    @property
    def target(self) -> FloatArray:
        """(3,) target [m], a copy: in the world, or a point of the target's link, by default its origin.

        In the world it is, until it is set, 1 m ahead of the eye at first use of the task (NaN before that).

        Raises:
            TargetError: Not three finite numbers; the previous target stays.
        """
        return np.full(3, np.nan) if self._target is None else self._target.copy()

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._set_target(self.checked(value))

    def checked(self, target: Target) -> FloatArray:
        """Return the target; see :meth:`Task.checked`."""
        return finite_vector(f"the target of {self.name}", target, 3)

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Find the frames in the model."""
        super().attach(model, rows)
        self._frame = model.body_frame(self._link, self._eye, self._axes.T)
        self._target_frame: BodyFrame | None = None
        self._target_frame_point: FloatArray | None = None

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the turn of the link minus that of the line to the target, w - s with s = d x d' / d^2 on d.

        All in the axes of the eye, the third of which is the line of sight. They turn with w, so the rows y are
        differentiated as d/dt (w - s) = dw/dt - ds/dt + w x s, with derivatives in the world. A further term is
        (w - s)_3 e_3 x y: the law holds in axes that do not turn about the line of sight. Otherwise a turn about it,
        which is free, would bend the path of the error.
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
        # The target moves with its link, and by a motion of the task.
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
        # From here on v is the velocity of the eye relative to the target, -d'.
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
        """Return the frame at the target; it is computed again only after the target was set."""
        if self._target_frame is None or self._target_frame_point is not self._target:
            self._target_frame, self._target_frame_point = (
                model.body_frame(link, self._target),
                self._target,
            )
        return self._target_frame

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        """Return a path that starts on the line of sight, at the distance of the first target, and moves with it."""
        pose, twist = model.pose(self._frame), model.velocity(self._frame)
        place, velocity = pose.translation, twist[:3]
        back, origin, origin_twist = np.eye(3), np.zeros(3), np.zeros(6)
        if self._target_link is not None:
            frame = model.body_frame(self._target_link)
            at, origin_twist = model.pose(frame), model.velocity(frame)
            back, origin = at.rotation.T, at.translation
        distance = float(np.linalg.norm(back.T @ targets[0] + origin - place))
        ahead = max(distance, 2 * MIN_GAZE_DISTANCE) * pose.rotation[:, 2]
        offset = place + ahead - origin
        speed = (
            velocity + cross(twist[3:], ahead) - origin_twist[:3] - cross(origin_twist[3:], offset)
        )
        return vector_trajectory(np.array([back @ offset, *targets]), back @ speed, durations, dt)

    def _follow(self, target: FloatArray) -> None:
        self._target = target

    def _set_reference(self, velocity: FloatArray | None, acceleration: FloatArray | None) -> None:
        """Store the motion of the target: :meth:`compute` makes it a part of the rows."""
        if velocity is None or acceleration is None:
            self._target_motion = None
        else:
            self._target_motion = velocity, acceleration
        self._reference_velocity = self._reference_acceleration = None


def _turn_left(x: float, y: float, z: float) -> tuple[float, float]:
    """Return the first two numbers of the rotation vector from the third axis to (x, y, z) [rad]; the third is 0."""
    sine = hypot(x, y)
    angle = atan2(sine, z)
    if sine <= MIN_SINE * abs(z):  # along the axis, or opposite: then any normal axis is correct
        return (0.0, 0.0) if z > 0 else (angle, 0.0)
    return -y / sine * angle, x / sine * angle


def _carried(
    motion: tuple[FloatArray, FloatArray], rotation: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return velocity and acceleration, in world axes, that a motion within a turning link adds to that of the link."""
    velocity = rotation.dot(motion[0])
    return velocity, rotation.dot(motion[1]) + 2.0 * cross(w, velocity)


def _axes_about(axis: FloatArray) -> FloatArray:
    """Return (3, 3) right-handed unit axes as rows, the last one along ``axis``."""
    last = axis / np.linalg.norm(axis)
    first = np.cross(np.eye(3)[np.argmin(np.abs(last))], last)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(last, first), last])
