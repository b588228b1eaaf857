"""Battery and heat: what drifts over minutes. Both are brought up to date once a cycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray

COLDEST_FRICTION, WARMEST_FRICTION = 4.0, 0.25
"""Friction by temperature is linear around the reference; far from it, it stays within these factors."""


SMALLEST_FACTOR = 0.1
"""Likewise of resistance and torque constant."""


@dataclass(frozen=True, kw_only=True)
class Warmth:
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
        self._warmth: Warmth | None = None

    @property
    def voltage(self) -> float:
        """Of the battery under its load [V]."""
        battery = self._battery
        span = battery.full_voltage - battery.empty_voltage
        return max(0.0, battery.empty_voltage + span * self.charge - self._sag)

    @property
    def warmth(self) -> Warmth:
        """What the temperatures do; the same object as long as no motor is a tenth of a degree off."""
        tenths = np.rint(10.0 * self.temperature)
        if self._warmth is None or not np.array_equal(tenths, self._tenths):
            self._tenths = tenths
            above, heat = 0.1 * tenths - self._heat.reference, self._heat
            self._warmth = Warmth(
                copper=np.maximum(1.0 + heat.copper * above, SMALLEST_FACTOR),
                magnet=np.maximum(1.0 + heat.magnet * above, SMALLEST_FACTOR),
                grease=np.clip(1.0 + heat.grease * above, WARMEST_FRICTION, COLDEST_FRICTION),
            )
        return self._warmth

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to a state that :meth:`save` gave."""
        super().restore(saved)
        self._warmth = None

    def step(self, current: FloatArray, power: float) -> None:
        """One cycle later. Temperature and charge change over minutes: a sample a cycle is enough.

        Args:
            current: (17,) of the motors at the end of the cycle [A].
            power: What the motors of the joints then took from the battery [W]; what they gave back counts as none.
                The wheels' share is small beside ``idle_power``, and counted there.
        """
        battery, heat = self._battery, self._heat
        loss = self._resistance * self.warmth.copper * np.square(current)
        settled = heat.ambient + self._rise * loss
        self.temperature += (settled - self.temperature) * (self._cycle / heat.time_constant)
        power += battery.idle_power
        self.charge = max(0.0, self.charge - power * self._cycle / battery.energy)
        self._sag = battery.resistance * power / (self.voltage + self._sag)
