"""Motors: boards and their control law, friction of gears, battery and heat."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.simulated import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records


class Gear:
    """Friction of one joint on the side of its motor and on that of its link, and where MuJoCo has them.

    Coulomb friction is ``motor`` and ``link`` with the teeth in contact, with ``motor_change`` and ``link_change`` on
    top inside the gap; ``_viscous`` likewise. All follow the temperature of the grease but those named ``cold``.
    """

    cold_motor: float
    cold_link: float
    cold_motor_change: float
    cold_link_change: float
    motor: float
    link: float
    motor_change: float
    link_change: float
    motor_viscous: float
    link_viscous: float
    motor_viscous_change: float
    link_viscous_change: float
    excess: float
    inverse_stribeck: float
    cold_load: float
    load: float
    ripple: float
    ripple_count: float
    half_gap: float
    damping: float
    damping_change: float
    relative: float
    relative_viscous: float
    warmth: float
    link_qpos: int
    motor_qpos: int
    link_dof: int
    motor_dof: int
    tendon: int


@kernel
def set_friction(
    gears: Records[Gear],
    qpos: FloatArray,
    qvel: FloatArray,
    frictionloss: Out[FloatArray],
    damping: Out[FloatArray],
    tooth_friction: Out[FloatArray],
    tooth_damping: Out[FloatArray],
) -> None:
    """Set friction and damping of all gears for the step of physics to come; arrays are MuJoCo's."""
    for j in range(len(gears)):
        gear = gears[j]
        theta = qpos[gear.motor_qpos]
        # How far the teeth are pressed into each other [rad]; below 0 inside the gap.
        beyond = abs(qpos[gear.link_qpos] - theta) - gear.half_gap
        gap = 1.0 if beyond <= 0.0 else 0.0
        motor = gear.motor_change * gap + gear.motor
        motor *= stribeck(gear, qvel[gear.motor_dof])
        if gear.ripple != 0.0:
            motor *= math.cos(gear.ripple_count * theta) * gear.ripple + 1.0
        link = gear.link_change * gap + gear.link
        link *= stribeck(gear, qvel[gear.link_dof])
        frictionloss[gear.motor_dof] = motor + max(beyond, 0.0) * gear.load
        frictionloss[gear.link_dof] = link
        damping[gear.motor_dof] = (
            gear.motor_viscous + gear.motor_viscous_change * gap
        ) * gear.warmth
        damping[gear.link_dof] = (gear.link_viscous + gear.link_viscous_change * gap) * gear.warmth
        tooth_friction[gear.tendon] = gear.relative * gap * gear.warmth
        tooth_damping[gear.tendon] = gear.damping_change * gap + gear.damping


@kernel
def stribeck(gear: Gear, velocity: float) -> float:
    """Return 1 + (b - 1) / (1 + (v / v_s)^2) at a velocity [rad/s]."""
    ratio = velocity * gear.inverse_stribeck
    return gear.excess / (ratio * ratio + 1.0) + 1.0


