"""The motor boards: a law on the link encoder that sets a duty cycle, and a current limit scaled by the stiffness."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray


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
        torque_limit: What the board can hold [N m], likewise.
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
        """Settings for the updates to come, none of which has met a bound.

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
        # A board that may draw no current lets go of what it has summed up.
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
        if self._has_integral:  # it goes no further into a bound, and stands still at small errors
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
