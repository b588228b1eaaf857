"""Battery and heat: what drifts over minutes. Both are brought up to date once a cycle."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.parts import FloatArray

COLDEST_FRICTION, WARMEST_FRICTION = 4.0, 0.25
"""Friction by temperature is linear around the reference; far from it, it stays within these factors."""


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
        self.reset()

    def reset(self) -> None:
        """Battery and motors as at the start."""
        self.charge = self._battery.charge
        self.temperature = np.full(len(self._rise), self._heat.start)
        self._sag = 0.0

    @property
    def voltage(self) -> float:
        """Of the battery under its load [V]."""
        battery = self._battery
        span = battery.full_voltage - battery.empty_voltage
        return battery.empty_voltage + span * self.charge - self._sag

    @property
    def copper(self) -> FloatArray:
        """(17,) factor on the resistance of the windings."""
        factor = 1.0 + self._heat.copper * self._above
        return np.maximum(factor, 0.1)

    @property
    def magnet(self) -> FloatArray:
        """(17,) factor on the torque constant."""
        factor = 1.0 + self._heat.magnet * self._above
        return np.maximum(factor, 0.1)

    @property
    def grease(self) -> FloatArray:
        """(17,) factor on all friction."""
        factor = 1.0 + self._heat.grease * self._above
        return np.clip(factor, WARMEST_FRICTION, COLDEST_FRICTION)

    @property
    def _above(self) -> FloatArray:
        return self.temperature - self._heat.reference

    def step(self, current: FloatArray, power: float) -> None:
        """One cycle later. Temperature and charge change over minutes: a sample a cycle is enough.

        Args:
            current: (17,) of the motors at the end of the cycle [A].
            power: What the motors of the joints then took from the battery [W]; what they gave back counts as none.
                The wheels' share is small beside ``idle_power``, and counted there.
        """
        battery, heat = self._battery, self._heat
        loss = self._resistance * self.copper * np.square(current)
        settled = heat.ambient + self._rise * loss
        self.temperature += (settled - self.temperature) * (self._cycle / heat.time_constant)
        power += battery.idle_power
        self.charge = max(0.0, self.charge - power * self._cycle / battery.energy)
        self._sag = battery.resistance * power / (self.voltage + self._sag)
