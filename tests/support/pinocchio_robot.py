"""Links and torques of the robot by Pinocchio and its URDF alone: it shares no code with the controller's model."""

from __future__ import annotations

import pinocchio as pin

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray

ROBOT = load_robot()


class PinocchioRobot:
    """The robot with its base fixed and its wheels locked.

    Attributes:
        model: Of Pinocchio.
    """

    def __init__(self) -> None:
        full = pin.buildModelFromUrdf(str(ROBOT.urdf))
        locked = [
            number
            for number in range(1, full.njoints)
            if full.names[number] not in ROBOT.joint_names
        ]
        self.model = pin.buildReducedModel(full, locked, pin.neutral(full))
        self._data = self.model.createData()
        joints = [self.model.joints[self.model.getJointId(name)] for name in ROBOT.joint_names]
        self._q, self._v = [joint.idx_q for joint in joints], [joint.idx_v for joint in joints]

    def add(self, link: str, inertia: pin.Inertia) -> None:
        """Fix a body, in the axes of a link, to the link."""
        frame = self.model.frames[self.model.getBodyId(link)]
        joint = frame.parentJoint
        self.model.inertias[joint] = self.model.inertias[joint] + frame.placement.act(inertia)

    def link_pose(self, link: str, position: FloatArray) -> FloatArray:
        """Return the (4, 4) pose of a link in that of the base."""
        pin.framesForwardKinematics(self.model, self._data, self._configuration(position))
        pose: FloatArray = self._data.oMf[self.model.getBodyId(link)].homogeneous
        return pose

    def point_jacobian(self, link: str, point: FloatArray, position: FloatArray) -> FloatArray:
        """Return the (3, 17) velocity of a point, given in the axes of its link, per joint velocity."""
        frame = self.model.getBodyId(link)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        moved = pin.computeFrameJacobian(
            self.model, self._data, self._configuration(position), frame, axes
        )
        arm = self.link_pose(link, position)[:3, :3] @ point
        jacobian: FloatArray = (moved[:3] - pin.skew(arm) @ moved[3:])[:, self._v]
        return jacobian

    def gravity_torque(self, position: FloatArray) -> FloatArray:
        """Return the (17,) torques that hold the links against gravity [N m]."""
        torque = pin.computeGeneralizedGravity(
            self.model, self._data, self._configuration(position)
        )
        held: FloatArray = torque[self._v]
        return held

    def _configuration(self, position: FloatArray) -> FloatArray:
        configuration: FloatArray = pin.neutral(self.model)
        configuration[self._q] = position
        return configuration
