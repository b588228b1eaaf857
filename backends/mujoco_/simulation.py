"""One cycle of the simulated robot, its snapshots, and the truth behind its measurements."""

from __future__ import annotations

from typing import Any, ClassVar

import mujoco
import numpy as np

from pepper_driver.backends.fields import Imu, Measurement
from pepper_driver.backends.mujoco_.contacts import Contacts
from pepper_driver.backends.mujoco_.motors import JointFriction, MotorBoards, Supply, ThermalState
from pepper_driver.backends.mujoco_.plant_model import FALLEN, ArrayView, build_model
from pepper_driver.backends.mujoco_.sensors import CurrentSensors, Encoders, InertialUnit
from pepper_driver.backends.mujoco_.targets import BoardTargets
from pepper_driver.backends.mujoco_.wheels import WheelDynamics
from pepper_driver.backends.simulated import Resumable, TrueContact, Truth
from pepper_driver.config import PlantConfig, RobotConfig, World
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import check_name

LYING = 0.05
"""[rad] Before the tilt at which the base lies, where it still rocks."""


class MujocoTruth(Truth):
    """Ground truth of the simulated robot."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        mj, names = simulation.model.mj, ("base_x", "base_y", "base_yaw", "base_pitch", "base_roll")
        self._places = None
        if simulation.wheels.rolling:
            self._places = np.array([mj.joint(name).qposadr[0] for name in names])

    @property
    def contact_torque(self) -> FloatArray:
        """(17,) J^T f, mean over the last cycle [N m]."""
        return self._simulation.contacts.torque.copy()

    @property
    def peak_torque(self) -> FloatArray:
        """(17,) largest |J^T f| in a step of the last cycle [N m]."""
        return self._simulation.contacts.peak_torque.copy()

    @property
    def contacts(self) -> tuple[TrueContact, ...]:
        """True contacts of the last cycle."""
        return self._simulation.contacts.acted

    @property
    def base(self) -> FloatArray:
        """(3,) x, y [m], yaw [rad] of base_link."""
        return self._base()[:3]

    @property
    def tilt(self) -> FloatArray:
        """(2,) pitch and roll of the base [rad]."""
        return self._base()[3:]

    @property
    def fallen(self) -> bool:
        """True when the base has come to lie."""
        return bool(np.abs(self.tilt).max() > FALLEN - LYING)

    @property
    def wheel_load(self) -> FloatArray:
        """(3,) force of the floor on each wheel [N]."""
        return self._simulation.wheels.load.copy()

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of all links, rotors and wheels, with the objects of the world [J]."""
        mj, data = self._simulation.model.mj, self._simulation.data
        momentum = np.empty(mj.nv)
        mujoco.mj_mulM(mj, data, momentum, data.qvel)
        return 0.5 * float(momentum @ data.qvel)

    def _base(self) -> FloatArray:
        """(5,) x, y, yaw, pitch, roll."""
        if self._places is None:
            return np.zeros(5)
        base: FloatArray = self._simulation.data.qpos.take(self._places)
        return base

    @property
    def in_gap(self) -> BoolArray:
        """(17,) whether the joint is inside its backlash."""
        return self._simulation.model.in_gap(self._simulation.data)

    @property
    def saturated(self) -> BoolArray:
        """(17,) whether the board met its current or voltage limit in the last cycle."""
        return self._simulation.boards.saturated.copy()

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""
        return self._simulation.position

    def link_pose(self, link: str) -> FloatArray:
        """(4, 4) transform of a link in the world."""
        model = self._simulation.model
        check_name("link", link, model.bodies)
        # In data of its own: the simulation continues from the data of its last step.
        scratch = mujoco.MjData(model.mj)
        scratch.qpos[:] = self._simulation.data.qpos
        mujoco.mj_kinematics(model.mj, scratch)
        pose = np.eye(4)
        pose[:3, :3] = scratch.xmat[model.bodies[link]].reshape(3, 3)
        pose[:3, 3] = scratch.xpos[model.bodies[link]]
        return pose


