"""Rigid-body model of the controller: Pinocchio on the URDF of the robot, with a base that moves in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments, real_array
from pepper_driver.config.arrays import FloatArray, IndexArray
from pepper_driver.config.errors import ArgumentError, check_name, shown

WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

ACCELERATIONS = pin.KinematicLevel.ACCELERATION

BASE = 3
"""Number of base velocities, which come first: vx, vy, wz of base_link in its own axes."""


@dataclass(frozen=True, slots=True)
class BodyFrame:
    """Frame on a link: number of the ``joint`` that carries it, and its ``placement`` (SE3) relative to that joint."""

    link: str
    joint: int
    placement: Any


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadTorque:
    """Parts of a load torque, each (17,) [N m]: M(q) a, C(q, v) v and g(q). Their sum is tau_ld of Eq. 11."""

    inertial: FloatArray
    coriolis: FloatArray
    gravity: FloatArray


@checked_arguments
class RobotModel:
    """Kinematics and dynamics of the robot with 3 base and 17 joint degrees of freedom.

    Model vectors have length ``nv`` = 20: base twist (vx, vy, wz) in base axes, then Pinocchio's joint order. Joint
    vectors have length 17 and follow ``RobotConfig.joint_names``. Joints are found by name: Pinocchio sorts them.

    The world is the start of the base: its origin and axes are those of base_link after a reset. The results of the
    methods on frames and centre of mass are those of the stored state, after :meth:`update_kinematics`.

    Attributes:
        nv: 20.
        joint_columns: (17,) index of each joint in a model vector.
        q: Configuration that :meth:`set_state` stored (base pose, joints in Pinocchio's order).
        v: (20,) velocity that :meth:`set_state` stored.
        joint_position: (17,) joint positions of that state [rad]; may be a view of it.
        joint_velocity: (17,) joint velocities of that state [rad/s]; may be a view of it.
        centre_of_mass: (3,) in the world [m], after :meth:`centroidal_momentum`; a view of its results.
        robot: The description it was made from.
        data: Pinocchio's results for the stored state.
        pin: Pinocchio's model.
    """

    def __init__(self, robot: RobotConfig) -> None:
        full = pin.buildModelFromUrdf(str(robot.urdf), pin.JointModelPlanar())
        wheels = [full.getJointId(name) for name in robot.wheels.names]
        self.robot = robot
        self.pin = pin.buildReducedModel(full, wheels, pin.neutral(full))
        joints = [self.pin.joints[self.pin.getJointId(name)] for name in robot.joint_names]
        self._position_columns = _selection([joint.idx_q for joint in joints])
        self._velocity_columns = _selection([joint.idx_v for joint in joints])
        self.joint_columns = np.array([joint.idx_v for joint in joints], dtype=np.intp)
        armature = self.pin.armature.copy()
        armature[self.joint_columns] += robot.armature
        self.pin.armature = armature
        self.data = self.pin.createData()
        # For other states than the stored one, whose results must stay.
        self._other_data = self.pin.createData()
        # Kept for all that need it in a cycle, whatever tasks of users compute in `data`.
        self._momentum_data = self.pin.createData()
        self.nv: int = self.pin.nv
        self._zero = np.zeros(self.nv)
        self.q: FloatArray
        self.v: FloatArray
        self.centre_of_mass: FloatArray
        self.joint_position: FloatArray
        self.joint_velocity: FloatArray
        self.set_state(pin.neutral(self.pin), np.zeros(self.nv))
        # Views of the results of Pinocchio: they change with its next call.
        data, momentum = self.data, self._momentum_data
        self._com, self._com_velocity, self._com_bias = data.com[0], data.vcom[0], data.acom[0]
        self._momentum_map, self._momentum = momentum.Ag, momentum.hg.vector
        self._momentum_bias, self.centre_of_mass = momentum.dhg.vector, momentum.com[0]

    # -- state --------------------------------------------------------------------------------------------------

    def set_state(self, q: FloatArray, v: FloatArray) -> None:
        """Store the state that tasks and constraints are evaluated at; the arrays are kept, not copied."""
        self.q, self.v = q, v
        self.joint_position = q[self._position_columns]
        self.joint_velocity = v[self._velocity_columns]
        self._has_kinematics = self._has_momentum = False

    def update_kinematics(self) -> None:
        """Compute placements, velocities and Jacobians of the stored state, once for each."""
        if not self._has_kinematics:
            pin.forwardKinematics(self.pin, self.data, self.q, self.v, self._zero)
            pin.computeJointJacobians(self.pin, self.data)
            self._has_kinematics = True

    def joints_of_configuration(self, q: FloatArray) -> FloatArray:
        """Return the (17,) joint positions of a configuration [rad]; may be a view of it."""
        position: FloatArray = q[self._position_columns]
        return position

    def joints_of(self, vector: FloatArray) -> FloatArray:
        """Return the (17,) part of the joints of a (20,) model vector; may be a view of it."""
        part: FloatArray = vector[self._velocity_columns]
        return part

    def of_joints(self, values: FloatArray) -> FloatArray:
        """Return the (20,) model vector of (17,) values of the joints, with a base at rest."""
        vector = np.zeros(self.nv)
        vector[self._velocity_columns] = values
        return vector

    # -- frames -------------------------------------------------------------------------------------------------

    def body_frame(
        self, link: str, xyz: ArrayLike | None = None, rotation: FloatArray | None = None
    ) -> BodyFrame:
        """Return a frame at ``xyz`` (3,) [m] in a link, turned by ``rotation`` (3, 3); by default the link's own.

        Raises:
            UnknownNameError: No such link.
        """
        frame = self.pin.frames[self.frame_id(link)]
        offset = pin.SE3(
            np.eye(3) if rotation is None else rotation,
            np.zeros(3) if xyz is None else np.asarray(xyz, dtype=np.float64),
        )
        return BodyFrame(link, int(frame.parentJoint), frame.placement * offset)

    def pose(self, frame: BodyFrame) -> Any:  # noqa: ANN401 Pinocchio has no types
        """Return the SE3 ``transform_frame_to_world``."""
        return self.data.oMi[frame.joint] * frame.placement

    def jacobian(self, frame: BodyFrame) -> FloatArray:
        """Return (6, 20) linear, then angular velocity of the frame in world axes, per velocity."""
        jacobian: FloatArray = pin.getFrameJacobian(
            self.pin, self.data, frame.joint, frame.placement, WORLD_AXES
        )
        return jacobian

    def velocity(self, frame: BodyFrame) -> FloatArray:
        """Return (6,) linear [m/s], then angular [rad/s] velocity of the frame in world axes."""
        motion = pin.getFrameVelocity(self.pin, self.data, frame.joint, frame.placement, WORLD_AXES)
        velocity: FloatArray = motion.vector
        return velocity

    def bias(self, frame: BodyFrame) -> FloatArray:
        """Return (6,) Jdot v: acceleration of the frame's origin in world axes without joint accelerations."""
        motion = pin.getFrameClassicalAcceleration(
            self.pin, self.data, frame.joint, frame.placement, WORLD_AXES
        )
        acceleration: FloatArray = motion.vector
        return acceleration

    # -- centre of mass and momentum ----------------------------------------------------------------------------

    def com(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Compute the centre of mass in the world: position (3,), Jacobian (3, 20), velocity (3,), Jdot v (3,).

        Views of the results for the stored state, which the next call overwrites.
        """
        data = self.data
        pin.centerOfMass(self.pin, data, ACCELERATIONS, False)
        jacobian = pin.jacobianCenterOfMass(self.pin, data, False)
        return self._com, jacobian, self._com_velocity, self._com_bias

    def centroidal_momentum(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the momentum about the centre of mass in world axes, linear, then angular; once for each state.

        Returns:
            (6, 20) momentum per velocity; (6,) momentum [kg m/s], [kg m2/s]; (6,) its rate without accelerations.
            Views of the results for the stored state.
        """
        if not self._has_momentum:
            model, data = self.pin, self._momentum_data
            pin.forwardKinematics(model, data, self.q, self.v, self._zero)
            pin.ccrba(model, data, self.q, self.v)
            pin.computeCentroidalMomentumTimeVariation(model, data)
            self._has_momentum = True
        return self._momentum_map, self._momentum, self._momentum_bias

    # -- conversion ---------------------------------------------------------------------------------------------

    def configuration(self, joint_position: FloatArray) -> FloatArray:
        """Return the configuration with the base at the origin and the joints at (17,) positions [rad]."""
        q: FloatArray = pin.neutral(self.pin)
        q[self._position_columns] = joint_position
        return q

    def with_joint_position(self, q: FloatArray, joint_position: FloatArray) -> FloatArray:
        """Return a copy of ``q`` with other joint positions (17,) [rad]."""
        changed = q.copy()
        changed[self._position_columns] = joint_position
        return changed

    def with_base_pose(self, q: FloatArray, pose: FloatArray) -> FloatArray:
        """Return a copy of ``q`` with the base at (3,) x [m], y [m], heading [rad] in the world."""
        changed = q.copy()
        changed[0], changed[1] = pose[0], pose[1]
        # Pinocchio stores the heading of a planar joint as cosine and sine.
        changed[2], changed[3] = np.cos(pose[2]), np.sin(pose[2])
        return changed

    def base_pose(self, q: FloatArray) -> FloatArray:
        """Return (3,) x [m], y [m], heading [rad] of the base in the world."""
        return np.array([q[0], q[1], np.arctan2(q[3], q[2])])

    def integrate(self, q: FloatArray, displacement: FloatArray) -> FloatArray:
        """Return ``q`` after a (20,) displacement; the base moves on SE(2)."""
        moved: FloatArray = pin.integrate(self.pin, q, displacement)
        return moved

    # -- dynamics -----------------------------------------------------------------------------------------------

    def load_torque(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Compute the (17,) inverse dynamics M(q) a + C(q, v) v + g(q), the desired load torque of Eq. 11 [N m]."""
        torque: FloatArray = pin.rnea(self.pin, self._other_data, q, v, a)
        return self.joints_of(torque)

    def load_torque_parts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> LoadTorque:
        """Return the parts of :meth:`load_torque` at the same state."""
        gravity = self.load_torque(q, self._zero, self._zero)
        still = self.load_torque(q, self._zero, a)
        return LoadTorque(
            inertial=still - gravity,
            coriolis=self.load_torque(q, v, a) - still,
            gravity=gravity,
        )

    def body_torques(
        self,
        joints: Sequence[str],
        joint_position: FloatArray,
        joint_velocity: FloatArray,
        joint_acceleration: FloatArray,
    ) -> FloatArray:
        """Return the load torques that a body on the link of each joint adds, per its mass and first moment.

        The inertia of the body about the origin of the link is left out. The base stands.

        Args:
            joints: Names of m joints.
            joint_position: (17,) [rad].
            joint_velocity: (17,) [rad/s].
            joint_acceleration: (17,) [rad/s2].

        Raises:
            UnknownNameError: No such joint.

        Returns:
            (m, 17, 4) torques per m [kg] and m c [kg m], with the centre c in the frame of the joint.
        """
        for name in joints:
            check_name("joint", name, self.robot.joint_names)
        q = self.configuration(joint_position)
        v, a = self.of_joints(joint_velocity), self.of_joints(joint_acceleration)
        # Ten parameters for each body: m, m c, and six of its inertia.
        torques = pin.computeJointTorqueRegressor(self.pin, self._other_data, q, v, a)
        starts = [10 * (self.pin.getJointId(name) - 1) for name in joints]
        return np.array([torques[self.joint_columns, start : start + 4] for start in starts])

    def joint_origin(self, joint: str) -> FloatArray:
        """Return the (3,) origin of a joint in the frame of the joint before it [m]."""
        origin: FloatArray = self.pin.jointPlacements[self.pin.getJointId(joint)].translation.copy()
        return origin

    def gravity_torque(self, joint_position: FloatArray) -> FloatArray:
        """Return the (17,) load torque of a robot at rest at (17,) joint positions [N m]."""
        q = self.configuration(joint_position)
        return self.load_torque(q, self._zero, self._zero)

    # -- other states -------------------------------------------------------------------------------------------

    def frame_id(self, link: str) -> int:
        """Return the number of a link in Pinocchio.

        Raises:
            UnknownNameError: No such link.
        """
        check_name("link", link, self.robot.links)
        number: int = self.pin.getFrameId(link)
        return number

    def link_pose(self, link: str, joint_position: FloatArray) -> FloatArray:
        """Return the (4, 4) transform of a link in base_link, at (17,) joint positions [rad].

        Raises:
            UnknownNameError: No such link.
            ArgumentError: Not 17 numbers.
        """
        frame = self.frame_id(link)
        data, count = self._other_data, len(self.robot.joint_names)
        position = real_array(joint_position, (count,))
        if position is None:
            raise ArgumentError(f"link_pose takes {count} angles, got {shown(joint_position)}")
        pin.forwardKinematics(self.pin, data, self.configuration(position))
        pose: FloatArray = pin.updateFramePlacement(self.pin, data, frame).homogeneous
        return pose

    def point_jacobian(
        self, link: str, point: FloatArray, joint_position: FloatArray
    ) -> FloatArray:
        """Return the (3, 17) velocity of a point of a link per joint velocity, in the axes of base_link.

        Args:
            link: Name of the link.
            point: (3,) in the link's frame [m].
            joint_position: (17,) [rad].

        Raises:
            UnknownNameError: No such link.
        """
        jacobian: FloatArray = self.place_points(link, point[None], joint_position)[1][0]
        return jacobian

    def place_points(
        self, link: str, points: FloatArray, joint_position: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places of points of a link, their Jacobians, and the axes of the joints that carry it.

        The places are (m, 3) in base_link [m], the Jacobians (m, 3, 17) in its axes. The axes are (3, 17) unit vectors
        in the link's frame, 0 for joints that do not carry the link.

        Args:
            link: Name of the link.
            points: (m, 3) in the link's frame [m].
            joint_position: (17,) [rad].

        Raises:
            UnknownNameError: No such link.
        """
        frame = self.frame_id(link)
        q = self.configuration(joint_position)
        full = pin.computeFrameJacobian(self.pin, self._other_data, q, frame, WORLD_AXES)
        jacobian = full[:, self.joint_columns]
        pose = self.link_pose(link, joint_position)
        levers = points @ pose[:3, :3].T
        turning = (levers @ _CROSS).reshape(-1, 3, 3) @ jacobian[3:]
        return levers + pose[:3, 3], jacobian[:3] + turning, pose[:3, :3].T @ jacobian[3:]


_CROSS = -np.cross(np.eye(3)[:, None], np.eye(3)[None, :]).transpose(0, 2, 1).reshape(3, 9)
"""(3, 9): of a lever r, the matrix of w x r for a turning w, row by row. ``np.cross`` takes ten times as long."""


def _selection(columns: list[int]) -> slice | IndexArray:
    """Return a slice, which avoids a copy, if the columns are consecutive."""
    if columns == list(range(columns[0], columns[0] + len(columns))):
        return slice(columns[0], columns[0] + len(columns))
    return np.array(columns, dtype=np.intp)
