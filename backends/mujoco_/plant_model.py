"""MuJoCo's model of the robot: bodies, joints and drives from the URDF and the plant.

Each joint has a second, motor-side hinge in a tiny body of its own. A fixed tendon of length ``q - theta`` with a dead
band stands for the teeth of the gear; both sides have Coulomb friction; a DC motor turns the motor side. This is the
two-body model of Eq. 5 to 8 of the paper, with the signs of alpha in Eq. 8 corrected: the teeth push back
with K (phi - alpha) for phi >= alpha and K (phi + alpha) for phi <= -alpha, phi = q - theta.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.objects import add_objects
from pepper_driver.config import ConfigError, PlantConfig, RobotConfig, World
from pepper_driver.config.arrays import BoolArray, FloatArray, IndexArray
from pepper_driver.config.plant_parts import BodyParameters

FALLEN = 1.2
"""[rad] of tilt at which the base comes to lie: the robot has fallen over."""


_ROLLED = ("base_x", "base_y", "base_yaw")


def grip(wheel: str) -> str:
    """Name of the tendon between a wheel and the floor."""
    return f"grip_{wheel}"


class ArrayView:
    """Entries of ``array`` at ``indices``, as a view where they lie side by side: that costs nothing.

    A passive hinge between two joints parts them; then they are gathered and scattered.
    """

    def __init__(self, array: FloatArray, indices: IndexArray) -> None:
        self._array, self._indices = array, indices
        first, n = int(indices[0]), len(indices)
        self._whole = bool(np.array_equal(indices, np.arange(first, first + n)))
        self._values: FloatArray = array[first : first + n] if self._whole else np.empty(n)

    def read(self) -> FloatArray:
        """(n,) the entries; do not write to them, and do not keep them."""
        if not self._whole:
            self._array.take(self._indices, out=self._values, mode="clip")
        return self._values

    def write(self, values: FloatArray) -> None:
        """Set the entries to (n,) ``values``."""
        if self._whole:
            self._values[:] = values
        else:
            self._array[self._indices] = values


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

    Friction and tooth damping change with the state; :class:`~pepper_driver.backends.mujoco_.motors.Friction` sets
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
    gain = a.efficiency * constant / resistance
    drive.gainprm[0] = gain
    drive.biasprm[2] = -gain * constant  # Ke = Kt in SI units
    drive.gear[0] = ratio
    drive.armature = motor.rotor_inertia  # MuJoCo reflects it through the gear
    drive.damping[0] = a.motor_damping


def add_flexibility(spec: mujoco.MjSpec, number: int, plant: PlantConfig) -> None:
    """Add a spring hinge behind a joint, in the link that the joint carries."""
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
    """Coulomb friction that sticks. MuJoCo's default is soft: it creeps, and pushes wrongly in hard braking."""
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


ROBOT, OBJECT, FLOOR = 1, 2, 4
"""Collision bits: the robot meets objects, objects meet everything, the floor meets wheels and objects."""

# MuJoCo would print, and write MUJOCO_LOG.TXT into the user's folder; our own errors report what matters.
# MuJoCo has one such handler for the whole process.
mujoco.set_mju_user_warning(lambda message: None)

_BAD = mujoco.mjtWarning
_DIVERGENCE = np.array([_BAD.mjWARN_BADQPOS, _BAD.mjWARN_BADQVEL, _BAD.mjWARN_BADQACC], np.intp)


@dataclass(frozen=True, kw_only=True)
class PlantModel:
    """The compiled model and the indices of its parts. Index and parameter arrays are (17,), in joint order.

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
        """Check if the simulation has met values that are not finite, or huge."""
        return any(data.warning.number[_DIVERGENCE].tolist())

    def in_gap(self, data: mujoco.MjData) -> BoolArray:
        """(17,) whether the teeth of each gear are apart: |q - theta| <= half_gap."""
        phi = data.qpos.take(self.link_qpos) - data.qpos.take(self.motor_qpos)
        in_gap: BoolArray = np.abs(phi) <= self.half_gap
        return in_gap


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
    # A simulation that diverges must be reported, not restart by itself from its first posture.
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


def _change_body(spec: mujoco.MjSpec, body: BodyParameters) -> None:
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


_SLIDES = {"base_x": (1, 0, 0), "base_y": (0, 1, 0), "base_z": (0, 0, 1)}


_HINGES = {"base_yaw": (0, 0, 1), "base_pitch": (0, 1, 0), "base_roll": (1, 0, 0)}


def add_wheel_drives(spec: mujoco.MjSpec, robot: RobotConfig, plant: PlantConfig) -> None:
    """Add a motor under speed control for each wheel: torque = gain (ctrl - speed), within the torque limit."""
    drive, motor = plant.wheels, robot.motors.types[robot.wheels.motor_type]
    for name in robot.wheels.names:
        joint = spec.joint(name)
        joint.actfrclimited = 0
        joint.armature = robot.wheels.ratio**2 * motor.rotor_inertia
        joint.frictionloss = drive.friction
        harden_friction(joint, plant)
        actuator = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.gainprm[0], actuator.biasprm[2] = drive.gain, -drive.gain
        actuator.forcerange = [-drive.torque_limit, drive.torque_limit]
        actuator.forcelimited = 1


def add_rolling_base(
    spec: mujoco.MjSpec, robot: RobotConfig, plant: PlantConfig, *, floor_bit: int
) -> None:
    """Free the base, and put its wheels on a floor."""
    base = spec.body("base_link")
    for name, axis in _SLIDES.items():
        base.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    for name, axis in _HINGES.items():
        hinge = base.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        if name != "base_yaw":
            hinge.limited, hinge.range = 1, [-FALLEN, FALLEN]
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[10, 10, 0.1],
        rgba=[0.8, 0.8, 0.8, 1],
        contype=floor_bit,
        conaffinity=0,
        condim=1,
    )
    for name in robot.wheels.names:
        tyre = spec.joint(name).parent.geoms[0]
        tyre.conaffinity |= floor_bit
        tyre.condim = 1
        tendon = spec.add_tendon(name=grip(name))
        for joint in (name, *_ROLLED):
            tendon.wrap_joint(joint, 1.0)
        harden_friction(tendon, plant)
