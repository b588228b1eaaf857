"""The MuJoCo model of the plant: the URDF, and per joint a motor behind a gear with play.

Each joint has a second, motor-side hinge in a tiny body of its own. A fixed tendon of length ``q - theta`` with a dead
band stands for the teeth of the gear; both sides have Coulomb friction; a DC motor turns the motor side. This is the
two-body model of Eq. 5 to 8 of the paper, with the signs of alpha in Eq. 8 the right way round: the teeth push back
with K (phi - alpha) for phi >= alpha and K (phi + alpha) for phi <= -alpha, phi = q - theta.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.parts import FloatArray

IndexArray = NDArray[np.intp]

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
        gear_damping: Damping of teeth in contact [N m s/rad].
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
    gear_damping: FloatArray
    bodies: dict[str, int]

    def step(self, data: mujoco.MjData) -> None:
        """One step of physics, with the wrenches and voltages set in ``data``.

        The teeth damp only while they touch: MuJoCo's own tendon damping would drag inside the gap too.
        """
        self.mj.tendon_damping[self.tendon] = np.where(self.in_gap(data), 0.0, self.gear_damping)
        mujoco.mj_step(self.mj, data)

    def diverged(self, data: mujoco.MjData) -> bool:
        """Whether the simulation has met values that are not finite, or huge."""
        return any(data.warning[kind].number for kind in _DIVERGENCE)

    def in_gap(self, data: mujoco.MjData) -> NDArray[np.bool_]:
        """(17,) whether the teeth of each gear are apart: |q - theta| <= half_gap."""
        phi = data.qpos[self.link_qpos] - data.qpos[self.motor_qpos]
        return np.asarray(np.abs(phi) <= self.half_gap, dtype=np.bool_)


def build_model(robot: RobotConfig, plant: PlantConfig) -> PlantModel:
    """Compile the plant from the robot's URDF and the plant's parameters."""
    spec = mujoco.MjSpec.from_file(str(robot.urdf))
    _set_options(spec, plant)
    for name in robot.wheels.names:  # the base is fixed: the wheels' speed is simulated apart
        spec.delete(spec.joint(name))
    for actuator in plant.actuators:
        for name in actuator.joints:
            _add_drive(spec, name, robot, plant)
    mj = spec.compile()
    # Self-collision and the floor come with the base that moves; until then nothing may touch but pushes.
    mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    # A simulation that blows up shall be told, not start anew from its first posture by itself.
    mj.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    names = robot.joint_names
    links = [mj.joint(name).id for name in names]
    motors = [mj.joint(_motor_side(name)).id for name in names]
    return PlantModel(
        mj=mj,
        link_qpos=np.array(mj.jnt_qposadr[links], dtype=np.intp),
        motor_qpos=np.array(mj.jnt_qposadr[motors], dtype=np.intp),
        link_dof=np.array(mj.jnt_dofadr[links], dtype=np.intp),
        motor_dof=np.array(mj.jnt_dofadr[motors], dtype=np.intp),
        tendon=np.array([mj.tendon(_gear(name)).id for name in names], dtype=np.intp),
        actuator=np.array([mj.actuator(name).id for name in names], dtype=np.intp),
        half_gap=plant.per_joint("half_gap", robot),
        gear_damping=plant.per_joint("gear_damping", robot),
        bodies={link: mj.body(link).id for link in robot.links},
    )


def _motor_side(joint: str) -> str:
    return f"motor_{joint}"


def _gear(joint: str) -> str:
    return f"gear_{joint}"


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


def _add_drive(spec: mujoco.MjSpec, name: str, robot: RobotConfig, plant: PlantConfig) -> None:
    """Motor, gear and friction of one joint."""
    a = next(entry for entry in plant.actuators if name in entry.joints)
    motor, ratio = robot.motors.of(name), robot.motors.joints[name].ratio
    joint_config = robot.joints[robot.joint_index(name)]

    link = spec.joint(name)
    link.actfrclimited = 0  # the URDF's effort; the board's limits are the real ones
    link.damping[0] = a.link_damping
    link.armature = robot.armature[robot.joint_index(name)]
    margin = plant.physics.stop_margin
    link.range = [joint_config.lower - margin, joint_config.upper + margin]
    _set_friction(link, a.link_friction, plant)

    body = spec.worldbody.add_body(name=_motor_side(name))
    body.mass, body.inertia, body.explicitinertial = 1e-6, [1e-9] * 3, True
    rotor = body.add_joint(name=_motor_side(name), type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    _set_friction(rotor, a.motor_friction, plant)

    gear = spec.add_tendon(name=_gear(name), springlength=[-a.half_gap, a.half_gap])
    gear.stiffness[0] = a.gear_stiffness
    gear.damping[0] = a.gear_damping
    gear.wrap_joint(name, 1.0)
    gear.wrap_joint(_motor_side(name), -1.0)

    drive = spec.add_actuator(
        name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=_motor_side(name)
    )
    constant = motor.torque_constant  # Ke = Kt in SI units
    drive.set_to_dcmotor(motorconst=[constant, constant], resistance=motor.resistance)
    drive.gear[0] = ratio
    drive.armature = motor.rotor_inertia  # MuJoCo reflects it through the gear
    drive.damping[0] = a.motor_damping
    drive.ctrlrange = [-plant.board.voltage, plant.board.voltage]
    drive.ctrllimited = 1


def _set_friction(joint: mujoco.MjsJoint, torque: float, plant: PlantConfig) -> None:
    """Coulomb friction that sticks. MuJoCo's default is soft: it creeps, and pushes the wrong way in hard braking."""
    joint.frictionloss = torque
    joint.solref_friction = [2 * plant.physics.timestep, 1.0]
    joint.solimp_friction = [0.999, 0.9999, 0.001, 0.5, 2.0]