class JointFriction:
    """Eq. 7 of the paper, its two sets of coefficients, with what a real gear adds.

    On each side, Coulomb friction C (1 + (b - 1) / (1 + (v / v_s)^2)) with the set of coefficients of the gap or of
    teeth in contact, breakaway b and Stribeck velocity v_s; all of it shrinks as the grease warms. The motor's side
    also has load-dependent friction, a fraction of the torque through the teeth, and a ripple over the turn of the
    joint. Inside the gap the two sides may drag at each other. MuJoCo solves Coulomb friction as a constraint: it
    sticks.
    """

    def __init__(
        self, robot: RobotConfig, plant: PlantConfig, model: PlantModel, data: mujoco.MjData
    ) -> None:
        def each(key: str) -> FloatArray:
            return plant.per_joint(f"friction.{key}", robot)

        mj = model.mj
        coefficients: dict[str, FloatArray] = {}
        for side in ("motor", "link"):
            # What the gap changes is added where the teeth are apart.
            for suffix, prefix in (("", "cold_"), ("_viscous", "")):
                contact, gap = each(f"contact.{side}{suffix}"), each(f"gap.{side}{suffix}")
                coefficients[f"{prefix}{side}{suffix}"] = contact
                coefficients[f"{prefix}{side}{suffix}_change"] = gap - contact
        self._gears = make_records(
            Gear,
            len(model.half_gap),
            **coefficients,
            excess=each("breakaway") - 1.0,
            inverse_stribeck=1.0 / each("stribeck_velocity"),
            cold_load=each("load") * plant.per_joint("gear_stiffness", robot),
            ripple=each("ripple"),
            ripple_count=each("ripple_count"),
            half_gap=model.half_gap,
            damping=plant.per_joint("gear_damping", robot),
            relative=each("gap.relative"),
            relative_viscous=each("gap.relative_viscous"),
            link_qpos=model.link_qpos,
            motor_qpos=model.motor_qpos,
            link_dof=model.link_dof,
            motor_dof=model.motor_dof,
            tendon=model.tendon,
        )
        self._qpos, self._qvel = data.qpos, data.qvel
        self._frictionloss, self._damping = mj.dof_frictionloss, mj.dof_damping
        self._tooth_friction, self._tooth_damping = mj.tendon_frictionloss, mj.tendon_damping
        self._set = set_friction.load()
        self.warm(np.ones(len(model.half_gap)))

    def warm(self, factor: FloatArray) -> None:
        """Scale all friction by ``factor`` (17,) from now on."""
        gears = self._gears
        gears["warmth"] = factor
        for name in ("motor", "link", "motor_change", "link_change", "load"):
            gears[name] = gears[f"cold_{name}"] * factor
        gears["damping_change"] = gears["relative_viscous"] * factor - gears["damping"]

    def update(self) -> None:
        """Set friction and damping for the step of physics to come."""
        self._set(
            self._gears,
            self._qpos,
            self._qvel,
            self._frictionloss,
            self._damping,
            self._tooth_friction,
            self._tooth_damping,
        )


COLDEST_FRICTION, WARMEST_FRICTION = 4.0, 0.25
"""Friction by temperature is linear around the reference; far from it, it stays within these factors."""


SMALLEST_FACTOR = 0.1
"""The same for resistance and torque constant."""


@dataclass(frozen=True, kw_only=True)
class ThermalState:
    """(17,) factors on the resistance of the windings, on the torque constant, and on all friction."""

    copper: FloatArray
    magnet: FloatArray
    grease: FloatArray


@kernel
def heat_motors(
    temperature: Out[FloatArray],
    tenths: FloatArray,
    current: FloatArray,
    resistance: FloatArray,
    rise: FloatArray,
    ambient: float,
    fraction: float,
) -> bool:
    """Warm the motors by their losses over a cycle; return True if one is then another tenth of a degree off.

    Args:
        temperature: Of the windings [deg C].
        tenths: Their temperatures before, in whole tenths of a degree.
        current: [A]
        resistance: Of the windings as they are [ohm].
        rise: Over the air, settled [K/W].
        ambient: Temperature of the air [deg C].
        fraction: Of the difference to the settled temperature that a cycle removes.
    """
    changed = False
    for j in range(len(temperature)):
        loss = resistance[j] * (current[j] * current[j])
        temperature[j] += (ambient + rise[j] * loss - temperature[j]) * fraction
        changed = changed or np.rint(10.0 * temperature[j]) != tenths[j]
    return changed


