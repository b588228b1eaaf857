"""Tasks of a frame: position, orientation and pose of a link, in the world or in another link."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.model import BodyFrame, RobotModel
from pepper_driver.controller.tasks.targets import (
    Target,
    check_link,
    checked_pose,
    checked_rotation,
    finite_vector,
)
from pepper_driver.controller.tasks.task import Task, TaskRows
from pepper_driver.controller.trajectory import (
    Trajectory,
    rotation_spline,
    spline,
    vector_trajectory,
)

OWN_AXES = pin.ReferenceFrame.LOCAL


class FrameMotion:
    """Pose, Jacobian and bias of a frame, all in the axes of its root.

    Args:
        model: Model that gives them.
        frame: The frame.
        root: Frame that they are relative to; None for the world.

    Attributes:
        position: (3,) position of the origin [m].
        rotation: (3, 3) ``rotation_frame_to_root``.
        jacobian: (6, 20) velocity per velocity of the model.
        bias: (6,) acceleration without accelerations of the model.
    """

    position: FloatArray
    rotation: FloatArray
    jacobian: FloatArray
    bias: FloatArray

    def __init__(self, model: RobotModel, frame: BodyFrame, root: BodyFrame | None = None) -> None:
        self._frame, self._root = frame, root
        # Views of the results of Pinocchio, if the frame is that of a joint.
        at_joint = frame.placement.isIdentity() and root is None
        self._carrier = model.data.oMi[frame.joint]
        self.position, self.rotation = self._carrier.translation, self._carrier.rotation
        self._at_joint = at_joint
        self._turned, self._turned_bias = np.zeros((6, model.nv)), np.zeros(6)
        # Minus the velocity of the origin at the frame; update writes the distance in.
        self._shift = -np.eye(6)

    def update(self, model: RobotModel) -> None:
        """Evaluate at the model's state, whose kinematics must have been computed."""
        if not self._at_joint:
            pose = self._carrier * self._frame.placement
            self.position, self.rotation = pose.translation, pose.rotation
        self.jacobian, self.bias = model.jacobian(self._frame), model.bias(self._frame)
        if self._root is not None:
            self._turn_to(model, self._root)

    def _turn_to(self, model: RobotModel, origin: BodyFrame) -> None:
        """Transform from the world to a frame that moves itself.

        All in the axes of that frame, with w its angular velocity and d the distance from its origin: the relative
        velocity is l = v - v_0 - w x d, and the bias is a - a_0 - dw/dt x d - w x (w x d + 2 l), angular
        dW/dt - dw/dt - w x W.
        """
        pose = model.pose(origin)
        back = pose.rotation.T
        of_origin = (model.pin, model.data, origin.joint, origin.placement, OWN_AXES)
        frame, bias, jacobian = self.jacobian, self._turned_bias, self._turned
        back.dot(frame[:3], jacobian[:3])
        back.dot(frame[3:], jacobian[3:])
        distance = back.dot(self.position - pose.translation)
        x, y, z = distance.tolist()
        shift = self._shift
        shift[0, 4], shift[0, 5], shift[1, 3] = -z, y, z
        shift[1, 5], shift[2, 3], shift[2, 4] = -x, -y, x
        own = pin.getFrameJacobian(*of_origin)
        jacobian += shift.dot(own)
        lx, ly, lz, rx, ry, rz = jacobian.dot(model.v).tolist()
        wx, wy, wz = own[3:].dot(model.v).tolist()
        ux, uy, uz = (
            wy * z - wz * y + 2.0 * lx,
            wz * x - wx * z + 2.0 * ly,
            wx * y - wy * x + 2.0 * lz,
        )
        bias[...] = (
            wz * uy - wy * uz,
            wx * uz - wz * ux,
            wy * ux - wx * uy,
            wz * ry - wy * rz,
            wx * rz - wz * rx,
            wy * rx - wx * ry,
        )
        bias += shift.dot(pin.getFrameClassicalAcceleration(*of_origin).vector)
        bias[:3] += back.dot(self.bias[:3])
        bias[3:] += back.dot(self.bias[3:])
        self.jacobian, self.bias = jacobian, bias
        self.position, self.rotation = distance, back.dot(self.rotation)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector product of (3,) vectors, without the overhead of NumPy."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


