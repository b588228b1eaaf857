"""Between the plant and its reader: readings quantised, noisy and late, commands on their way."""

from __future__ import annotations

from collections import deque

import numpy as np

from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray


class Encoders(Resumable):
    """Joint encoders: noise, 12-bit counts, a delay of whole cycles, and samples that come late.

    Attributes:
        age: How many cycles the last reading is older than the delay that is always there.
    """

    STATE = ("age", "_delayed", "_read", "_rng")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, rng: np.random.Generator) -> None:
        transport = plant.transport
        self._step = robot.sensors.encoder.step
        self._noise = transport.encoder_noise
        self._late = transport.late if transport.longest_late else 0.0
        self._longest_late = transport.longest_late
        self._rng = rng
        self._delayed: deque[FloatArray] = deque(maxlen=transport.encoder_delay + 1)

    def reset(self, position: FloatArray) -> FloatArray:
        """Fill the delay line as if the robot had stood at ``position`` (17,) [rad]; returns the first reading."""
        for _ in range(self._delayed.maxlen or 1):
            self._delayed.append(self._count(position))
        self.age = 0
        self._read = self._delayed[0]
        return self._read

    def read(self, position: FloatArray) -> FloatArray:
        """One cycle later: sample ``position`` (17,) [rad], return the sample that arrives now."""
        self._delayed.append(self._count(position))
        if self._late and self.age < self._longest_late and self._rng.random() < self._late:
            self.age += 1
        else:
            self.age = 0
            self._read = self._delayed[0]
        return self._read

    def _count(self, position: FloatArray) -> FloatArray:
        noisy = position + self._noise * self._rng.standard_normal(position.shape)
        return np.rint(noisy / self._step) * self._step


class CurrentSensors(Resumable):
    """Absolute motor current, low-passed, with noise, in steps of the converter."""

    STATE = ("_smoothed", "_rng")

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

    def read(self, current: FloatArray) -> FloatArray:
        """Take in the size of the mean current (17,) of one cycle [A]; returns the reading."""
        self._smoothed += self._gain * (current - self._smoothed)
        return self._quantised()

    def _quantised(self) -> FloatArray:
        noisy = self._smoothed + self._noise * self._rng.standard_normal(self._smoothed.shape)
        return np.asarray(np.rint(np.abs(noisy) / self._step) * self._step)


class CommandLine(Resumable):
    """Commands on their way to the boards: each acts whole cycles after it was sent."""

    STATE = ("_delayed",)

    def __init__(self, plant: PlantConfig) -> None:
        self._delayed: deque[FloatArray] = deque(maxlen=plant.transport.command_delay + 1)

    def reset(self, position: FloatArray) -> None:
        """Fill the line with ``position`` (17,) [rad]."""
        for _ in range(self._delayed.maxlen or 1):
            self._delayed.append(position.copy())

    def send(self, position: FloatArray) -> FloatArray:
        """Send ``position`` (17,) [rad]; returns the command that reaches the boards now."""
        self._delayed.append(position)
        return self._delayed[0]