class Supply(Resumable):
    """Charge of the battery and temperature of the motors.

    Attributes:
        charge: 0..1.
        temperature: (17,) of the windings [deg C].
        warmth: Effect of the temperatures; the same object as long as no motor is another tenth of a degree off.
    """

    STATE = ("charge", "temperature", "_sag")

    def __init__(self, robot: RobotConfig, plant: PlantConfig) -> None:
        names = robot.joint_names
        self._cycle = robot.cycle
        self._battery, self._heat = plant.battery, plant.heat
        self._resistance = np.array([robot.motors.of(name).resistance for name in names])
        self._rise = np.array([plant.heat.rise[robot.motors.joints[name].type] for name in names])
        self._fraction = robot.cycle / plant.heat.time_constant
        self._heat_motors = heat_motors.load()
        self.reset()

    def reset(self) -> None:
        """Battery and motors as at the start."""
        self.charge = self._battery.charge
        self.temperature = np.full(len(self._rise), self._heat.start)
        self._sag = 0.0
        self._warm()

    @property
    def voltage(self) -> float:
        """Voltage of the battery under its load [V]."""
        battery = self._battery
        span = battery.full_voltage - battery.empty_voltage
        return max(0.0, battery.empty_voltage + span * self.charge - self._sag)

    def _warm(self) -> None:
        self._tenths, heat = np.rint(10.0 * self.temperature), self._heat
        above = 0.1 * self._tenths - heat.reference
        self.warmth = ThermalState(
            copper=np.maximum(1.0 + heat.copper * above, SMALLEST_FACTOR),
            magnet=np.maximum(1.0 + heat.magnet * above, SMALLEST_FACTOR),
            grease=np.clip(1.0 + heat.grease * above, WARMEST_FRICTION, COLDEST_FRICTION),
        )
        self._warm_resistance = self._resistance * self.warmth.copper

    def restore(self, saved: dict[str, Any]) -> None:
        """Return to a state of :meth:`save`."""
        super().restore(saved)
        self._warm()

    def step(self, current: FloatArray, power: float) -> None:
        """One cycle later. Temperature and charge change over minutes: a sample a cycle is enough.

        Args:
            current: (17,) of the motors at the end of the cycle [A].
            power: What the motors of the joints then took from the battery [W]; what they gave back counts as none.
                The wheels' part is small compared with ``idle_power``, and included there.
        """
        battery, ambient = self._battery, self._heat.ambient
        if self._heat_motors(
            self.temperature,
            self._tenths,
            current,
            self._warm_resistance,
            self._rise,
            ambient,
            self._fraction,
        ):
            self._warm()
        power += battery.idle_power
        self.charge = max(0.0, self.charge - power * self._cycle / battery.energy)
        self._sag = battery.resistance * power / (self.voltage + self._sag)


class Board:
    """One motor board: what it is, its gains in this cycle, and its state.

    ``smoothed`` is the low-passed error [rad], ``integral`` the integral part [V], ``drop`` the voltage that drives the
    largest current through the windings [V], ``current_sum`` the sum of the currents of a cycle [A].
    """

    kp: float
    kd_step: float
    ki_step: float
    derivative_gain: float
    dead_band: float
    integral_band: float
    integral_limit: float
    count: float
    counts_per_radian: float
    resistance: float
    back_emf: float
    full_drop: float
    proportional: float
    derivative: float
    integral_step: float
    supply: float
    drop: float
    smoothed: float
    integral: float
    current_sum: float


@kernel
def begin_board_cycle(
    boards: Out[Records[Board]], stiffness: FloatArray, supply: float, duty: float
) -> None:
    """Set gains and limits for the steps of a cycle; see :meth:`MotorBoards.begin_cycle`."""
    for j in range(len(boards)):
        board = boards[j]
        board.proportional = board.kp * duty
        board.derivative = board.kd_step * duty
        board.integral_step = board.ki_step * duty
        board.supply = supply
        board.drop = board.full_drop * stiffness[j]
        if not stiffness[j] > 0.0:  # a motor board without current clears its integral
            board.integral = 0.0
        board.current_sum = 0.0


@kernel
def update_boards(
    boards: Out[Records[Board]],
    target: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    voltage: Out[FloatArray],
    current: Out[FloatArray],
    saturated: Out[BoolArray],
) -> None:
    """Run one step of all boards; see :meth:`MotorBoards.update`."""
    for j in range(len(boards)):
        board = boards[j]
        error = target[j] - np.rint(position[j] * board.counts_per_radian) * board.count
        change = error - board.smoothed
        unclamped = board.derivative * change
        board.smoothed += board.derivative_gain * change
        # What the proportional and the integral part see; the derivative damps inside the band too.
        error -= min(max(error, -board.dead_band), board.dead_band)
        unclamped += board.proportional * error
        unclamped += board.integral
        emf = board.back_emf * velocity[j]
        allowed = min(max(unclamped, emf - board.drop), emf + board.drop)
        allowed = max(min(allowed, board.supply), -board.supply)
        saturated[j] = saturated[j] or allowed != unclamped
        gain = board.integral_step * error
        # Clamped at a bound, and frozen at small errors.
        if abs(error) >= board.integral_band and not (unclamped - allowed) * gain > 0.0:
            limit = board.integral_limit
            board.integral = max(min(board.integral + gain, limit), -limit)
        current[j] = (allowed - emf) / board.resistance
        board.current_sum += current[j]
        voltage[j] = allowed


