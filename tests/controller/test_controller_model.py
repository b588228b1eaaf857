"""The rigid-body model against MuJoCo on the same URDF, and against finite differences."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from support.controller import DT, JOINTS, MIDDLE, ROBOT, random_posture

MODEL = RobotModel(ROBOT)
STEP = 1e-6
LINKS = ("Tibia", "Pelvis", "torso", "Head", "LForeArm", "l_wrist", "r_wrist", "l_gripper")


class Mujoco:
    """MuJoCo on the robot's URDF, on a base with slides x, y and a hinge z."""

    def __init__(self) -> None:
        spec = mujoco.MjSpec()
        base = spec.worldbody.add_body(name="base")
        slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
        base.add_joint(name="x", type=slide, axis=[1, 0, 0])
        base.add_joint(name="y", type=slide, axis=[0, 1, 0])
        base.add_joint(name="yaw", type=hinge, axis=[0, 0, 1])
        robot = mujoco.MjSpec.from_file(str(ROBOT.urdf))
        for name in ROBOT.wheels.names:
            robot.delete(robot.joint(name))
        spec.attach(robot, prefix="robot/", frame=base.add_frame())
        self.model: Any = spec.compile()
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data: Any = mujoco.MjData(self.model)
        names = ("x", "y", "yaw", *(f"robot/{name}" for name in ROBOT.joint_names))
        self.columns = np.array([self.model.joint(name).dofadr[0] for name in names])
        self.model.dof_armature[self.columns[3:]] = ROBOT.armature
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT

    def inverse(self, position: FloatArray, velocity: FloatArray, a: FloatArray) -> FloatArray:
        """(17,) joint torques for (17,), (20,), (20,)."""
        data = self.data
        data.qpos[:] = 0.0
        data.qpos[self.columns[3:]] = position
        data.qvel[self.columns] = velocity
        # The twist is in axes of the base, which turn: d/dt (R v) = a + w x v.
        in_world = a.copy()
        in_world[0] -= velocity[2] * velocity[1]
        in_world[1] += velocity[2] * velocity[0]
        data.qacc[self.columns] = in_world
        mujoco.mj_inverse(self.model, data)
        torque: FloatArray = data.qfrc_inverse[self.columns[3:]].copy()
        return torque

    def potential(self, position: FloatArray) -> float:
        """Energy of the weights of all links [J]."""
        self.data.qpos[:] = 0.0
        self.data.qpos[self.columns[3:]] = position
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return float(9.81 * self.model.body_mass @ self.data.xipos[:, 2])

    def pose(self, link: str, position: FloatArray) -> FloatArray:
        self.potential(position)
        body = self.data.body(f"robot/{link}")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return pose


@pytest.fixture(scope="module")
def other() -> Mujoco:
    return Mujoco()


def vectors(base: FloatArray, joints: FloatArray) -> FloatArray:
    """(20,) of the model from (3,) and (17,)."""
    vector = np.empty(MODEL.nv)
    vector[:3] = base
    vector[MODEL.joint_columns] = joints
    return vector


def test_the_columns_are_a_permutation_after_the_base() -> None:
    assert MODEL.nv == 20
    assert sorted(MODEL.joint_columns) == list(range(3, 20))


@pytest.mark.parametrize("moving_base", [False, True])
def test_load_torque_is_mujocos_inverse_dynamics(other: Mujoco, moving_base: bool) -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        position = random_posture(random)
        velocity, acceleration = 2 * random.normal(size=JOINTS), 15 * random.normal(size=JOINTS)
        twist, change = random.normal(size=(2, 3)) * moving_base
        torque = MODEL.load_torque(
            MODEL.configuration(position), vectors(twist, velocity), vectors(change, acceleration)
        )
        expected = other.inverse(
            position,
            np.concatenate([twist, velocity]),
            np.concatenate([change, acceleration]),
        )
        assert np.abs(torque - expected).max() < 1e-9 * (1 + np.abs(expected).max())


def test_the_fingers_inertia_acts_on_the_hands_alone() -> None:
    q, still = MODEL.configuration(MIDDLE), np.zeros(20)
    for name in ROBOT.joint_names:
        a = np.zeros(JOINTS)
        a[ROBOT.joint_index(name)] = 1.0
        own = (
            MODEL.load_torque(q, still, vectors(np.zeros(3), a))
            - MODEL.load_torque(q, still, still)
        )[ROBOT.joint_index(name)]
        assert own > ROBOT.armature[ROBOT.joint_index(name)]
        if name in ROBOT.hands.joints:
            assert own == pytest.approx(ROBOT.hands.finger_inertia, rel=0.05)


def test_where_the_base_stands_does_not_matter() -> None:
    random = np.random.default_rng(3)
    position, v, a = random_posture(random), random.normal(size=20), random.normal(size=20)
    q = MODEL.configuration(position)
    moved = MODEL.integrate(q, vectors(np.array([1.0, -2.0, 0.7]), np.zeros(JOINTS)))
    assert np.abs(MODEL.load_torque(q, v, a) - MODEL.load_torque(moved, v, a)).max() < 1e-10


