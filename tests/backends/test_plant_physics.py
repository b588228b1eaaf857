"""The plant against textbook physics and an independent integration of the paper's Eq. 5 to 8."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pepper_driver.backends.mujoco_.model import PlantModel, build_model
from pepper_driver.config import PlantConfig, RobotConfig, load_plant, load_robot

Array = NDArray[np.float64]

JOINT = "HeadYaw"  # turns about the vertical: gravity does not enter


@pytest.fixture(scope="module")
def robot() -> RobotConfig:
    return load_robot()


def weightless(robot: RobotConfig, plant: PlantConfig) -> tuple[PlantModel, mujoco.MjData]:
    model = build_model(robot, plant)
    model.mj.opt.gravity[:] = 0.0
    return model, mujoco.MjData(model.mj)


def plant_of(robot: RobotConfig, **changes: Any) -> PlantConfig:
    """The nominal plant with other drive parameters on all joints."""
    plant = load_plant("nominal", robot)
    return replace(plant, actuators=tuple(replace(a, **changes) for a in plant.actuators))


def swing(times: Array) -> Array:
    """A voltage with reversals that throw the joint through its gap."""
    return np.asarray(2.5 * np.sin(2 * np.pi * 0.9 * times) + 2.0 * np.sin(2 * np.pi * 2.3 * times))


def simulate(
    model: PlantModel, data: mujoco.MjData, index: int, seconds: float
) -> tuple[Array, Array]:
    """(n, 2) link and motor angle, (n,) in gap, under the voltage ``swing`` held for each step."""
    steps = round(seconds / model.mj.opt.timestep)
    angles, gap = np.zeros((steps, 2)), np.zeros(steps)
    for n in range(steps):
        data.ctrl[model.actuator[index]] = swing(np.array(n * model.mj.opt.timestep))
        model.step(data)
        angles[n] = data.qpos[model.link_qpos[index]], data.qpos[model.motor_qpos[index]]
        gap[n] = model.in_gap(data)[index]
    return angles, gap


def reference(
    robot: RobotConfig, plant: PlantConfig, inertia: float, seconds: float, h: float
) -> Array:
    """(n, 2) the two-body equations by Runge-Kutta: link and motor angle at the end of each step of ``h``."""
    a = next(entry for entry in plant.actuators if JOINT in entry.joints)
    motor, ratio = robot.motors.of(JOINT), robot.motors.joints[JOINT].ratio
    kt, r = motor.torque_constant * ratio, motor.resistance
    reflected = ratio**2 * motor.rotor_inertia + 1e-9

    def rates(time: float, y: Array, voltage: float) -> list[float]:
        q, theta, dq, dtheta = y
        phi, dphi = q - theta, dq - dtheta
        tooth = 0.0
        if abs(phi) > a.half_gap:
            tooth = -a.gear_stiffness * (phi - np.sign(phi) * a.half_gap) - a.gear_damping * dphi
        drive = kt * (voltage - kt * dtheta) / r - ratio**2 * a.motor_damping * dtheta
        return [
            dq,
            dtheta,
            (tooth - a.link_damping * dq - a.link_friction * np.tanh(dq / 1e-3)) / inertia,
            (drive - tooth - a.motor_friction * np.tanh(dtheta / 1e-3)) / reflected,
        ]

    y, out = np.zeros(4), []
    for n in range(round(seconds / h)):
        voltage = float(swing(np.array(n * h)))
        solution = solve_ivp(
            rates, (0, h), y, args=(voltage,), method="LSODA", rtol=1e-6, atol=1e-9, max_step=h / 4
        )
        y = solution.y[:, -1]
        out.append(y[:2])
    return np.array(out)


def link_inertia(model: PlantModel, data: mujoco.MjData, index: int) -> float:
    mujoco.mj_forward(model.mj, data)
    full = np.zeros((model.mj.nv, model.mj.nv))
    mujoco.mj_fullM(model.mj, data, full)
    dof = model.link_dof[index]
    return float(full[dof, dof])


def test_agrees_with_an_independent_integration(robot: RobotConfig) -> None:
    """Trap: damping that is not switched off in the gap drags there; the trajectory shows it."""
    plant = plant_of(robot, half_gap=0.01)
    model, data = weightless(robot, plant)
    index = robot.joint_index(JOINT)
    # Hold the head's other joint and all else rigid enough not to matter: only HeadYaw is driven.
    truth = reference(robot, plant, link_inertia(model, data, index), 1.5, model.mj.opt.timestep)
    angles, gap = simulate(model, data, index, 1.5)
    assert gap.mean() > 0.1, "the run must pass through the gap to mean anything"
    error = np.sqrt(np.mean((angles - truth) ** 2))
    assert error < 5e-4

    model.gear_damping[index], ungated = 0.0, model.gear_damping[index]
    fresh = mujoco.MjData(model.mj)
    model.mj.opt.gravity[:] = 0.0
    wrong = np.zeros_like(angles)
    for n in range(len(angles)):
        fresh.ctrl[model.actuator[index]] = swing(np.array(n * model.mj.opt.timestep))
        model.mj.tendon_damping[model.tendon[index]] = ungated
        mujoco.mj_step(model.mj, fresh)
        wrong[n] = fresh.qpos[model.link_qpos[index]], fresh.qpos[model.motor_qpos[index]]
    assert np.sqrt(np.mean((wrong - truth) ** 2)) > 3 * error, "ungated damping must be told apart"


def test_teeth_push_back_from_the_edge_of_the_gap(robot: RobotConfig) -> None:
    """Trap: Eq. 8 as printed, K (phi + alpha) for phi >= alpha, would jump by 2 alpha K at the edge."""
    plant = plant_of(robot, half_gap=0.01, gear_damping=0.0, link_damping=0.0)
    model, data = weightless(robot, plant)
    index = robot.joint_index(JOINT)
    stiffness = model.mj.tendon_stiffness[model.tendon[index]]
    for phi in (-0.013, -0.0101, -0.0099, 0.0, 0.0099, 0.0101, 0.013):
        mujoco.mj_resetData(model.mj, data)
        data.qpos[model.link_qpos[index]] = phi
        mujoco.mj_forward(model.mj, data)
        expected = -float(stiffness) * np.sign(phi) * max(abs(phi) - 0.01, 0.0)
        assert data.qfrc_passive[model.link_dof[index]] == pytest.approx(expected, abs=1e-9)
        assert data.qfrc_passive[model.motor_dof[index]] == pytest.approx(-expected, abs=1e-9)


def test_friction_holds_without_creeping(robot: RobotConfig) -> None:
    """Trap: MuJoCo's default friction creeps 15 to 24 mrad/s under a load it should hold."""
    model, data = weightless(robot, plant_of(robot, link_friction=0.5, half_gap=0.1))
    index = robot.joint_index(JOINT)
    data.qfrc_applied[model.link_dof[index]] = 0.45
    for _ in range(1000):
        model.step(data)
    assert abs(data.qpos[model.link_qpos[index]]) < 1e-4


