"""Test plants: the shipped one without what a test does not look at, and a bench for single drives."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.motors import JointFriction
from pepper_driver.backends.mujoco_.plant_model import build_model
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import PlantConfig, load_plant, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plant_parts import (
    Battery,
    BodyParameters,
    FrictionParameters,
    GapFriction,
    TouchingFriction,
    Transport,
)

ROBOT = load_robot()
N = len(ROBOT.joint_names)
ZERO, ONE = np.zeros(N), np.ones(N)
STAND = ROBOT.posture("Stand")

STUCK = 1e4
"""[N m] of friction that nothing here overcomes."""

JOINT = "HeadYaw"  # turns about the vertical: gravity does not enter
INDEX = ROBOT.joint_index(JOINT)


def friction(
    motor: float = 0.0,
    link: float = 0.0,
    *,
    viscous: tuple[float, float] = (0.0, 0.0),
    gap: GapFriction | None = None,
    **rest: float,
) -> FrictionParameters:
    """Coulomb friction [N m] and ``viscous`` [N m s/rad] of the motor's side and the link's, in and out of the gap."""
    sides = {
        "motor": motor,
        "link": link,
        "motor_viscous": viscous[0],
        "link_viscous": viscous[1],
    }
    shape = {
        "breakaway": 1.0,
        "stribeck_velocity": 0.02,
        "load": 0.0,
        "ripple": 0.0,
        "ripple_count": 0.0,
    }
    return FrictionParameters(
        contact=TouchingFriction(**sides),
        gap=gap or GapFriction(**sides, relative=0.0, relative_viscous=0.0),
        **{**shape, **rest},
    )


def plain(**changes: Any) -> PlantConfig:
    """The shipped plant in steps of 1 ms, a bare PD law with bare friction, no delay, noise or drift.

    ``changes`` are made on every drive.
    """
    plant = load_plant("nominal", ROBOT)
    drives = []
    for drive in plant.actuators:
        contact = drive.friction.contact
        smooth = friction(
            contact.motor, contact.link, viscous=(contact.motor_viscous, contact.link_viscous)
        )
        drives.append(
            replace(drive, **{"ki": 0.0, "dead_band": 0.0, "friction": smooth, **changes})
        )
    return replace(
        plant,
        base="fixed",
        physics=replace(plant.physics, timestep=0.001),
        board=replace(plant.board, integral_band=0.0),
        targets=replace(plant.targets, speed_limit=None),
        transport=Transport(
            command_delay=0,
            sensor_delay=0,
            late=0.0,
            longest_late=0,
            lost=0.0,
            encoder_noise=0.0,
            current_noise=0.0,
            current_time=plant.transport.current_time,
        ),
        battery=Battery(
            charge=1.0,
            full_voltage=plant.board.voltage,
            empty_voltage=plant.board.voltage / 2,
            resistance=0.0,
            energy=1e12,
            idle_power=0.0,
        ),
        heat=replace(plant.heat, start=plant.heat.reference, copper=0.0, magnet=0.0, grease=0.0),
        flexibilities=(),
        body=BodyParameters(masses={}, coms={}, payloads=()),
        actuators=tuple(drives),
    )


def stepping(plant: PlantConfig, timestep: float) -> PlantConfig:
    """``plant`` with another step of physics [s]."""
    return replace(plant, physics=replace(plant.physics, timestep=timestep))


def with_drive(plant: PlantConfig, joints: Iterable[str], **changes: Any) -> PlantConfig:
    """``plant`` with other drives on some joints."""
    chosen = set(joints)
    drives = []
    for drive in plant.actuators:
        others = tuple(name for name in drive.joints if name not in chosen)
        those = tuple(name for name in drive.joints if name in chosen)
        if others:
            drives.append(replace(drive, joints=others))
        if those:
            drives.append(replace(drive, joints=those, **changes))
    return replace(plant, actuators=tuple(drives))


class Bench:
    """One joint of a plant without boards and gravity, the others stuck: set its voltage, and torques on its sides."""

    def __init__(self, plant: PlantConfig, joint: str = JOINT, *, warmth: float = 1.0) -> None:
        others = [name for name in ROBOT.joint_names if name != joint]
        plant = with_drive(plant, others, friction=friction(STUCK, STUCK))
        self.model = build_model(ROBOT, plant)
        self.model.mj.opt.gravity[:] = 0.0
        self.data = mujoco.MjData(self.model.mj)
        self.step_time = plant.physics.timestep
        self.friction = JointFriction(ROBOT, plant, self.model, self.data)
        self.friction.warm(np.full(N, warmth))
        index = ROBOT.joint_index(joint)
        self.link, self.motor = self.model.link_dof[index], self.model.motor_dof[index]
        self._link_qpos, self._motor_qpos = (
            self.model.link_qpos[index],
            self.model.motor_qpos[index],
        )
        self.actuator, self.tendon = self.model.actuator[index], self.model.tendon[index]

    def place(self, link: float, motor: float, speed: tuple[float, float] = (0.0, 0.0)) -> None:
        """Set angles [rad] and (link, motor) speeds [rad/s] of the joint; everything else at rest."""
        mujoco.mj_resetData(self.model.mj, self.data)
        self.data.qpos[self._link_qpos], self.data.qpos[self._motor_qpos] = link, motor
        self.data.qvel[self.link], self.data.qvel[self.motor] = speed

    def step(self, count: int = 1) -> None:
        for _ in range(count):
            self.friction.update()
            mujoco.mj_step(self.model.mj, self.data)

    @property
    def angles(self) -> FloatArray:
        """(2,) of link and motor [rad]."""
        return np.array(self.data.qpos[[self._link_qpos, self._motor_qpos]])

    @property
    def speeds(self) -> FloatArray:
        """(2,) of link and motor [rad/s]."""
        return np.array(self.data.qvel[[self.link, self.motor]])

    def inertia(self, dof: int) -> float:
        """Inertia of one degree of freedom, all others held [kg m2]."""
        mujoco.mj_forward(self.model.mj, self.data)
        full = np.zeros((self.model.mj.nv, self.model.mj.nv))
        mujoco.mj_fullM(self.model.mj, self.data, full)
        return float(full[dof, dof])


def standing(plant: PlantConfig, posture: FloatArray = STAND, *, settle: int = 0) -> Simulation:
    """A simulation in ``posture``, after ``settle`` cycles of holding it."""
    simulation = Simulation(ROBOT, plant)
    simulation.reset(posture)
    hold(simulation, settle, posture)
    return simulation


def hold(
    simulation: Simulation,
    cycles: int,
    posture: FloatArray = STAND,
    *,
    wheels: FloatArray | None = None,
    powered: bool = True,
) -> None:
    """Some cycles of full stiffness."""
    speed = np.zeros(3) if wheels is None else wheels
    for _ in range(cycles):
        simulation.cycle(posture, ONE, speed, np.full(3, float(powered)))


def push(simulation: Simulation, link: str, force: FloatArray, point: FloatArray) -> None:
    """Let a constant force (3,) [N] act at a point (3,) of a link, both in world axes, from now on."""
    data = simulation.data
    data.qfrc_applied[:] = 0.0
    body = simulation.model.bodies[link]
    mujoco.mj_applyFT(simulation.model.mj, data, force, np.zeros(3), point, body, data.qfrc_applied)


def rolling(**wheels: float) -> PlantConfig:
    """The plain plant on its wheels, with other values of their drives or of the floor."""
    plant = plain()
    return replace(plant, base="rolling", wheels=replace(plant.wheels, **wheels))


BASE = slice(0, 6)
"""Base in ``qpos`` of a rolling plant: x, y, z [m], yaw, pitch, roll [rad]."""


def twist(simulation: Simulation) -> FloatArray:
    """(3,) forward, left [m/s] and turning speed [rad/s] of the base, in its own axes."""
    yaw = simulation.data.qpos[3]
    x, y, _, turn = simulation.data.qvel[:4]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([cos * x + sin * y, cos * y - sin * x, turn])


def balance(simulation: Simulation) -> tuple[float, FloatArray]:
    """Weight of the whole robot [N] and its centre of mass (3,) [m]."""
    mj, data = simulation.model.mj, simulation.data
    mujoco.mj_forward(mj, data)
    base = simulation.model.bodies["base_link"]
    return float(mj.body_subtreemass[base] * 9.81), np.array(data.subtree_com[base])


def wheel_loads(weight: float, com: FloatArray, force: FloatArray, height: float) -> FloatArray:
    """(3,) what the floor carries at each wheel [N], the robot at the origin under a horizontal force at a height."""
    at = np.array(ROBOT.wheels.positions)[:, :2]
    moment = weight * com[:2] + force[:2] * height
    solved: FloatArray = np.linalg.solve(np.vstack([np.ones(3), at.T]), np.array([weight, *moment]))
    return solved