def test_gravity_torque_is_the_slope_of_the_potential_energy(other: Mujoco) -> None:
    random = np.random.default_rng(1)
    for _ in range(5):
        position = random_posture(random)
        slope = [
            (other.potential(position + step) - other.potential(position - step)) / (2 * STEP)
            for step in STEP * np.eye(JOINTS)
        ]
        assert np.abs(MODEL.gravity_torque(position) - slope).max() < 1e-7


@pytest.mark.parametrize("link", LINKS[1:])
def test_link_pose_is_mujocos(other: Mujoco, link: str) -> None:
    random = np.random.default_rng(2)
    for _ in range(5):
        position = random_posture(random)
        assert np.abs(MODEL.link_pose(link, position) - other.pose(link, position)).max() < 1e-9


@pytest.mark.parametrize("link", LINKS)
def test_point_jacobian_is_the_slope_of_link_pose(link: str) -> None:
    random = np.random.default_rng(4)
    point = random.normal(size=3)
    position = random_posture(random)

    def place(at: FloatArray) -> FloatArray:
        where: FloatArray = MODEL.link_pose(link, at) @ np.append(point, 1.0)
        return where[:3]

    jacobian = MODEL.point_jacobian(link, point, position)
    assert jacobian.shape == (3, JOINTS)
    for joint, step in enumerate(STEP * np.eye(JOINTS)):
        slope = (place(position + step) - place(position - step)) / (2 * STEP)
        assert np.abs(jacobian[:, joint] - slope).max() < 1e-8


def test_points_of_a_link_are_placed_together_as_one_by_one() -> None:
    random = np.random.default_rng(6)
    position, points = random_posture(random), random.normal(size=(4, 3))
    places, jacobians, axes = MODEL.place_points("LForeArm", points, position)
    pose = MODEL.link_pose("LForeArm", position)
    assert np.abs(places - (points @ pose[:3, :3].T + pose[:3, 3])).max() < 1e-12
    assert jacobians.shape == (4, 3, JOINTS)
    for point, jacobian in zip(points, jacobians, strict=True):
        assert np.abs(jacobian - MODEL.point_jacobian("LForeArm", point, position)).max() < 1e-12
    # A point moves by the turning of the link about its own origin, and with that origin.
    origin = MODEL.point_jacobian("LForeArm", np.zeros(3), position)
    turning = np.cross(pose[:3, :3] @ axes, places[0] - pose[:3, 3], axis=0)
    assert np.abs(jacobians[0] - origin - turning).max() < 1e-12
    carrying = [j for j, axis in enumerate(axes.T) if axis.any()]
    assert np.linalg.norm(axes[:, carrying], axis=0) == pytest.approx(1.0)
    assert ROBOT.joint_index("LElbowRoll") in carrying
    assert ROBOT.joint_index("LWristYaw") not in carrying


@pytest.mark.parametrize("joint", ROBOT.joint_names)
def test_a_joint_moves_the_links_beyond_it_and_no_other(joint: str) -> None:
    random = np.random.default_rng(5)
    position = random_posture(random)
    other = position.copy()
    other[ROBOT.joint_index(joint)] += 0.1
    children = {j.name: j.child for j in ROBOT.joints}
    parents = {j.child: j for j in ROBOT.joints}
    for name, link in children.items():
        above = set()
        at: str | None = link
        while at in parents:
            above.add(parents[at].name)
            at = parents[at].parent
        moved = np.abs(MODEL.link_pose(link, position) - MODEL.link_pose(link, other)).max() > 1e-6
        assert moved == (joint in above), name


def test_unknown_links_are_named() -> None:
    for call in (
        lambda: MODEL.link_pose("l_wirst", MIDDLE),
        lambda: MODEL.point_jacobian("l_wirst", np.zeros(3), MIDDLE),
        lambda: MODEL.frame_id("LWristYaw"),
    ):
        with pytest.raises(UnknownNameError):
            call()
    with pytest.raises(UnknownNameError, match="did you mean l_wrist"):
        MODEL.frame_id("l_wirst")
    for link in ROBOT.links:
        assert MODEL.link_pose(link, MIDDLE).shape == (4, 4)


def test_joints_are_mapped_by_name() -> None:
    random = np.random.default_rng(6)
    position, velocity = random_posture(random), random.normal(size=JOINTS)
    model = RobotModel(ROBOT)
    model.set_state(model.configuration(position), vectors(np.zeros(3), velocity))
    assert np.array_equal(model.joint_position, position)
    assert np.array_equal(model.joint_velocity, velocity)
    other = random_posture(random)
    changed = model.with_joint_position(model.q, other)
    assert np.array_equal(model.joint_position, position)  # a copy was changed
    assert np.array_equal(changed, model.configuration(other))


