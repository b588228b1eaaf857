"""Per joint a motor behind a gear with play, added to the MuJoCo model of the URDF.

Each joint has a second, motor-side hinge in a tiny body of its own. A fixed tendon of length ``q - theta`` with a dead
band stands for the teeth of the gear; both sides have Coulomb friction; a DC motor turns the motor side. This is the
two-body model of Eq. 5 to 8 of the paper, with the signs of alpha in Eq. 8 the right way round: the teeth push back
with K (phi - alpha) for phi >= alpha and K (phi + alpha) for phi <= -alpha, phi = q - theta.
"""

from __future__ import annotations

import mujoco
import numpy as np

from pepper_driver.config import ConfigError, PlantConfig, RobotConfig


def motor_side(joint: str) -> str:
    """Name of the motor-side hinge of a joint."""
    return f"motor_{joint}"


def gear(joint: str) -> str:
    """Name of the tendon between motor and link."""
    return f"gear_{joint}"


def spring(number: int) -> str:
    """Name of the hinge of a flexibility."""
    return f"flexibility_{number}"


def add_drive(spec: mujoco.MjSpec, name: str, robot: RobotConfig, plant: PlantConfig) -> None:
    """Motor, gear and friction of one joint.

    Friction and tooth damping change with the state; :class:`~pepper_driver.backends.mujoco_.friction.Friction` sets
    them before each step. The motor is a torque constant with back-EMF; resistance and constant change with its
    temperature.
    """
    a = plant.actuator(name)
    motor, ratio = robot.motors.of(name), robot.motors.joints[name].ratio
    config = robot.joints[robot.joint_index(name)]

    link = spec.joint(name)
    link.actfrclimited = 0  # the URDF's effort; the board's limits are the real ones
    link.armature = robot.armature[robot.joint_index(name)]
    margin = plant.physics.stop_margin
    link.range = [config.lower - margin, config.upper + margin]
    harden_friction(link, plant)

    body = spec.worldbody.add_body(name=motor_side(name))
    body.mass, body.inertia, body.explicitinertial = 1e-6, [1e-9] * 3, True
    rotor = body.add_joint(name=motor_side(name), type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    harden_friction(rotor, plant)

    teeth = spec.add_tendon(name=gear(name), springlength=[-a.half_gap, a.half_gap])
    teeth.stiffness[0] = a.gear_stiffness
    teeth.wrap_joint(name, 1.0)
    teeth.wrap_joint(motor_side(name), -1.0)
    harden_friction(teeth, plant)

    drive = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=motor_side(name))
    constant, resistance = motor.torque_constant, motor.resistance
    drive.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    drive.gainprm[0] = constant / resistance
    drive.biasprm[2] = -(constant**2) / resistance  # Ke = Kt in SI units
    drive.gear[0] = ratio
    drive.armature = motor.rotor_inertia  # MuJoCo reflects it through the gear
    drive.damping[0] = a.motor_damping


def add_flexibility(spec: mujoco.MjSpec, number: int, plant: PlantConfig) -> None:
    """A spring hinge behind a joint, in the link that the joint carries."""
    flexibility = plant.flexibilities[number]
    joint = spec.joint(flexibility.joint)
    along = abs(np.dot(joint.axis, flexibility.axis)) / np.linalg.norm(flexibility.axis)
    if along > 0.9 and flexibility.inertia == 0.0:
        raise ConfigError(
            f"{plant.source or plant.name}: key 'flexibilities.{number}.inertia': along the axis of "
            f"{flexibility.joint} there must be an inertia between gear and spring, for example 0.01 kg m2"
        )
    joint.armature += flexibility.inertia
    link = joint.parent
    hinge = link.add_joint(
        name=spring(number),
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=np.array(flexibility.axis) / np.linalg.norm(flexibility.axis),
    )
    hinge.stiffness[0], hinge.damping[0] = flexibility.stiffness, flexibility.damping


def harden_friction(joint: mujoco.MjsJoint | mujoco.MjsTendon, plant: PlantConfig) -> None:
    """Coulomb friction that sticks. MuJoCo's default is soft: it creeps, and pushes the wrong way in hard braking."""
    joint.solref_friction = [2 * plant.physics.timestep, 1.0]
    joint.solimp_friction = [0.999, 0.9999, 0.001, 0.5, 2.0]


def check_step(mj: mujoco.MjModel, robot: RobotConfig, plant: PlantConfig) -> None:
    """Refuse a step too coarse for the stiffest gear or spring.

    A spring between two inertias is stable under implicitfast while h < 2 / sqrt(K / m_eff).

    Raises:
        ConfigError: Names the gear or spring and the largest stable step.
    """
    data = mujoco.MjData(mj)
    mujoco.mj_forward(mj, data)
    mass = np.zeros((mj.nv, mj.nv))
    mujoco.mj_fullM(mj, data, mass)
    compliance = np.linalg.inv(mass).diagonal()
    springs = []
    for name in robot.joint_names:
        link, motor = mj.joint(name).dofadr[0], mj.joint(motor_side(name)).dofadr[0]
        stiffness = plant.actuator(name).gear_stiffness
        what = f"the gear of {name} (gear_stiffness {stiffness:g} N m/rad)"
        springs.append((stiffness * float(compliance[link] + compliance[motor]), what))
    for number, flexibility in enumerate(plant.flexibilities):
        dof, stiffness = mj.joint(spring(number)).dofadr[0], flexibility.stiffness
        what = f"flexibilities.{number} of {flexibility.joint} (stiffness {stiffness:g} N m/rad)"
        springs.append((stiffness * float(compliance[dof]), what))
    square, worst = max(springs)  # of the fastest oscillation [1/s2]
    step, limit = plant.physics.timestep, 2.0 / np.sqrt(square)
    if step >= limit:
        whole = robot.cycle / np.ceil(robot.cycle / limit + 1e-9)
        raise ConfigError(
            f"{plant.source or plant.name}: key 'physics.timestep': {step:g} s is too coarse for {worst}: "
            f"at most {whole:.10g} s"
        )
