"""The compiled model: everything found by name, MuJoCo's traps avoided."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pepper_driver.backends.mujoco_.plant_model import build_model
from pepper_driver.config import PlantConfig, load_plant
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plant_parts import BodyParameters, Payload
from support.pinocchio_robot import PinocchioRobot
from support.plant import INDEX, ONE, ROBOT, STAND, hold, plain, standing


def test_the_dense_jacobian_is_used() -> None:
    """Trap: the sparse Newton solver of MuJoCo 4.0.0 has a wrong factor."""
    for base in ("fixed", "rolling"):
        model = build_model(ROBOT, replace(load_plant("nominal", ROBOT), base=base))
        assert model.mj.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE
        assert not mujoco.mj_isSparse(model.mj)


def test_joints_are_found_by_name() -> None:
    """Trap: the URDF, MuJoCo and the project each have an order of their own."""
    order = np.random.default_rng(0).permutation(len(ROBOT.joints))
    shuffled = replace(ROBOT, joints=tuple(ROBOT.joints[i] for i in order))
    model = build_model(shuffled, plain())
    assert shuffled.joint_names != ROBOT.joint_names
    for index, name in enumerate(shuffled.joint_names):
        link, motor = model.mj.joint(name), model.mj.joint(f"motor_{name}")
        assert (model.link_qpos[index], model.link_dof[index]) == (link.qposadr[0], link.dofadr[0])
        assert (model.motor_qpos[index], model.motor_dof[index]) == (
            motor.qposadr[0],
            motor.dofadr[0],
        )
        assert model.mj.actuator(model.actuator[index]).trnid[0] == motor.id
        wraps = model.mj.tendon_adr[model.tendon[index]] + np.arange(2)
        assert model.mj.wrap_objid[wraps].tolist() == [link.id, motor.id]


def test_the_order_of_the_joints_does_not_change_the_motion() -> None:
    order = np.random.default_rng(0).permutation(len(ROBOT.joints))
    shuffled = replace(ROBOT, joints=tuple(ROBOT.joints[i] for i in order))
    first = standing(plain())
    second = type(first)(shuffled, plain())
    second.reset(STAND[order])
    for tick in range(40):
        target = STAND + 0.1 * np.sin(tick * ROBOT.cycle * 3.0)
        first.cycle(target, ONE, np.zeros(3), np.ones(3))
        second.cycle(target[order], ONE, np.zeros(3), np.ones(3))
    assert np.abs(first.position - STAND).max() > 0.05
    np.testing.assert_allclose(second.position, first.position[order], atol=1e-6)
    np.testing.assert_allclose(second.current, first.current[order], atol=1e-3)


def test_the_efforts_of_the_urdf_bound_nothing() -> None:
    """Trap: MuJoCo turns them into limits on the force of actuators; the board's limits are the real ones."""
    model = build_model(ROBOT, replace(plain(), base="rolling")).mj
    assert not model.jnt_actfrclimited.any()


def test_a_diverging_simulation_stays_diverged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trap: MuJoCo starts again from the first posture by itself, as if nothing had happened."""
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a note of its own there
    simulation = standing(plain())
    hold(simulation, 5)
    assert not simulation.model.diverged(simulation.data)
    simulation.data.qvel[simulation.model.link_dof[INDEX]] = 1e12
    hold(simulation, 5)
    assert simulation.model.diverged(simulation.data)
    assert simulation.data.time == pytest.approx(10 * ROBOT.cycle)
    simulation.reset(STAND)
    assert not simulation.model.diverged(simulation.data)


@pytest.mark.parametrize("link", ["l_wrist", "r_wrist", "torso", "Head"])
def test_a_payload_weighs_on_the_joints_at_its_place(link: str) -> None:
    """MuJoCo's gravity torques, against Pinocchio with the same ball on the same link."""
    mass, radius, xyz = 0.5, 0.035, (0.08, -0.02, -0.03)
    ball = Payload(link=link, mass=mass, radius=radius, xyz=xyz)
    laden = replace(plain(), body=BodyParameters(masses={}, coms={}, payloads=(ball,)))
    bare, more = PinocchioRobot(), PinocchioRobot()
    more.add(link, pin.Inertia(mass, np.array(xyz), 0.4 * mass * radius**2 * np.eye(3)))
    postures = np.random.default_rng(0).uniform(-1.0, 1.0, (5, len(ROBOT.joints)))
    expected = [more.gravity_torque(q) - bare.gravity_torque(q) for q in postures]
    assert np.abs(expected).max() > 0.3
    np.testing.assert_allclose(
        _weights(laden, postures) - _weights(plain(), postures), expected, atol=1e-6
    )


def _weights(plant: PlantConfig, postures: FloatArray) -> FloatArray:
    """(n, 17) torques that hold the links against gravity [N m]."""
    model = build_model(ROBOT, plant)
    data = mujoco.MjData(model.mj)
    rows = []
    for posture in postures:
        data.qpos[model.link_qpos] = posture
        mujoco.mj_forward(model.mj, data)
        rows.append(data.qfrc_bias[model.link_dof].copy())
    return np.array(rows)


def test_a_payload_has_the_inertia_of_a_ball_about_its_own_middle() -> None:
    """About the axis of the wrist, one more of m d^2 + 2/5 m r^2."""
    mass, radius, xyz = 0.5, 0.04, (0.08, 0.05, -0.03)
    ball = Payload(link="l_wrist", mass=mass, radius=radius, xyz=xyz)
    laden = replace(plain(), body=BodyParameters(masses={}, coms={}, payloads=(ball,)))
    index = ROBOT.joint_index("LWristYaw")
    axis = np.array(ROBOT.joints[index].axis)
    distance = np.linalg.norm(np.cross(axis, xyz))
    bare, more = (_inertia(plant, index) for plant in (plain(), laden))
    assert more - bare == pytest.approx(mass * distance**2 + 0.4 * mass * radius**2, rel=1e-6)


def _inertia(plant: PlantConfig, joint: int) -> float:
    """Inertia of the link side of a joint, all others held [kg m2]."""
    model = build_model(ROBOT, plant)
    data = mujoco.MjData(model.mj)
    mujoco.mj_forward(model.mj, data)
    full = np.zeros((model.mj.nv, model.mj.nv))
    mujoco.mj_fullM(model.mj, data, full)
    dof = model.link_dof[joint]
    return float(full[dof, dof])