class Simulation(Resumable):
    """A simulated robot, without the transport between it and its reader.

    Attributes:
        model: The compiled model.
        data: MuJoCo's state.
        boards, targets, wheels, supply, contacts: The parts, for those who read them.
        current: (17,) |mean motor current| of the last cycle [A].
    """

    STATE = ("current",)

    def __init__(self, robot: RobotConfig, plant: PlantConfig, world: World | None = None) -> None:
        self.model = build_model(robot, plant, world)
        mj = self.model.mj
        self.data = mujoco.MjData(mj)
        self.boards = MotorBoards(robot, plant)
        self.wheels = WheelDynamics(robot, plant, mj, self.data)
        self.supply = Supply(robot, plant)
        self.contacts = Contacts(robot, self.model, self.data, self.wheels, world)
        self._friction = JointFriction(robot, plant, self.model, self.data)
        self._steps = round(robot.cycle / plant.physics.timestep)
        self.targets = BoardTargets(robot, plant, self._steps)
        self._resistance = np.array([robot.motors.of(n).resistance for n in robot.joint_names])
        self._constant = np.array([robot.motors.of(n).torque_constant for n in robot.joint_names])
        self._efficiency = plant.per_joint("efficiency", robot)
        n = len(robot.joint_names)
        self._link_angle = ArrayView(self.data.qpos, self.model.link_qpos)
        self._motor_speed = ArrayView(self.data.qvel, self.model.motor_dof)
        self._voltage = ArrayView(self.data.ctrl, self.model.actuator)
        self.current = np.zeros(n)
        self._warmth: ThermalState | None = None

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""
        position: FloatArray = self.data.qpos.take(self.model.link_qpos)
        return position

    def reset(self, posture: FloatArray, seed: int = 0) -> None:
        """Stand still, motors off, brakes on.

        Args:
            posture: (17,) [rad].
            seed: Of what the boards do by chance.

        Raises:
            ConfigError: An object of the world collides with the robot.
        """
        model, data = self.model, self.data
        mujoco.mj_resetData(model.mj, data)
        data.qpos[model.link_qpos] = posture
        data.qpos[model.motor_qpos] = posture
        self.boards.reset()
        self.supply.reset()
        self.wheels.reset()
        self.contacts.reset()
        self.current = np.zeros_like(posture)
        self.targets.reset(posture, seed)
        mujoco.mj_forward(model.mj, data)
        self.contacts.check_clearance()

    def cycle(
        self,
        position: FloatArray,
        stiffness: FloatArray,
        wheel_speed: FloatArray,
        wheel_stiffness: FloatArray,
    ) -> None:
        """One cycle of physics towards ``position``; arrays as in :class:`~..interface.Command`.

        Args:
            position: (17,) [rad], where the boards' own interpolation of the command ends.
            stiffness: (17,) 0..1.
            wheel_speed: (3,) [rad/s].
            wheel_stiffness: (3,) 0..1, fraction of its torque that each wheel's drive may use.
        """
        boards, supply, targets = self.boards, self.supply, self.targets
        targets.plan(position, stiffness)
        now, increment = targets.now, targets.increment
        if supply.warmth is not self._warmth:
            self._warm(supply.warmth)
        boards.begin_cycle(targets.held, supply.voltage)
        self.wheels.begin_cycle(wheel_speed, wheel_stiffness)
        self.contacts.begin_cycle()
        link_angle, motor_speed, output = self._link_angle, self._motor_speed, self._voltage
        set_friction, step = self._friction.update, self.contacts.step
        for _ in range(self._steps):
            np.add(now, increment, now)
            voltage = boards.update(now, link_angle.read(), motor_speed.read())
            output.write(voltage)
            set_friction()
            step()
        self.current = boards.mean_current(self._steps)
        self.wheels.end_cycle()
        self.contacts.end_cycle()
        power = float(voltage @ boards.current)
        supply.step(boards.current, max(0.0, power))

    def save(self) -> dict[str, Any]:
        """Everything that the next cycle depends on."""
        mj = self.model.mj
        state = np.empty(mujoco.mj_stateSize(mj, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(mj, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        parts = {name: part.save() for name, part in self._parts().items()}
        return {"mujoco": state, "self": super().save(), **parts}

    def restore(self, saved: dict[str, Any]) -> None:
        """Return to a state of :meth:`save`."""
        mj, data, kind = self.model.mj, self.data, mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_resetData(mj, data)
        mujoco.mj_setState(mj, data, saved["mujoco"], kind)
        mujoco.mj_forward(
            mj, data
        )  # what follows from the state, for those who read it before the next step
        mujoco.mj_setState(mj, data, saved["mujoco"], kind)  # its warm start is part of the state
        super().restore(saved["self"])
        for name, part in self._parts().items():
            part.restore(saved[name])

    def _parts(self) -> dict[str, Resumable]:
        return {
            "boards": self.boards,
            "targets": self.targets,
            "wheels": self.wheels,
            "supply": self.supply,
            "contacts": self.contacts,
        }

    def _warm(self, warmth: ThermalState) -> None:
        """Torque constant and resistance of each motor, and friction, at its temperature."""
        mj, actuator = self.model.mj, self.model.actuator
        constant = self._constant * warmth.magnet
        gain = self._efficiency * constant / (self._resistance * warmth.copper)
        mj.actuator_gainprm[actuator, 0] = gain
        mj.actuator_biasprm[actuator, 2] = -gain * constant
        self._friction.warm(warmth.grease)
        self.boards.warm(warmth.copper, warmth.magnet)
        self._warmth = warmth


class Readings(Resumable):
    """Encoders, current sensors, inertial unit and the rest, as one :class:`Measurement`.

    Attributes:
        position: (17,) joint positions last read [rad].
    """

    STATE: ClassVar[tuple[str, ...]] = ("position", "_tick")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, simulation: Simulation) -> None:
        self._robot, self._plant, self._simulation = robot, plant, simulation
        self._imu = InertialUnit(robot, simulation.model.mj, simulation.data)
        self.begin(0)

    def begin(self, seed: int) -> Measurement:
        """Return the first measurement of a robot at rest, with noise of this seed to come."""
        # One stream for each kind of sensor: a change in one leaves the noise of the others as it was.
        streams = np.random.SeedSequence(seed).spawn(2)
        rngs = [np.random.Generator(np.random.PCG64(stream)) for stream in streams]
        self._encoders = Encoders(self._robot, self._plant, rngs[0])
        self._current_sensors = CurrentSensors(self._robot, self._plant, rngs[1])
        self._tick = 0
        start = self._simulation.position
        return self._measurement(
            self._encoders.reset(start), self._current_sensors.reset(), self._imu.reset()
        )

    def read(self) -> Measurement:
        """Return the measurement one cycle later."""
        self._tick += 1
        simulation = self._simulation
        return self._measurement(
            self._encoders.read(simulation.position),
            self._current_sensors.read(simulation.current),
            self._imu.read(),
        )

    def save(self) -> dict[str, Any]:
        """State of the sensors and their noise."""
        return {"self": super().save(), **{n: part.save() for n, part in self._parts().items()}}

    def restore(self, saved: dict[str, Any]) -> None:
        """Return to a state of :meth:`save`."""
        super().restore(saved["self"])
        for name, part in self._parts().items():
            part.restore(saved[name])

    def _parts(self) -> dict[str, Resumable]:
        return {"encoders": self._encoders, "currents": self._current_sensors, "imu": self._imu}

    def _measurement(self, position: FloatArray, current: FloatArray, imu: Imu) -> Measurement:
        self.position = position
        supply, sensors = self._simulation.supply, self._simulation.contacts.touch
        return Measurement(
            time=self._tick * self._robot.cycle,
            tick=self._tick,
            position=position,
            current=current,
            wheel_speed=self._simulation.wheels.speed,
            imu=imu,
            touch=sensors.touch,
            bumpers=sensors.bumpers,
            buttons=sensors.buttons,
            temperature=np.rint(supply.temperature),
            battery=supply.charge,
            age=self._encoders.age * self._robot.cycle,
            charging_flap=0.0,
        )
