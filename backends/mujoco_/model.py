"""The MuJoCo model of the plant: URDF, drives, base, and where things are in it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.drives import (
    add_drive,
    add_flexibility,
    check_step,
    gear,
    motor_side,
)
from pepper_driver.backends.mujoco_.objects import add_objects
from pepper_driver.backends.mujoco_.rolling import add_rolling_base, add_wheel_drives
from pepper_driver.config import ConfigError, PlantConfig, RobotConfig, World
from pepper_driver.config.arrays import BoolArray, FloatArray, IndexArray
from pepper_driver.config.plant_parts import Body

ROBOT, OBJECT, FLOOR = 1, 2, 4
"""Collision bits: the robot meets objects, objects meet everything, the floor meets wheels and objects."""

# MuJoCo would print, and write MUJOCO_LOG.TXT into the user's folder; what matters is told by errors of our own.
# MuJoCo has one such handler for the whole process.
mujoco.set_mju_user_warning(lambda message: None)

_DIVERGENCE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


@dataclass(frozen=True, kw_only=True)
class PlantModel:
    """The compiled model and where things are in it. Index and parameter arrays are (17,), in joint order.

    Attributes:
        mj: The compiled MuJoCo model.
        link_qpos, motor_qpos: Addresses in ``qpos``.
        link_dof, motor_dof: Addresses in ``qvel``.
        tendon: Tendon of each gear.
        actuator: Motor of each joint.
        half_gap: Half the play of each gear [rad].
        bodies: Body number by link name.
    """

    mj: mujoco.MjModel
    link_qpos: IndexArray
    motor_qpos: IndexArray
    link_dof: IndexArray
    motor_dof: IndexArray
    tendon: IndexArray
    actuator: IndexArray
    half_gap: FloatArray
    bodies: dict[str, int]

    def diverged(self, data: mujoco.MjData) -> bool:
        """Whether the simulation has met values that are not finite, or huge."""
        return any(data.warning[kind].number for kind in _DIVERGENCE)

    def in_gap(self, data: mujoco.MjData) -> BoolArray:
        """(17,) whether the teeth of each gear are apart: |q - theta| <= half_gap."""
        phi = data.qpos[self.link_qpos] - data.qpos[self.motor_qpos]
        return np.asarray(np.abs(phi) <= self.half_gap, dtype=np.bool_)


def build_model(robot: RobotConfig, plant: PlantConfig, world: World | None = None) -> PlantModel:
    """Compile the plant from the robot's URDF and the plant's parameters, with the objects of a world around it.

    Raises:
        ConfigError: MuJoCo refuses the URDF, or the step is too coarse for the stiffest gear.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(robot.urdf))
    except ValueError as error:
        raise _refused(robot, error) from error
    _set_options(spec, plant)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = ROBOT, OBJECT
    _change_body(spec, plant.body)
    for name in robot.joint_names:
        add_drive(spec, name, robot, plant)
    for number in range(len(plant.flexibilities)):
        add_flexibility(spec, number, plant)
    add_wheel_drives(spec, robot, plant)
    if plant.base == "rolling":
        add_rolling_base(spec, robot, plant, floor_bit=FLOOR)
    if world is not None:
        add_objects(spec, world, plant, object_bit=OBJECT, robot_bit=ROBOT, floor_bit=FLOOR)
    try:
        mj = spec.compile()
    except ValueError as error:
        raise _refused(robot, error) from error
    # A simulation that blows up shall be told, not start anew from its first posture by itself.
    mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # Islands would only be found to be one: the robot, and motors that no constraint ties to it.
    mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    check_step(mj, robot, plant)
    names = robot.joint_names
    links = [mj.joint(name).id for name in names]
    motors = [mj.joint(motor_side(name)).id for name in names]
    return PlantModel(
        mj=mj,
        link_qpos=np.array(mj.jnt_qposadr[links], dtype=np.intp),
        motor_qpos=np.array(mj.jnt_qposadr[motors], dtype=np.intp),
        link_dof=np.array(mj.jnt_dofadr[links], dtype=np.intp),
        motor_dof=np.array(mj.jnt_dofadr[motors], dtype=np.intp),
        tendon=np.array([mj.tendon(gear(name)).id for name in names], dtype=np.intp),
        actuator=np.array([mj.actuator(name).id for name in names], dtype=np.intp),
        half_gap=plant.per_joint("half_gap", robot),
        bodies={link: mj.body(link).id for link in robot.links},
    )


def _refused(robot: RobotConfig, error: ValueError) -> ConfigError:
    reason = " ".join(str(error).replace("Error:", "").split())
    return ConfigError(f"{robot.urdf}: MuJoCo cannot build the robot: {reason}")


def _set_options(spec: mujoco.MjSpec, plant: PlantConfig) -> None:
    spec.compiler.fusestatic = False  # keep every link by name
    spec.compiler.boundmass = 0
    spec.compiler.boundinertia = 0
    spec.visual.headlight.ambient = [0.4, 0.4, 0.4]  # a URDF brings no light
    spec.visual.headlight.diffuse = [0.6, 0.6, 0.6]
    spec.option.timestep = plant.physics.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.iterations = 30
    spec.option.tolerance = 1e-9
    # The sparse Newton factor of MuJoCo 4.0.0 is wrong in some models (mended in 4.0.1).
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE


def _change_body(spec: mujoco.MjSpec, body: Body) -> None:
    """Masses, centres of mass and payloads that differ from the URDF."""
    for name, factor in body.masses.items():
        link = spec.body(name)
        link.mass *= factor
        link.inertia = np.array(link.inertia) * factor
        link.fullinertia = np.array(link.fullinertia) * factor
    for name, shift in body.coms.items():
        link = spec.body(name)
        link.ipos = np.array(link.ipos) + shift
    for payload in body.payloads:
        ball = spec.body(payload.link).add_body(pos=payload.xyz)
        ball.mass, ball.explicitinertial = payload.mass, True
        ball.ipos = [0.0, 0.0, 0.0]  # otherwise the offset counts twice
        ball.inertia = [0.4 * payload.mass * payload.radius**2] * 3
