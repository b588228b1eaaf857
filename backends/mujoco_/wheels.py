"""The base: three driven omni-wheels, and a floor they grip and can tip over.

A wheel grips along its driven direction and rolls freely across it. For MuJoCo that is a Coulomb friction between
wheel and base: a fixed tendon whose velocity is the slip r (w_i - row_i twist) of the wheel's rim, with the floor's
friction times the wheel's load as its limit. The rows depend on the heading, so the tendon's coefficients are set again
before each cycle. The floor itself carries the wheels without friction; they lift off when the robot tips.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.plant_model import grip
from pepper_driver.backends.simulated import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray


class WheelDynamics(Resumable):
    """Speed control and grip of the wheels, once a cycle.

    Attributes:
        load: (3,) force with which the floor carries each wheel [N], at the end of the last cycle.
    """

    STATE = ("load", "_integral", "_stiffness")

    def __init__(
        self, robot: RobotConfig, plant: PlantConfig, mj: mujoco.MjModel, data: mujoco.MjData
    ) -> None:
        names = robot.wheels.names
        self._mj, self._data = mj, data
        self._limit = robot.wheels.speed_limit
        self._gain = plant.wheels.gain
        self._integral_gain = robot.cycle / plant.wheels.integral_time
        self._torque_limit = plant.wheels.torque_limit
        self._actuator = np.array([mj.actuator(name).id for name in names])
        self._dof = np.array([mj.joint(name).dofadr[0] for name in names])
        self.rolling = plant.base == "rolling"
        self._radius = robot.wheels.radius
        self._rows = robot.wheels.matrix
        self._grip = plant.wheels.floor_friction
        if self.rolling:
            self._yaw = int(mj.joint("base_yaw").qposadr[0])
            self._tendon = np.array([mj.tendon(grip(name)).id for name in names])
            self._wrap = mj.tendon_adr[self._tendon][:, None] + np.arange(4)
            self._coefficients = np.column_stack([np.ones(3), np.zeros((3, 2)), -self._rows[:, 2]])
            self._tyre = [int(mj.body_geomadr[mj.jnt_bodyid[mj.joint(n).id]]) for n in names]
            self._wheel_of = {geom: number for number, geom in enumerate(self._tyre)}
            self._floor = mj.geom("floor").id
            self._base = mj.body("base_link").id
        self._integral, self._stiffness = np.zeros(3), np.zeros(3)
        self.load = np.zeros(3)
        self._set_stiffness(np.zeros(3))

    @property
    def speed(self) -> FloatArray:
        """(3,) wheel speeds [rad/s]."""
        return np.array(self._data.qvel[self._dof])

    def reset(self) -> None:
        """No integral; the wheels carry the robot evenly."""
        self._set_stiffness(np.zeros(3))
        if self.rolling:
            weight = float(self._mj.body_subtreemass[self._base]) * -float(self._mj.opt.gravity[2])
            self.load = np.full(3, weight / 3)

    def restore(self, saved: dict[str, Any]) -> None:
        """As it was, the drives powered or not."""
        super().restore(saved)
        self._set_stiffness(self._stiffness)

    def begin_cycle(self, command: FloatArray, stiffness: FloatArray) -> None:
        """Drive towards ``command`` (3,) [rad/s] for one cycle.

        ``stiffness`` (3,) 0..1 is the fraction of its torque that each drive may use; at 0 the wheel coasts.
        """
        if not np.array_equal(stiffness, self._stiffness):
            self._set_stiffness(stiffness)
        target = np.minimum(np.maximum(command, -self._limit), self._limit)
        self._integral += self._integral_gain * (target - self._data.qvel[self._dof])
        np.minimum(self._integral, self._headroom, out=self._integral)
        np.maximum(self._integral, -self._headroom, out=self._integral)
        self._data.ctrl[self._actuator] = target + self._integral
        if self.rolling:
            self._set_grip(self.load)

    def _set_stiffness(self, stiffness: FloatArray) -> None:
        gain = np.where(stiffness > 0.0, self._gain, 0.0)
        limit = self._torque_limit * stiffness
        self._mj.actuator_gainprm[self._actuator, 0] = gain
        self._mj.actuator_biasprm[self._actuator, 2] = -gain
        self._mj.actuator_forcerange[self._actuator] = np.column_stack([-limit, limit])
        self._headroom = limit / self._gain
        driven = (stiffness > 0.0) & (self._stiffness > 0.0)
        self._integral = np.where(driven, self._integral, 0.0)
        self._stiffness = stiffness.copy()

    def end_cycle(self) -> None:
        """Take in what the floor carried in the last step of physics."""
        if self.rolling:
            self.load = self._floor_forces()

    def _floor_forces(self) -> FloatArray:
        """(3,) normal force on each wheel [N]; of a contact without friction it is the one force of the solver."""
        data, load = self._data, np.zeros(3)
        if data.ncon == 0:
            return load
        contact = data.contact
        pairs, rows = contact.geom.tolist(), contact.efc_address.tolist()
        forces = data.efc_force
        for (one, other), row in zip(pairs, rows, strict=True):
            if row < 0 or self._floor not in (one, other):
                continue
            wheel = self._wheel_of.get(other if one == self._floor else one)
            if wheel is not None:
                load[wheel] += forces[row]
        return load

    def _set_grip(self, load: FloatArray) -> None:
        yaw = float(self._data.qpos[self._yaw])
        cos, sin = math.cos(yaw), math.sin(yaw)
        forward, left = self._rows[:, 0], self._rows[:, 1]
        # Slip = wheel speed - row @ twist, the twist of the base turned from world into base axes.
        self._coefficients[:, 1] = left * sin - forward * cos
        self._coefficients[:, 2] = -forward * sin - left * cos
        self._mj.wrap_prm[self._wrap] = self._coefficients
        self._mj.tendon_frictionloss[self._tendon] = self._grip * self._radius * load