class MotorBoards(Resumable):
    """The 17 boards at once. Arrays are (17,), in joint order.

    Eq. 1 of the paper, u = Kp eps + Kd d(eps)/dt, with an integral part and a dead band that may be zero, run at the
    board's own rate with a low-passed derivative. The voltage is bounded by the supply and by what keeps the current
    |u - Ke w| / R within stiffness * limit: stiffness scales the current limit (NAOqi 2.8, "Actuator and sensor
    names"), so at stiffness 0 the motor turns freely. The board sets a duty cycle: its gains grow with the supply.

    Attributes:
        boards: Constants and state of each.
        current: Motor current of the last update [A], signed.
        saturated: Whether a bound was met since :meth:`begin_cycle`.
        stiffness: K = kp N Kt / R [N m/rad] at the reference temperature and voltage, of the torque that reaches the
            joint.
        torque_limit: Torque that the motor board can hold [N m], in the same order.
    """

    STATE = ("boards", "current", "saturated")

    def __init__(self, robot: RobotConfig, plant: PlantConfig) -> None:
        names, board, step = robot.joint_names, plant.board, plant.physics.timestep
        n = len(names)
        ratio = np.array([robot.motors.joints[name].ratio for name in names])
        constant = np.array([robot.motors.of(name).torque_constant for name in names])
        resistance = np.array([robot.motors.of(name).resistance for name in names])
        torque_constant = constant * ratio  # [N m/A] at the joint
        kp, self._current_limit = (
            plant.per_joint("kp", robot),
            plant.per_joint("current_limit", robot),
        )
        count = 2 * np.pi / 2**board.encoder_bits
        derivative_gain = 1.0 - np.exp(-step / board.derivative_time)
        self._nominal_voltage = board.voltage
        self._resistance_when_new, self._back_emf_when_new = resistance, torque_constant
        self.boards = make_records(
            Board,
            n,
            kp=kp,
            # Exact on a ramp, at any step.
            kd_step=plant.per_joint("kd", robot) * (derivative_gain / step),
            ki_step=plant.per_joint("ki", robot) * step,
            derivative_gain=derivative_gain,
            dead_band=plant.per_joint("dead_band", robot),
            integral_band=board.integral_band,
            integral_limit=board.integral_limit,
            count=count,
            counts_per_radian=1.0 / count,
        )
        reaching = plant.per_joint("efficiency", robot) * torque_constant
        self.stiffness = kp * reaching / resistance
        held = np.minimum(self._current_limit, board.voltage / resistance)
        self.torque_limit = reaching * held
        self._voltage, self.current = np.empty(n), np.zeros(n)
        self.saturated = np.zeros(n, dtype=np.bool_)
        self._begin, self._update = begin_board_cycle.load(), update_boards.load()
        self.warm(np.ones(n), np.ones(n))
        self.begin_cycle(np.ones(n), board.voltage)

    def reset(self) -> None:
        """Forget the past, as when switched on with no error."""
        for name in ("smoothed", "integral", "current_sum"):
            self.boards[name] = 0.0
        self.current[:] = 0.0
        self.saturated[:] = False

    def warm(self, copper: FloatArray, magnet: FloatArray) -> None:
        """Set the factors (17,) on the resistance of the windings and on the torque constant."""
        resistance = self._resistance_when_new * copper
        self.boards["resistance"] = resistance
        self.boards["back_emf"] = self._back_emf_when_new * magnet
        self.boards["full_drop"] = resistance * self._current_limit

    def begin_cycle(self, stiffness: FloatArray, supply: float) -> None:
        """Set the parameters of the next updates, none of which has met a bound.

        Args:
            stiffness: (17,) 0..1.
            supply: Voltage of the battery [V].
        """
        self._begin(self.boards, stiffness, supply, supply / self._nominal_voltage)
        self.saturated[:] = False

    def update(self, target: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Voltages [V] for one step of the board; the array is overwritten by the next call.

        Args:
            target: Commanded joint position [rad].
            position: Link-side position [rad]; the board sees it through its encoder.
            velocity: Motor speed, at the joint [rad/s].
        """
        voltage = self._voltage
        self._update(self.boards, target, position, velocity, voltage, self.current, self.saturated)
        return voltage

    def mean_current(self, steps: int) -> FloatArray:
        """Return (17,) the size of the mean current of the ``steps`` since :meth:`begin_cycle` [A]."""
        mean: FloatArray = np.abs(self.boards["current_sum"]) / steps
        return mean
