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
from pepper_driver.config.arrays import FloatArray, ShortArray
from pepper_driver.config.kernels import Matrix, Out, Records, Strided, kernel, make_records


class Wheel:
    """One wheel: its drive, where MuJoCo has it, and its state.

    ``forward``, ``left`` and ``turn`` are its row of the matrix from the base's twist to wheel speeds. ``integral`` is
    that of the speed control [rad/s], within ``headroom``; ``load`` the force with which the floor carries it [N].
    """

    forward: float
    left: float
    turn: float
    stiffness: float
    headroom: float
    integral: float
    load: float
    actuator: int
    dof: int
    tendon: int
    wrap: int
    geom: int


@kernel
def set_wheel_stiffness(
    wheels: Out[Records[Wheel]],
    stiffness: FloatArray,
    gain: float,
    torque_limit: float,
    gainprm: Out[Matrix[FloatArray]],
    biasprm: Out[Matrix[FloatArray]],
    forcerange: Out[Matrix[FloatArray]],
) -> None:
    """Bound the torque of each drive to a fraction 0..1 of its limit; at 0 the wheel coasts, and forgets its past."""
    for i in range(len(wheels)):
        wheel = wheels[i]
        driven = gain if stiffness[i] > 0.0 else 0.0
        limit = torque_limit * stiffness[i]
        gainprm[wheel.actuator, 0], biasprm[wheel.actuator, 2] = driven, -driven
        forcerange[wheel.actuator, 0], forcerange[wheel.actuator, 1] = -limit, limit
        wheel.headroom = limit / gain
        if not (stiffness[i] > 0.0 and wheel.stiffness > 0.0):
            wheel.integral = 0.0
        wheel.stiffness = stiffness[i]


@kernel
def drive_wheels(
    wheels: Out[Records[Wheel]],
    command: FloatArray,
    speed_limit: float,
    integral_gain: float,
    qvel: FloatArray,
    ctrl: Out[FloatArray],
) -> None:
    """Set the drives of all wheels for a cycle towards ``command`` (3,) [rad/s]."""
    for i in range(len(wheels)):
        wheel = wheels[i]
        target = min(max(command[i], -speed_limit), speed_limit)
        wheel.integral += integral_gain * (target - qvel[wheel.dof])
        wheel.integral = max(min(wheel.integral, wheel.headroom), -wheel.headroom)
        ctrl[wheel.actuator] = target + wheel.integral


@kernel
def set_grip(
    wheels: Records[Wheel],
    yaw: float,
    friction_radius: float,
    wrap_prm: Out[FloatArray],
    frictionloss: Out[FloatArray],
) -> None:
    """Set slip and grip of all wheels at a heading of the base [rad]."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(len(wheels)):
        wheel = wheels[i]
        # Slip = wheel speed - row @ twist, the twist of the base turned from world into base axes.
        wrap_prm[wheel.wrap + 1] = wheel.left * sin - wheel.forward * cos
        wrap_prm[wheel.wrap + 2] = -wheel.forward * sin - wheel.left * cos
        frictionloss[wheel.tendon] = friction_radius * wheel.load


@kernel
def sum_floor_forces(
    wheels: Out[Records[Wheel]],
    floor: int,
    pairs: Strided[Matrix[ShortArray]],
    rows: Strided[ShortArray],
    forces: FloatArray,
) -> None:
    """Sum the normal forces of the floor on each wheel; of a contact without friction it is the solver's one force."""
    for i in range(len(wheels)):
        wheels[i].load = 0.0
    for k in range(len(rows)):
        one, other = pairs[k, 0], pairs[k, 1]
        if rows[k] < 0 or floor not in (one, other):
            continue
        for i in range(len(wheels)):
            if wheels[i].geom in (one, other):
                wheels[i].load += forces[rows[k]]


