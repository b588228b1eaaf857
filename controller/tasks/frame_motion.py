"""Pose and motion of a frame of the robot, in the world or in another frame of the robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import BodyFrame, RobotModel

OWN_AXES = pin.ReferenceFrame.LOCAL


class FrameMotion:
    """Pose, Jacobian and bias of a frame, all in the axes of its root.

    Args:
        frame: Which.
        root: Frame that they are relative to; None for the world.

    Attributes:
        position: (3,) of the frame's origin [m].
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
        # Views of what Pinocchio computes, where the frame is that of a joint.
        at_joint = frame.placement.isIdentity() and root is None
        self._carrier = model.data.oMi[frame.joint]
        self.position, self.rotation = self._carrier.translation, self._carrier.rotation
        self._at_joint = at_joint
        self._turned, self._turned_bias = np.zeros((6, model.nv)), np.zeros(6)
        self._shift = -np.eye(
            6
        )  # what the motion of the origin takes away; the way is written in each time

    def update(self, model: RobotModel) -> None:
        """Evaluate at the model's state, whose kinematics must have been computed."""
        if not self._at_joint:
            pose = self._carrier * self._frame.placement
            self.position, self.rotation = pose.translation, pose.rotation
        self.jacobian, self.bias = model.jacobian(self._frame), model.bias(self._frame)
        if self._root is not None:
            self._turn_to(model, self._root)

    def _turn_to(self, model: RobotModel, origin: BodyFrame) -> None:
        """From the world to a frame that moves itself.

        All in that frame's axes: with w its angular velocity, d the way from its origin and l = v - v_0 - w x d the
        velocity relative to it, the bias is a - a_0 - dw/dt x d - w x (w x d + 2 l); angular dW/dt - dw/dt - w x W.
        """
        pose = model.pose(origin)
        back = pose.rotation.T
        of_origin = (model.pin, model.data, origin.joint, origin.placement, OWN_AXES)
        frame, bias, jacobian = self.jacobian, self._turned_bias, self._turned
        back.dot(frame[:3], jacobian[:3])
        back.dot(frame[3:], jacobian[3:])
        way = back.dot(self.position - pose.translation)
        x, y, z = way.tolist()
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
        self.position, self.rotation = way, back.dot(self.rotation)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product of (3,) vectors, without the overhead of NumPy's."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
