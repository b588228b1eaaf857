"""The rigid-body model of the controller: Pinocchio on the robot's URDF, with a base that moves in the plane."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig, UnknownNameError

FloatArray = NDArray[np.float64]

WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

BASE = 3
"""Velocities of the base come first: vx, vy, wz of base_link in its own axes."""


class RobotModel:
    """Kinematics and dynamics of the robot with 3 base and 17 joint degrees of freedom.

    Model vectors have length ``nv`` = 20: base twist (vx, vy, wz) in base axes, then Pinocchio's joint order. Joint
    vectors have length 17 and follow ``RobotConfig.joint_names``. Joints are found by name: Pinocchio sorts them.

    Attributes:
        nv: 20.
        joint_columns: (17,) place of each joint in a model vector.
        q: Configuration that :meth:`set_state` stored (base pose, joints).
        v: (20,) velocity that :meth:`set_state` stored.
    """

    def __init__(self, robot: RobotConfig) -> None:
        full = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelPlanar())
        wheels = [full.getJointId(name) for name in robot.wheels.names]
        self._robot = robot
        self._pin = pin.buildReducedModel(full, wheels, pin.neutral(full))
        joints = [self._pin.joints[self._pin.getJointId(name)] for name in robot.joint_names]
        self._position_columns = np.array([joint.idx_q for joint in joints], dtype=np.intp)
        self.joint_columns = np.array([joint.idx_v for joint in joints], dtype=np.intp)
        armature = self._pin.armature.copy()
        armature[self.joint_columns] += robot.armature
        self._pin.armature = armature
        self._data = self._pin.createData()
        self._elsewhere = (
            self._pin.createData()
        )  # for questions about other states than the stored one
        self.nv: int = self._pin.nv
        self.q: FloatArray = pin.neutral(self._pin)
        self.v: FloatArray = np.zeros(self.nv)
        self._zero = np.zeros(self.nv)

    # -- state --------------------------------------------------------------------------------------------------

    def set_state(self, q: FloatArray, v: FloatArray) -> None:
        """Store the state that tasks and constraints are evaluated at."""
        self.q, self.v = q, v

    def update_kinematics(self) -> None:
        """Compute Jacobians and frames of the stored state, for tasks that need them."""
        pin.forwardKinematics(self._pin, self._data, self.q, self.v, self._zero)
        pin.computeJointJacobians(self._pin, self._data)
        pin.updateFramePlacements(self._pin, self._data)

    def frame_pose(self, frame: int) -> FloatArray:
        """(4, 4) transform of a link in the world, after :meth:`update_kinematics`."""
        pose: FloatArray = self._data.oMf[frame].homogeneous
        return pose

    def frame_jacobian(self, frame: int) -> FloatArray:
        """(6, 20) linear, then angular velocity of a link's origin in world axes, after :meth:`update_kinematics`."""
        jacobian: FloatArray = pin.getFrameJacobian(self._pin, self._data, frame, WORLD_AXES)
        return jacobian

    def frame_bias(self, frame: int) -> FloatArray:
        """(6,) Jdot v: acceleration of a link's origin in world axes without joint accelerations."""
        bias = pin.getFrameClassicalAcceleration(self._pin, self._data, frame, WORLD_AXES)
        return np.concatenate([bias.linear, bias.angular])

    @property
    def joint_position(self) -> FloatArray:
        """(17,) joint positions of the stored state [rad]."""
        position: FloatArray = self.q[self._position_columns]
        return position

    @property
    def joint_velocity(self) -> FloatArray:
        """(17,) joint velocities of the stored state [rad/s]."""
        velocity: FloatArray = self.v[self.joint_columns]
        return velocity

    # -- conversion ---------------------------------------------------------------------------------------------

    def configuration(self, joint_position: FloatArray) -> FloatArray:
        """Configuration with the base at the origin and the joints at (17,) positions [rad]."""
        q: FloatArray = pin.neutral(self._pin)
        q[self._position_columns] = joint_position
        return q

    def with_joint_position(self, q: FloatArray, joint_position: FloatArray) -> FloatArray:
        """A copy of ``q`` with other joint positions (17,) [rad]."""
        changed = q.copy()
        changed[self._position_columns] = joint_position
        return changed

    def integrate(self, q: FloatArray, displacement: FloatArray) -> FloatArray:
        """``q`` moved by a (20,) displacement; the base moves on SE(2)."""
        moved: FloatArray = pin.integrate(self._pin, q, displacement)
        return moved

    # -- dynamics -----------------------------------------------------------------------------------------------

    def load_torque(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """(17,) inverse dynamics M(q) a + c(q, v), the desired load torque of Eq. 11 [N m]."""
        torque: FloatArray = pin.rnea(self._pin, self._elsewhere, q, v, a)[self.joint_columns]
        return torque

    def gravity_torque(self, joint_position: FloatArray) -> FloatArray:
        """(17,) load torque of a robot that stands still at (17,) joint positions [N m]."""
        q = self.configuration(joint_position)
        return self.load_torque(q, self._zero, self._zero)

    # -- kinematics ---------------------------------------------------------------------------------------------

    def frame_id(self, link: str) -> int:
        """Pinocchio's number of a link.

        Raises:
            UnknownNameError: No such link.
        """
        if link not in self._robot.links:
            raise UnknownNameError("link", link, self._robot.links)
        number: int = self._pin.getFrameId(link)
        return number

    def link_pose(self, link: str, joint_position: FloatArray) -> FloatArray:
        """(4, 4) transform of a link in base_link, at (17,) joint positions [rad]."""
        frame = self.frame_id(link)
        data = self._elsewhere
        pin.forwardKinematics(self._pin, data, self.configuration(joint_position))
        pose: FloatArray = pin.updateFramePlacement(self._pin, data, frame).homogeneous
        return pose

    def point_jacobian(
        self, link: str, point: FloatArray, joint_position: FloatArray
    ) -> FloatArray:
        """(3, 17) velocity of a point of a link per joint velocity, in the axes of base_link.

        Args:
            link: Name of the link.
            point: (3,) in the link's frame [m].
            joint_position: (17,) [rad].

        Raises:
            UnknownNameError: No such link.
        """
        frame = self.frame_id(link)
        q = self.configuration(joint_position)
        full = pin.computeFrameJacobian(self._pin, self._elsewhere, q, frame, WORLD_AXES)
        jacobian = full[:, self.joint_columns]
        rotation = self.link_pose(link, joint_position)[:3, :3]
        arm = rotation @ point
        velocity: FloatArray = jacobian[:3] + np.cross(jacobian[3:], arm, axis=0)
        return velocity