def test_friction_opposes_motion_even_in_hard_braking(robot: RobotConfig) -> None:
    """Trap: soft friction pushes the wrong way while a joint is braked hard."""
    model, data = weightless(
        robot, plant_of(robot, link_friction=0.4, link_damping=0.0, half_gap=0.3)
    )
    index = robot.joint_index(JOINT)
    dof = model.link_dof[index]
    for torque in (0.0, -1.0, -2.0, -4.0):  # none strong enough to reverse the joint in one step
        mujoco.mj_resetData(model.mj, data)
        data.qvel[dof] = 1.0
        data.qfrc_applied[dof] = torque
        mujoco.mj_forward(model.mj, data)
        assert data.qfrc_constraint[dof] == pytest.approx(-0.4, abs=0.02)


def test_the_dense_jacobian_is_used(robot: RobotConfig) -> None:
    """Trap: the sparse Newton solver of MuJoCo 4.0.0 has a wrong factor."""
    model = build_model(robot, load_plant("nominal", robot))
    assert model.mj.opt.jacobian == mujoco.mjtJacobian.mjJAC_DENSE


def test_motor_reaches_its_no_load_speed_and_stall_torque(robot: RobotConfig) -> None:
    plant = plant_of(
        robot,
        motor_friction=0.0,
        motor_damping=0.0,
        link_friction=0.0,
        link_damping=0.0,
        half_gap=1.0,
    )
    model, data = weightless(robot, plant)
    index = robot.joint_index(JOINT)
    motor, ratio = robot.motors.of(JOINT), robot.motors.joints[JOINT].ratio
    rated = motor.torque_constant * motor.no_load_speed  # [V] the documented speed belongs to
    data.ctrl[model.actuator[index]] = rated
    mujoco.mj_forward(model.mj, data)
    # At rest: the stall torque through the gear.
    assert data.qfrc_actuator[model.motor_dof[index]] == pytest.approx(
        motor.stall_torque * ratio, rel=2e-3
    )
    model.mj.tendon_stiffness[model.tendon[index]] = 0.0  # let the shaft turn without the head
    for _ in range(400):
        data.ctrl[model.actuator[index]] = rated
        model.step(data)
    assert data.qvel[model.motor_dof[index]] == pytest.approx(motor.no_load_speed / ratio, rel=1e-3)


def test_hands_carry_the_fingers_inertia(robot: RobotConfig) -> None:
    model, data = weightless(robot, load_plant("nominal", robot))
    assert link_inertia(model, data, robot.joint_index("LHand")) == pytest.approx(
        robot.hands.finger_inertia, rel=1e-4
    )
    # and the wrist keeps the inertia that is documented for it
    assert link_inertia(model, data, robot.joint_index("LWristYaw")) == pytest.approx(
        0.000151643, rel=1e-2
    )
