"""The plant in motion: one cycle of physics with boards, friction, wheels, supply and contacts."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.board import MotorBoards
from pepper_driver.backends.mujoco_.contacts import Contacts
from pepper_driver.backends.mujoco_.friction import Friction
from pepper_driver.backends.mujoco_.model import build_model
from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.backends.mujoco_.rolling import Wheels
from pepper_driver.backends.mujoco_.slots import Slots
from pepper_driver.backends.mujoco_.supply import Supply, Warmth
from pepper_driver.config import PlantConfig, RobotConfig, World
from pepper_driver.config.arrays import FloatArray


class Simulation(Resumable):
    """A simulated robot, without the transport between it and its reader.

    Attributes:
        model: The compiled model.
        data: MuJoCo's state.
        boards, wheels, supply, contacts: The parts, for those who read them.
        current: (17,) |mean motor current| of the last cycle [A].
    """

    STATE = ("current", "_target", "_braked_at")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, world: World | None = None) -> None:
        self.model = build_model(robot, plant, world)
        mj = self.model.mj
        self.data = mujoco.MjData(mj)
        self.boards = MotorBoards(robot, plant)
        self.wheels = Wheels(robot, plant, mj, self.data)
        self.supply = Supply(robot, plant)
        self.contacts = Contacts(robot, self.model, self.data, world)
        self._friction = Friction(robot, plant, self.model, self.data)
        self._steps = round(robot.cycle / plant.physics.timestep)
        self._speed_limit = plant.board.speed_limit
        self._cycle = robot.cycle
        self._brakes = np.array([name in plant.board.brakes for name in robot.joint_names])
        self._resistance = np.array([robot.motors.of(n).resistance for n in robot.joint_names])
        self._constant = np.array([robot.motors.of(n).torque_constant for n in robot.joint_names])
        n = len(robot.joint_names)
        self._link_angle = Slots(self.data.qpos, self.model.link_qpos)
        self._motor_speed = Slots(self.data.qvel, self.model.motor_dof)
        self._voltage = Slots(self.data.ctrl, self.model.actuator)
        self.current = np.zeros(n)
        self._target, self._braked_at = np.zeros(n), np.zeros(n)
        self._warmth: Warmth | None = None

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""
        return np.array(self.data.qpos[self.model.link_qpos])

    def reset(self, posture: FloatArray) -> None:
        """Stand still in ``posture`` (17,) [rad], motors off, brakes on.

        Raises:
            ConfigError: An object of the world is in the way.
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
        self._target, self._braked_at = posture.copy(), posture.copy()
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
            wheel_stiffness: (3,) 0..1, the share of its torque that each wheel's drive may use.
        """
        boards, supply = self.boards, self.supply
        # A brake holds where it closed; it stays until the stiffness returns.
        braked = self._brakes & (stiffness <= 0.0)
        if braked.any():
            position = np.where(braked, self._braked_at, position)
            stiffness = np.where(braked, 1.0, stiffness)
        self._braked_at = position
        travel = position - self._target
        if self._speed_limit is not None:
            reach = self._speed_limit * self._cycle
            travel = np.clip(travel, -reach, reach)
        if supply.warmth is not self._warmth:
            self._warm(supply.warmth)
        boards.begin_cycle(stiffness, supply.voltage)
        self.wheels.begin_cycle(wheel_speed, wheel_stiffness)
        self.contacts.begin_cycle()
        current = np.zeros_like(position)
        target, share = self._target.copy(), travel / self._steps
        friction, contacts = self._friction, self.contacts
        position_now, speed, output = self._link_angle, self._motor_speed, self._voltage
        for _ in range(self._steps):
            target += share
            voltage = boards.update(target, position_now.read(), speed.read())
            output.write(voltage)
            friction.update()
            contacts.step()
            current += boards.current
        self._target = self._target + travel
        self.current = np.abs(current) / self._steps
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
        """Go back to a state that :meth:`save` gave."""
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
            "wheels": self.wheels,
            "supply": self.supply,
            "contacts": self.contacts,
        }

    def _warm(self, warmth: Warmth) -> None:
        """Torque constant and resistance of each motor, and friction, at its temperature."""
        mj, actuator = self.model.mj, self.model.actuator
        constant = self._constant * warmth.magnet
        gain = constant / (self._resistance * warmth.copper)
        mj.actuator_gainprm[actuator, 0] = gain
        mj.actuator_biasprm[actuator, 2] = -gain * constant
        self._friction.warm(warmth.grease)
        self.boards.warm(warmth.copper, warmth.magnet)
        self._warmth = warmth
