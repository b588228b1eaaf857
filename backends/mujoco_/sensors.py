"""From the state of the plant to what NAOqi would report: quantised, noisy, late."""

from __future__ import annotations

from collections import deque

import numpy as np

from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.parts import FloatArray


class Encoders:
    """Joint encoders: noise, 12-bit counts, and a delay of whole cycles."""

    def __init__(self, robot: RobotConfig, plant: PlantConfig, rng: np.random.Generator) -> None:
        self._step = robot.sensors.encoder.step
        self._noise = plant.transport.encoder_noise
        self._rng = rng
        self._delayed: deque[FloatArray] = deque(maxlen=plant.transport.encoder_delay + 1)

    def reset(self, position: FloatArray) -> FloatArray:
        """Fill the delay line as if the robot had stood at ``position`` (17,) [rad]; returns the first reading."""
        for _ in range(self._delayed.maxlen or 1):
            self._delayed.append(self._count(position))
        return self._delayed[0]

    def read(self, position: FloatArray) -> FloatArray:
        """One cycle later: sample ``position`` (17,) [rad], return the sample that arrives now."""
        self._delayed.append(self._count(position))
        return self._delayed[0]

    def _count(self, position: FloatArray) -> FloatArray:
        noisy = position + self._noise * self._rng.standard_normal(position.shape)
        return np.rint(noisy / self._step) * self._step


class CurrentSensors:
    """Absolute motor current, low-passed, with noise, in steps of the converter."""

    def __init__(self, robot: RobotConfig, plant: PlantConfig, rng: np.random.Generator) -> None:
        self._step = robot.sensors.current.step
        self._noise = plant.transport.current_noise
        self._gain = 1.0 - float(np.exp(-robot.cycle / plant.transport.current_time))
        self._rng = rng
        self._smoothed = np.zeros(len(robot.joint_names))

    def reset(self) -> FloatArray:
        """Start from no current; returns the first reading (17,) [A]."""
        self._smoothed[:] = 0.0
        return self._quantised()

    def read(self, mean_absolute: FloatArray) -> FloatArray:
        """Take in the mean |current| (17,) of one cycle [A]; returns the reading."""
        self._smoothed += self._gain * (mean_absolute - self._smoothed)
        return self._quantised()

    def _quantised(self) -> FloatArray:
        noisy = self._smoothed + self._noise * self._rng.standard_normal(self._smoothed.shape)
        return np.asarray(np.rint(np.abs(noisy) / self._step) * self._step)


class FreeWheels:
    """Wheels of a robot on a stand: each follows its speed command with a first-order lag and rolls nowhere."""

    def __init__(self, robot: RobotConfig, plant: PlantConfig) -> None:
        self._limit = robot.wheels.speed_limit
        self._gain = 1.0 - float(np.exp(-robot.cycle / plant.transport.wheel_time))
        self.speed = np.zeros(3)

    def reset(self) -> None:
        """Stand still."""
        self.speed = np.zeros(3)

    def step(self, command: FloatArray) -> None:
        """One cycle towards ``command`` (3,) [rad/s]."""
        target = np.clip(command, -self._limit, self._limit)
        self.speed = self.speed + self._gain * (target - self.speed)