def test_integration_adds_joint_angles_and_drives_arcs() -> None:
    """A constant twist (v, 0, w) over t moves the base along a circle of radius v / w."""
    speed, turn = 0.3, 0.8
    q = MODEL.configuration(MIDDLE)
    for _ in range(100):
        q = MODEL.integrate(q, DT * vectors(np.array([speed, 0, turn]), np.full(JOINTS, 0.1)))
    t = 100 * DT
    expected = [
        speed / turn * np.sin(turn * t),
        speed / turn * (1 - np.cos(turn * t)),
        np.cos(turn * t),
        np.sin(turn * t),
    ]
    assert np.abs(q[:4] - expected).max() < 1e-12
    end = MODEL.configuration(MIDDLE + 0.1 * t)
    assert np.abs(q[4:] - end[4:]).max() < 1e-12


@pytest.mark.parametrize("link", ["l_wrist", "Head", "base_link"])
def test_frames_of_a_moving_robot_agree_with_differences(link: str) -> None:
    """Jacobian times velocity is the slope of the pose; the bias is the slope of that without acceleration."""
    model, random = RobotModel(ROBOT), np.random.default_rng(8)
    q, v = model.configuration(random_posture(random)), random.uniform(-1.0, 1.0, 20)
    frame, step = model.body_frame(link, [0.05, -0.02, 0.1]), 1e-5

    def at(time: float) -> tuple[FloatArray, FloatArray]:
        """Position of the link and the velocity the Jacobian gives it, on a path of constant velocity."""
        model.set_state(model.integrate(q, v * time), v)
        model.update_kinematics()
        return model.pose(frame).translation, model.jacobian(frame) @ v

    before, after = at(-step), at(step)
    _, velocity = at(0.0)
    bias = model.bias(frame)
    np.testing.assert_allclose(velocity[:3], (after[0] - before[0]) / (2 * step), atol=1e-7)
    np.testing.assert_allclose(bias, (after[1] - before[1]) / (2 * step), atol=1e-6)


def test_results_are_those_of_the_stored_state_in_any_order() -> None:
    """They are computed once for each state: the next state must not get those of the one before."""
    model, random = RobotModel(ROBOT), np.random.default_rng(10)
    frame = model.body_frame("r_wrist")
    for _ in range(3):
        fresh = RobotModel(ROBOT)
        q, v = model.configuration(random_posture(random)), random.uniform(-1.0, 1.0, 20)
        fresh.set_state(q, v)
        fresh.update_kinematics()
        expected = fresh.jacobian(frame), fresh.bias(frame), *fresh.com()
        model.set_state(q, v)
        momenta = [part.copy() for part in model.centroidal_momentum()]
        model.update_kinematics()
        found = model.jacobian(frame), model.bias(frame), *model.com()
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12)
        for one, other in zip(momenta, model.centroidal_momentum(), strict=True):
            np.testing.assert_array_equal(one, other)


def test_momentum_is_not_lost_to_other_algorithms_on_the_same_data() -> None:
    """Plugins call Pinocchio on ``model.data``, some of whose algorithms use its arrays for results of their own."""
    model, random = RobotModel(ROBOT), np.random.default_rng(12)
    q, v = model.configuration(random_posture(random)), random.uniform(-1.0, 1.0, 20)
    model.set_state(q, v)
    model.update_kinematics()
    before = [part.copy() for part in (*model.centroidal_momentum(), model.centre_of_mass)]
    pin.computeAllTerms(model.pin, model.data, pin.neutral(model.pin), np.ones(20))
    pin.crba(model.pin, model.data, q)
    after = (*model.centroidal_momentum(), model.centre_of_mass)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)


def test_momentum_is_that_of_pinocchios_other_algorithm() -> None:
    model, random = RobotModel(ROBOT), np.random.default_rng(11)
    q, v = model.configuration(random_posture(random)), random.uniform(-1.0, 1.0, 20)
    model.set_state(q, v)
    matrix, momentum, rate = model.centroidal_momentum()
    data = model.pin.createData()
    change = pin.dccrba(model.pin, data, q, v)
    np.testing.assert_allclose(matrix, data.Ag, atol=1e-12)
    np.testing.assert_allclose(momentum, data.Ag @ v, atol=1e-12)
    np.testing.assert_allclose(rate, change @ v, atol=1e-12)
    np.testing.assert_allclose(model.centre_of_mass, pin.centerOfMass(model.pin, data, q))


def test_questions_about_other_postures_leave_the_stored_state_alone() -> None:
    model, random = RobotModel(ROBOT), np.random.default_rng(9)
    model.set_state(model.configuration(random_posture(random)), np.zeros(20))
    model.update_kinematics()
    frame = model.body_frame("l_wrist")
    before = model.jacobian(frame)
    model.point_jacobian("r_wrist", np.zeros(3), random_posture(random))
    model.link_pose("Head", random_posture(random))
    model.gravity_torque(random_posture(random))
    np.testing.assert_array_equal(model.jacobian(frame), before)
