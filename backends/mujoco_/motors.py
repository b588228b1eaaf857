"""Motors: boards and their control law, friction of gears, battery and heat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.plant_model import ArrayView, PlantModel
from pepper_driver.backends.simulated import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray


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

        mj, n = model.mj, len(model.half_gap)
        self._motor_angle = ArrayView(data.qpos, model.motor_qpos)
        self._link_angle = ArrayView(data.qpos, model.link_qpos)
        motor, link = model.motor_dof, model.link_dof
        self._velocities = ArrayView(data.qvel, motor), ArrayView(data.qvel, link)
        self._frictions = (
            ArrayView(mj.dof_frictionloss, motor),
            ArrayView(mj.dof_frictionloss, link),
        )
        self._dampings = ArrayView(mj.dof_damping, motor), ArrayView(mj.dof_damping, link)
        self._tooth_damping = ArrayView(mj.tendon_damping, model.tendon)
        self._tooth_friction = ArrayView(mj.tendon_frictionloss, model.tendon)
        # Motor's sides, then links' sides. What the gap changes is added where the teeth are apart.
        coulomb = _both_sides(each, "contact", "")
        self._cold_coulomb = coulomb, _both_sides(each, "gap", "") - coulomb
        self._viscous = _both_sides(each, "contact", "_viscous")
        self._viscous_change = _both_sides(each, "gap", "_viscous") - self._viscous
        self._relative = each("gap.relative")
        self._gear_damping = plant.per_joint("gear_damping", robot)
        self._relative_viscous = each("gap.relative_viscous")
        self._half_gap = model.half_gap
        self._excess = np.tile(each("breakaway") - 1.0, 2)
        self._inverse_stribeck = 1.0 / each("stribeck_velocity")
        self._cold_load = each("load") * plant.per_joint("gear_stiffness", robot)
        self._ripple, self._ripple_count = each("ripple"), each("ripple_count")
        # What is absent costs nothing.
        self._has_viscous_change = bool(self._viscous_change.any())
        self._has_ripple, self._has_relative = bool(self._ripple.any()), bool(self._relative.any())
        self._beyond, self._damping, self._wave = np.empty(n), np.empty(n), np.empty(n)
        self._in_gap = np.empty(n, dtype=np.bool_)
        # All of one length and type, with views made once: so NumPy takes half the time.
        self._gap, self._torque, self._factor = np.empty(2 * n), np.empty(2 * n), np.empty(2 * n)
        self._motor_gap, self._link_gap = self._gap[:n], self._gap[n:]
        self._motor_torque, self._link_torque = self._torque[:n], self._torque[n:]
        self._motor_factor, self._link_factor = self._factor[:n], self._factor[n:]
        self._zero, self._one = np.zeros(n), np.ones(2 * n)
        self.warm(np.ones(n))

    def warm(self, factor: FloatArray) -> None:
        """Scale all friction by ``factor`` (17,) from now on."""
        self._warmth = factor
        coulomb, change = self._cold_coulomb
        both = np.tile(factor, 2)
        self._coulomb, self._coulomb_change = coulomb * both, change * both
        self._load = self._cold_load * factor
        self._gear_damping_change = self._relative_viscous * factor - self._gear_damping
        self._write(self._dampings, self._viscous * both)

    def update(self) -> None:
        """Set friction and damping for the step of physics to come."""
        beyond, damping = self._beyond, self._damping
        # How far the teeth are pressed into each other [rad]; below 0 inside the gap.
        motor_angle = self._motor_angle.read()
        np.subtract(self._link_angle.read(), motor_angle, out=beyond)
        np.abs(beyond, out=beyond)
        np.subtract(beyond, self._half_gap, out=beyond)
        np.less_equal(beyond, self._zero, out=self._in_gap)
        self._motor_gap[:] = self._in_gap
        self._link_gap[:] = self._in_gap
        np.multiply(self._gear_damping_change, self._motor_gap, out=damping)
        np.add(damping, self._gear_damping, out=damping)
        self._tooth_damping.write(damping)
        self._set_coulomb(motor_angle)
        if self._has_relative:
            self._tooth_friction.write(self._relative * self._motor_gap * self._warmth)
        if self._has_viscous_change:
            viscous = self._viscous + self._viscous_change * self._gap
            self._write(self._dampings, viscous * np.tile(self._warmth, 2))

    def _set_coulomb(self, motor_angle: FloatArray) -> None:
        torque, factor, beyond, wave = self._torque, self._factor, self._beyond, self._wave
        motor, link = self._velocities
        np.multiply(motor.read(), self._inverse_stribeck, out=self._motor_factor)
        np.multiply(link.read(), self._inverse_stribeck, out=self._link_factor)
        np.multiply(factor, factor, out=factor)
        np.add(factor, self._one, out=factor)
        np.divide(self._excess, factor, out=factor)
        np.add(factor, self._one, out=factor)
        np.multiply(self._coulomb_change, self._gap, out=torque)
        np.add(torque, self._coulomb, out=torque)
        np.multiply(torque, factor, out=torque)
        if self._has_ripple:
            np.multiply(self._ripple_count, motor_angle, out=wave)
            np.cos(wave, out=wave)
            wave *= self._ripple
            wave += 1.0
            self._motor_torque *= wave
        np.maximum(beyond, self._zero, out=beyond)
        np.multiply(beyond, self._load, out=beyond)
        np.add(self._motor_torque, beyond, out=self._motor_torque)
        motor, link = self._frictions
        motor.write(self._motor_torque)
        link.write(self._link_torque)

    @staticmethod
    def _write(sides: tuple[ArrayView, ArrayView], values: FloatArray) -> None:
        for side, part in zip(sides, np.split(values, 2), strict=True):
            side.write(part)


def _both_sides(each: Callable[[str], FloatArray], case: str, suffix: str) -> FloatArray:
    """(34,) one coefficient of the motors' sides, then of the links'."""
    return np.concatenate([each(f"{case}.{side}{suffix}") for side in ("motor", "link")])


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


class Supply(Resumable):
    """Charge of the battery and temperature of the motors.

    Attributes:
        charge: 0..1.
        temperature: (17,) of the windings [deg C].
    """

    STATE = ("charge", "temperature", "_sag")

    def __init__(self, robot: RobotConfig, plant: PlantConfig) -> None:
        names = robot.joint_names
        self._cycle = robot.cycle
        self._battery, self._heat = plant.battery, plant.heat
        self._resistance = np.array([robot.motors.of(name).resistance for name in names])
        self._rise = np.array([plant.heat.rise[robot.motors.joints[name].type] for name in names])
        self._tenths = np.empty(0)
        self.reset()

    def reset(self) -> None:
        """Battery and motors as at the start."""
        self.charge = self._battery.charge
        self.temperature = np.full(len(self._rise), self._heat.start)
        self._sag = 0.0
        self._warmth: ThermalState | None = None

    @property
    def voltage(self) -> float:
        """Voltage of the battery under its load [V]."""
        battery = self._battery
        span = battery.full_voltage - battery.empty_voltage
        return max(0.0, battery.empty_voltage + span * self.charge - self._sag)

    @property
    def warmth(self) -> ThermalState:
        """Effect of the temperatures; the same object as long as no motor is a tenth of a degree off."""
        tenths = np.rint(10.0 * self.temperature)
        if self._warmth is None or not np.array_equal(tenths, self._tenths):
            self._tenths = tenths
            above, heat = 0.1 * tenths - self._heat.reference, self._heat
            self._warmth = ThermalState(
                copper=np.maximum(1.0 + heat.copper * above, SMALLEST_FACTOR),
                magnet=np.maximum(1.0 + heat.magnet * above, SMALLEST_FACTOR),
                grease=np.clip(1.0 + heat.grease * above, WARMEST_FRICTION, COLDEST_FRICTION),
            )
        return self._warmth

    def restore(self, saved: dict[str, Any]) -> None:
        """Return to a state of :meth:`save`."""
        super().restore(saved)
        self._warmth = None

    def step(self, current: FloatArray, power: float) -> None:
        """One cycle later. Temperature and charge change over minutes: a sample a cycle is enough.

        Args:
            current: (17,) of the motors at the end of the cycle [A].
            power: What the motors of the joints then took from the battery [W]; what they gave back counts as none.
                The wheels' part is small compared with ``idle_power``, and included there.
        """
        battery, heat = self._battery, self._heat
        loss = self._resistance * self.warmth.copper * np.square(current)
        settled = heat.ambient + self._rise * loss
        self.temperature += (settled - self.temperature) * (self._cycle / heat.time_constant)
        power += battery.idle_power
        self.charge = max(0.0, self.charge - power * self._cycle / battery.energy)
        self._sag = battery.resistance * power / (self.voltage + self._sag)


class MotorBoards(Resumable):
    """The 17 boards at once. Arrays are (17,), in joint order.

    Eq. 1 of the paper, u = Kp eps + Kd d(eps)/dt, with an integral part and a dead band that may be zero, run at the
    board's own rate with a low-passed derivative. The voltage is bounded by the supply and by what keeps the current
    |u - Ke w| / R within stiffness * limit: stiffness scales the current limit (NAOqi 2.8, "Actuator and sensor
    names"), so at stiffness 0 the motor turns freely. The board sets a duty cycle: its gains grow with the supply.

    Attributes:
        current: Motor current of the last update [A], signed.
        saturated: Whether a bound was met since :meth:`begin_cycle`.
        stiffness: K = kp N Kt / R [N m/rad] at the reference temperature and voltage.
        torque_limit: Torque that the motor board can hold [N m], in the same order.
    """

    STATE = ("_smoothed", "_integral", "current", "saturated")

    def __init__(self, robot: RobotConfig, plant: PlantConfig) -> None:
        names = robot.joint_names
        ratio = np.array([robot.motors.joints[name].ratio for name in names])
        constant = np.array([robot.motors.of(name).torque_constant for name in names])
        resistance = np.array([robot.motors.of(name).resistance for name in names])
        step = plant.physics.timestep
        board = plant.board
        self._kp = plant.per_joint("kp", robot)
        self._ki_step = plant.per_joint("ki", robot) * step
        self._dead_band = plant.per_joint("dead_band", robot)
        self._current_limit = plant.per_joint("current_limit", robot)
        self._nominal_voltage = board.voltage
        # Arrays where a number would do: NumPy takes them in half the time.
        self._minus_count = np.full(len(names), -2 * np.pi / 2**board.encoder_bits)
        self._counts_per_radian = -1.0 / self._minus_count
        self._derivative_gain = 1.0 - np.exp(-step / board.derivative_time)
        kd = plant.per_joint("kd", robot)
        self._kd_step = kd * (self._derivative_gain / step)  # exact on a ramp, at any step
        self._integral_limit, self._integral_band = board.integral_limit, board.integral_band
        self._has_integral = bool(self._ki_step.any())
        self._has_dead_band = bool(self._dead_band.any())
        self._minus_dead_band = -self._dead_band
        torque_constant = constant * ratio  # [N m/A] at the joint
        self._resistance_when_new, self._back_emf_when_new = resistance, torque_constant
        self.stiffness = self._kp * torque_constant / resistance
        held = np.minimum(self._current_limit, board.voltage / resistance)
        self.torque_limit = torque_constant * held
        n = len(names)
        self._smoothed, self._integral = np.zeros(n), np.zeros(n)
        self._error, self._change, self._wanted = np.empty(n), np.empty(n), np.empty(n)
        self._emf, self._bound, self._voltage = np.empty(n), np.empty(n), np.empty(n)
        self._differs = np.empty(n, dtype=np.bool_)
        self.current = np.zeros(n)
        self.saturated = np.zeros(n, dtype=np.bool_)
        self.warm(np.ones(n), np.ones(n))
        self.begin_cycle(np.ones(n), board.voltage)

    def reset(self) -> None:
        """Forget the past, as when switched on with no error."""
        self._smoothed[:] = 0.0
        self._integral[:] = 0.0
        self.current[:] = 0.0
        self.saturated[:] = False

    def warm(self, copper: FloatArray, magnet: FloatArray) -> None:
        """Set the factors (17,) on the resistance of the windings and on the torque constant."""
        self._resistance = self._resistance_when_new * copper
        self._back_emf = self._back_emf_when_new * magnet
        self._full_drop = self._resistance * self._current_limit

    def begin_cycle(self, stiffness: FloatArray, supply: float) -> None:
        """Set the parameters of the next updates, none of which has met a bound.

        Args:
            stiffness: (17,) 0..1.
            supply: Voltage of the battery [V].
        """
        duty = supply / self._nominal_voltage
        self._proportional = self._kp * duty
        self._derivative = self._kd_step * duty
        self._integral_step = self._ki_step * duty
        self._supply = np.full(len(stiffness), supply)
        self._minus_supply = -self._supply
        self._drop = self._full_drop * stiffness
        # A motor board without current clears its integral.
        self._integral *= stiffness > 0.0
        self.saturated[:] = False

    def update(self, target: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Voltages [V] for one step of the board; the array is overwritten by the next call.

        Args:
            target: Commanded joint position [rad].
            position: Link-side position [rad]; the board sees it through its encoder.
            velocity: Motor speed, at the joint [rad/s].
        """
        error, change, wanted = self._error, self._change, self._wanted
        np.multiply(position, self._counts_per_radian, out=error)
        np.rint(error, out=error)
        error *= self._minus_count
        error += target
        np.subtract(error, self._smoothed, out=change)
        np.multiply(self._derivative, change, out=wanted)
        change *= self._derivative_gain
        self._smoothed += change
        if self._has_dead_band:
            # What the proportional and the integral part see; the derivative damps inside the band too.
            np.maximum(error, self._minus_dead_band, out=change)
            np.minimum(change, self._dead_band, out=change)
            error -= change
        np.multiply(self._proportional, error, out=change)
        wanted += change
        if self._has_integral:
            wanted += self._integral
        emf, bound, voltage = self._emf, self._bound, self._voltage
        np.multiply(self._back_emf, velocity, out=emf)
        np.subtract(emf, self._drop, out=bound)
        np.maximum(wanted, bound, out=voltage)
        np.add(emf, self._drop, out=bound)
        np.minimum(voltage, bound, out=voltage)
        np.minimum(voltage, self._supply, out=voltage)
        np.maximum(voltage, self._minus_supply, out=voltage)
        np.not_equal(voltage, wanted, out=self._differs)
        self.saturated |= self._differs
        if self._has_integral:  # clamped at a bound, and frozen at small errors
            np.multiply(self._integral_step, error, out=change)
            change[np.abs(error) < self._integral_band] = 0.0
            np.subtract(wanted, voltage, out=wanted)  # by how much a bound cut the voltage
            change[wanted * change > 0.0] = 0.0
            self._integral += change
            np.minimum(self._integral, self._integral_limit, out=self._integral)
            np.maximum(self._integral, -self._integral_limit, out=self._integral)
        np.subtract(voltage, emf, out=self.current)
        self.current /= self._resistance
        return voltage
