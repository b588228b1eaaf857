"""All that a simulated robot reports of itself, once a cycle."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from pepper_driver.backends.interface import Imu, Measurement
from pepper_driver.backends.mujoco_.inertial import InertialUnit
from pepper_driver.backends.mujoco_.resumable import Resumable
from pepper_driver.backends.mujoco_.sensors import CurrentSensors, Encoders
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray


class Readings(Resumable):
    """Encoders, current sensors, inertial unit and the rest, as one :class:`Measurement`.

    Attributes:
        position: (17,) joint positions last read [rad].
    """

    STATE: ClassVar[tuple[str, ...]] = ("position", "_tick")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, simulation: Simulation) -> None:
        self._robot, self._plant, self._simulation = robot, plant, simulation
        self._imu = InertialUnit(robot, simulation.model.mj, simulation.data)
        self.begin(0)

    def begin(self, seed: int) -> Measurement:
        """The first measurement of a robot at rest, with noise of this seed to come."""
        # One stream for each kind of sensor: a change in one leaves the noise of the others as it was.
        streams = np.random.SeedSequence(seed).spawn(2)
        rngs = [np.random.Generator(np.random.PCG64(stream)) for stream in streams]
        self._encoders = Encoders(self._robot, self._plant, rngs[0])
        self._current_sensors = CurrentSensors(self._robot, self._plant, rngs[1])
        self._tick = 0
        start = self._simulation.position
        return self._measurement(
            self._encoders.reset(start), self._current_sensors.reset(), self._imu.reset()
        )

    def read(self) -> Measurement:
        """The measurement one cycle later."""
        self._tick += 1
        simulation = self._simulation
        return self._measurement(
            self._encoders.read(simulation.position),
            self._current_sensors.read(simulation.current),
            self._imu.read(),
        )

    def save(self) -> dict[str, Any]:
        """State of the sensors and their noise."""
        return {"self": super().save(), **{n: part.save() for n, part in self._parts().items()}}

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to a state that :meth:`save` gave."""
        super().restore(saved["self"])
        for name, part in self._parts().items():
            part.restore(saved[name])

    def _parts(self) -> dict[str, Resumable]:
        return {"encoders": self._encoders, "currents": self._current_sensors, "imu": self._imu}

    def _measurement(self, position: FloatArray, current: FloatArray, imu: Imu) -> Measurement:
        self.position = position
        supply, feeling = self._simulation.supply, self._simulation.contacts.touch
        return Measurement(
            time=self._tick * self._robot.cycle,
            tick=self._tick,
            position=position,
            current=current,
            wheel_speed=self._simulation.wheels.speed,
            imu=imu,
            touch=feeling.touch,
            bumpers=feeling.bumpers,
            buttons=feeling.buttons,
            temperature=np.rint(supply.temperature),
            battery=supply.charge,
            age=self._encoders.age * self._robot.cycle,
            charging_flap=0.0,
        )