class _FrameTask(Task):
    """Common part of tasks of a frame: the frame, its root, and what may move it."""

    _shape: tuple[int, ...]  # of the target

    def __init__(
        self,
        kind: str,
        rows: int,
        link: str,
        point: ArrayLike | None,
        root: str | None,
        joints: Sequence[str] | None,
        base: bool,
        stiffness: float,
        weight: float,
        name: str | None,
        robot: RobotConfig | None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        check_link(robot, link)
        if root is not None:
            check_link(robot, root)
        if root == link:
            raise TargetError(
                f"{link} cannot be the root of its own target: name another link, or none for the world"
            )
        label = f"{kind} {link}" + (f" from {root}" if root is not None else "")
        super().__init__(rows, stiffness=stiffness, weight=weight, name=name or label)
        self._link, self._root = link, root
        self._point = (
            None if point is None else finite_vector(f"the point of {self.name}", point, 3)
        )
        self._target: FloatArray | None = None
        self.select(robot, joints, base=base)

    @property
    def target(self) -> FloatArray:
        """Target, a copy; until it is set, the value at first use of the task (NaN before that).

        Raises:
            TargetError: Invalid target; the previous one stays.
        """
        if self._target is None:
            return np.full(self._shape, np.nan)
        return self._target.copy()

    @target.setter
    def target(self, value: ArrayLike) -> None:
        self._set_target(self.checked(value))

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Find the frames in the model."""
        super().attach(model, rows)
        origin = None if self._root is None else model.body_frame(self._root)
        self._motion = FrameMotion(model, model.body_frame(self._link, self._point), origin)

    def _follow(self, target: FloatArray) -> None:
        self._target = target


@checked_arguments
class PositionTask(_FrameTask):
    """Position of a point of a link.

    The error is in the axes of the root, and so are the rows of ``dim_weight``.

    Args:
        link: Name of the link.
        point: (3,) in the link [m], by default its origin.
        root: Link in which the target is given; None for the world, which is the start of the base.
        joints: Joints that may move for it, by default all.
        base: True to let the base move for it too.
        stiffness: [1/s2].
        weight: Weight in the cost.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such link or joint.
        TargetError: Invalid point; link and root are the same.
    """

    _shape = (3,)

    def __init__(
        self,
        link: str,
        point: ArrayLike | None = None,
        *,
        root: str | None = None,
        joints: Sequence[str] | None = None,
        base: bool = False,
        stiffness: float = 10.0,
        weight: float = 1e4,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        super().__init__(
            "position", 3, link, point, root, joints, base, stiffness, weight, name, robot
        )

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the error: target minus position [m]."""
        motion = self._motion
        motion.update(model)
        if self._target is None:
            self._target = motion.position.copy()
        np.subtract(self._target, motion.position, rows.error)
        rows.jacobian[:], rows.bias[:] = motion.jacobian[:3], motion.bias[:3]

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        self._motion.update(model)
        points = np.array([self._motion.position, *targets])
        velocity = (self._motion.jacobian @ model.v)[:3]
        return vector_trajectory(points, velocity, durations, dt)


@checked_arguments
class OrientationTask(_FrameTask):
    """Orientation of a link, by the shorter turn.

    The error is a rotation vector in the axes of the root, and so are the rows of ``dim_weight``.

    Args:
        link: Name of the link.
        root: Link in which the target is given; None for the world.
        joints: Joints that may move for it, by default all.
        base: True to let the base move for it too.
        stiffness: [1/s2].
        weight: Weight in the cost.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such link or joint.
        TargetError: Link and root are the same.
    """

    _shape = (3, 3)

    def __init__(
        self,
        link: str,
        *,
        root: str | None = None,
        joints: Sequence[str] | None = None,
        base: bool = False,
        stiffness: float = 10.0,
        weight: float = 1e3,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        super().__init__(
            "orientation", 3, link, None, root, joints, base, stiffness, weight, name, robot
        )

    def checked(self, target: Target) -> FloatArray:
        """Return the (3, 3) rotation matrix of a rotation matrix or a unit quaternion (x, y, z, w)."""
        return checked_rotation(f"the target of {self.name}", target)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the error: the rotation vector from the orientation to the target [rad]."""
        motion = self._motion
        motion.update(model)
        if self._target is None:
            self._target = motion.rotation.copy()
        rows.error[:] = pin.log3(self._target.dot(motion.rotation.T))
        rows.jacobian[:], rows.bias[:] = motion.jacobian[3:], motion.bias[3:]

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        self._motion.update(model)
        rotations = [self._motion.rotation, *targets]
        velocity = (self._motion.jacobian @ model.v)[3:]
        return Trajectory(rotation_spline(rotations, velocity, durations), sum(durations), dt)


@checked_arguments
class FrameTask(_FrameTask):
    """Pose of a frame of a link: position and orientation together (SE3).

    The error is the distance [m], then the rotation vector [rad], in the axes of the root.

    Args:
        link: Name of the link.
        point: (3,) origin of the frame in the link [m], by default the link's; the axes are those of the link.
        root: Link in which the target is given (a relative task); None for the world.
        joints: Joints that may move for it, by default all.
        base: True to let the base move for it too.
        stiffness: [1/s2].
        weight: Weight in the cost.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such link or joint.
        TargetError: Invalid point; link and root are the same.
    """

    _shape = (4, 4)

    def __init__(
        self,
        link: str,
        point: ArrayLike | None = None,
        *,
        root: str | None = None,
        joints: Sequence[str] | None = None,
        base: bool = False,
        stiffness: float = 10.0,
        weight: float = 1e4,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        super().__init__("pose", 6, link, point, root, joints, base, stiffness, weight, name, robot)

    def checked(self, target: Target) -> FloatArray:
        """Return the (4, 4) transform of a transform or of (7,) position [m] and unit quaternion (x, y, z, w)."""
        return checked_pose(f"the target of {self.name}", target)

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Find the frames in the model."""
        super().attach(model, rows)
        # Views of the rows: `compute` writes into them without a copy.
        self._distance_left, self._turn_left = rows.error[:3], rows.error[3:]

    def _follow(self, target: FloatArray) -> None:
        self._target = target
        self._place, self._back = target[:3, 3].copy(), target[:3, :3].T.copy()

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the error: the distance vector to the target [m], then the rotation vector [rad]."""
        motion = self._motion
        motion.update(model)
        if self._target is None:
            self._follow(_pose(motion.position, motion.rotation))
        np.subtract(self._place, motion.position, self._distance_left)
        np.negative(pin.log3(motion.rotation.dot(self._back)), self._turn_left)
        rows.jacobian[...] = motion.jacobian
        rows.bias[...] = motion.bias

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        motion = self._motion
        motion.update(model)
        points = np.array([motion.position, *(target[:3, 3] for target in targets)])
        velocity = motion.jacobian @ model.v
        path = spline(points, velocity[:3], durations)
        turns = [motion.rotation, *(target[:3, :3] for target in targets)]
        turn = rotation_spline(turns, velocity[3:], durations)

        def both(times: FloatArray) -> tuple[FloatArray, FloatArray]:
            (positions, speeds), (rotations, angular) = path(times), turn(times)
            poses = np.tile(np.eye(4), (len(times), 1, 1))
            poses[:, :3, 3], poses[:, :3, :3] = positions, rotations
            return poses, np.hstack([speeds, angular])

        return Trajectory(both, sum(durations), dt)


def _pose(position: FloatArray, rotation: FloatArray) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = position, rotation
    return pose
