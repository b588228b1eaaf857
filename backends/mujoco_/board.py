"""The motor boards: a PD law on the link encoder that sets a voltage, and a current limit scaled by the stiffness."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.parts import FloatArray


class MotorBoards:
    """The 17 boards at once. Arrays are (17,), in joint order.

    Eq. 1 of the paper, u = Kp eps + Kd d(eps)/dt, run at the board's own rate with a low-passed derivative. The
    voltage is bounded by the battery and by what keeps the current |u - Ke w| / R within stiffness * limit: stiffness
    scales the current limit (NAOqi 2.8, "Actuator and sensor names"), so at stiffness 0 the motor turns freely.

    Attributes:
        current: Motor current of the last update [A], signed.
        saturated: Whether a bound was met since :meth:`begin_cycle`.
    """

    def __init__(self, robot: RobotConfig, plant: PlantConfig) -> None:
        names = robot.joint_names
        ratio = np.array([robot.motors.joints[name].ratio for name in names])
        constant = np.array([robot.motors.of(name).torque_constant for name in names])
        self._resistance = np.array([robot.motors.of(name).resistance for name in names])
        self._back_emf = constant * ratio  # [V s/rad] at the joint
        self._kp = plant.per_joint("kp", robot)
        self._kd = plant.per_joint("kd", robot)
        self._current_limit = plant.per_joint("current_limit", robot)
        self._voltage = plant.board.voltage
        self._count = 2 * np.pi / 2**plant.board.encoder_bits
        self._derivative_time = plant.board.derivative_time
        self._derivative_gain = 1.0 - np.exp(-plant.physics.timestep / plant.board.derivative_time)
        torque_constant = constant * ratio  # [N m/A] at the joint
        self.stiffness = self._kp * torque_constant / self._resistance
        held = np.minimum(self._current_limit, self._voltage / self._resistance)
        self.torque_limit = torque_constant * held
        self._smoothed = np.zeros(len(names))
        self.current = np.zeros(len(names))
        self.saturated = np.zeros(len(names), dtype=np.bool_)

    def reset(self) -> None:
        """Forget the past, as when switched on with no error."""
        self._smoothed[:] = 0.0
        self.current[:] = 0.0
        self.saturated[:] = False

    def begin_cycle(self) -> None:
        """Forget whether a bound was met."""
        self.saturated[:] = False

    def update(
        self, target: FloatArray, position: FloatArray, velocity: FloatArray, stiffness: FloatArray
    ) -> FloatArray:
        """Voltages [V] for one step of the board.

        Args:
            target: Commanded joint position [rad].
            position: Link-side position [rad]; the board sees it through its encoder.
            velocity: Motor speed, at the joint [rad/s].
            stiffness: 0..1.
        """
        error = target - np.rint(position / self._count) * self._count
        change = error - self._smoothed
        wanted = self._kp * error + self._kd / self._derivative_time * change
        self._smoothed += self._derivative_gain * change
        back_emf = self._back_emf * velocity
        drop = self._resistance * self._current_limit * stiffness
        voltage: FloatArray = np.minimum(np.maximum(wanted, back_emf - drop), back_emf + drop)
        np.minimum(voltage, self._voltage, out=voltage)
        np.maximum(voltage, -self._voltage, out=voltage)
        self.saturated |= voltage != wanted
        self.current = (voltage - back_emf) / self._resistance
        return voltage
