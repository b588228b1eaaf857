"""Where a frame of the robot is and how it moves, seen from the world or from another frame of the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.controller.model import BodyFrame, RobotModel

FloatArray = NDArray[np.float64]


class FrameMotion:
    """Pose, Jacobian and bias of a frame, all in the axes of the frame it is seen from.

    Args:
        frame: Which.
        seen_from: From where; None for the world.

    Attributes:
        position: (3,) of the frame's origin [m].
        rotation: (3, 3) ``rotation_frame_to_seen_from``.
        jacobian: (6, 20) velocity per velocity of the model.
        bias: (6,) acceleration without accelerations of the model.
    """

    position: FloatArray
    rotation: FloatArray
    jacobian: FloatArray
    bias: FloatArray

    def __init__(
        self, model: RobotModel, frame: BodyFrame, seen_from: BodyFrame | None = None
    ) -> None:
        self._frame, self._seen_from = frame, seen_from
        # Views of what Pinocchio computes, where the frame is that of a joint.
        at_joint = frame.placement.isIdentity() and seen_from is None
        self._carrier = model.data.oMi[frame.joint]
        self.position, self.rotation = self._carrier.translation, self._carrier.rotation
        self._at_joint = at_joint

    def update(self, model: RobotModel) -> None:
        """Evaluate at the model's state, whose kinematics must have been computed."""
        if not self._at_joint:
            pose = self._carrier * self._frame.placement
            self.position, self.rotation = pose.translation, pose.rotation
        self.jacobian, self.bias = model.jacobian(self._frame), model.bias(self._frame)
        if self._seen_from is not None:
            self._turn_to(model, self._seen_from)

    def _turn_to(self, model: RobotModel, origin: BodyFrame) -> None:
        """From the world to a frame that moves itself.

        With w its angular velocity, d the way from its origin: v = R' (v - v_0 - w x d), and for the bias
        R' (a - a_0 - dw/dt x d - w x (w x d) - 2 w x (R v)); angular R' (W - w), R' (dW/dt - dw/dt - w x W).
        """
        pose = model.pose(origin)
        back = pose.rotation.T
        bias, jacobian = model.bias(origin), model.jacobian(origin)
        own, velocity = self.jacobian @ model.v, jacobian @ model.v
        way = self.position - pose.translation
        w = velocity[3:]
        linear = own[:3] - velocity[:3] - _cross(w, way)
        self.bias = np.concatenate(
            [
                back
                @ (
                    self.bias[:3]
                    - bias[:3]
                    - _cross(bias[3:], way)
                    - _cross(w, _cross(w, way))
                    - 2.0 * _cross(w, linear)
                ),
                back @ (self.bias[3:] - bias[3:] - _cross(w, own[3:])),
            ]
        )
        x, y, z = way.tolist()
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        difference = self.jacobian - jacobian
        difference[:3] += skew @ jacobian[3:]
        self.jacobian = np.concatenate([back @ difference[:3], back @ difference[3:]])
        self.position, self.rotation = back @ way, back @ self.rotation


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product of (3,) vectors, without the overhead of NumPy's."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