class WheelDynamics(Resumable):
    """Speed control and grip of the wheels, once a cycle.

    Attributes:
        rolling: True for a base that rolls.
        wheels: Drive and state of each.
    """

    STATE = ("wheels",)

    def __init__(
        self, robot: RobotConfig, plant: PlantConfig, mj: mujoco.MjModel, data: mujoco.MjData
    ) -> None:
        names, rows = robot.wheels.names, robot.wheels.matrix
        self._mj, self._data = mj, data
        self._limit = robot.wheels.speed_limit
        self._gain = plant.wheels.gain
        self._integral_gain = robot.cycle / plant.wheels.integral_time
        self._torque_limit = plant.wheels.torque_limit
        self._dof = np.array([mj.joint(name).dofadr[0] for name in names])
        self.wheels = make_records(
            Wheel,
            len(names),
            forward=rows[:, 0],
            left=rows[:, 1],
            turn=rows[:, 2],
            actuator=[mj.actuator(name).id for name in names],
            dof=self._dof,
        )
        self.rolling = plant.base == "rolling"
        if self.rolling:
            self._yaw = int(mj.joint("base_yaw").qposadr[0])
            tendons = [mj.tendon(grip(name)).id for name in names]
            self.wheels["tendon"], self.wheels["wrap"] = tendons, mj.tendon_adr[tendons]
            self.wheels["geom"] = [mj.body_geomadr[mj.jnt_bodyid[mj.joint(n).id]] for n in names]
            mj.wrap_prm[self.wheels["wrap"]] = 1.0
            mj.wrap_prm[self.wheels["wrap"] + 3] = -self.wheels["turn"]
            self._friction_radius = plant.wheels.floor_friction * robot.wheels.radius
            self._floor = int(mj.geom("floor").id)
            weight = float(mj.body_subtreemass[mj.body("base_link").id]) * -float(mj.opt.gravity[2])
            self._even_load = weight / len(names)
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        self._drives = mj.actuator_gainprm, mj.actuator_biasprm, mj.actuator_forcerange
        self._grips = mj.wrap_prm, mj.tendon_frictionloss
        self._set_stiffness, self._drive = set_wheel_stiffness.load(), drive_wheels.load()
        self._set_grip, self._sum_floor_forces = set_grip.load(), sum_floor_forces.load()
        self._begin(np.zeros(len(names)))

    @property
    def speed(self) -> FloatArray:
        """(3,) wheel speeds [rad/s]."""
        speed: FloatArray = self._qvel.take(self._dof)
        return speed

    @property
    def load(self) -> FloatArray:
        """(3,) force with which the floor carries each wheel [N], at the end of the last cycle."""
        load: FloatArray = self.wheels["load"].copy()
        return load

    @property
    def min_load(self) -> float:
        """Load of the wheel that carries least, over what it carries where all carry the same; 1 on a fixed base."""
        return float(self.wheels["load"].min()) / self._even_load if self.rolling else 1.0

    def reset(self) -> None:
        """No integral; the wheels carry the robot evenly."""
        self._begin(np.zeros(len(self.wheels)))
        if self.rolling:
            self.wheels["load"] = self._even_load

    def restore(self, saved: dict[str, Any]) -> None:
        """As it was, the drives powered or not."""
        super().restore(saved)
        self._begin(self.wheels["stiffness"].copy())

    def begin_cycle(self, command: FloatArray, stiffness: FloatArray) -> None:
        """Drive towards ``command`` (3,) [rad/s] for one cycle.

        ``stiffness`` (3,) 0..1 is the fraction of its torque that each drive may use; at 0 the wheel coasts.
        """
        self._begin(stiffness)
        self._drive(self.wheels, command, self._limit, self._integral_gain, self._qvel, self._ctrl)
        if self.rolling:
            self._set_grip(
                self.wheels, float(self._qpos[self._yaw]), self._friction_radius, *self._grips
            )

    def _begin(self, stiffness: FloatArray) -> None:
        self._set_stiffness(self.wheels, stiffness, self._gain, self._torque_limit, *self._drives)

    def end_cycle(self) -> None:
        """Take in what the floor carried in the last step of physics."""
        if self.rolling:
            data, contact = self._data, self._data.contact
            self._sum_floor_forces(
                self.wheels, self._floor, contact.geom, contact.efc_address, data.efc_force
            )
