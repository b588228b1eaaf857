"""Parts of tests of contact: a robot on a fixed base that holds a posture, and worlds of one object."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pepper_driver.backends import Command, Measurement
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.config import PlantConfig, World, load_plant, load_robot
from pepper_driver.config.loading import parse

ROBOT = load_robot()
PLANT = load_plant("nominal", ROBOT)
FIXED, ROLLING = replace(PLANT, base="fixed"), replace(PLANT, base="rolling")
CYCLE = ROBOT.cycle
STEP = PLANT.physics.timestep


def world(**objects: dict[str, Any]) -> World:
    """A world of these objects."""
    return parse(World, {"name": "test", "description": "", "objects": objects}, "test.yaml")


class Robot(MujocoBackend):
    """An active robot that holds its posture."""

    def __init__(
        self, plant: PlantConfig = FIXED, world: World | None = None, posture: str = "Stand"
    ) -> None:
        super().__init__(ROBOT, plant, world=world, posture=posture)
        self.hold = np.clip(self.open().position, ROBOT.lower, ROBOT.upper)
        self.activate()

    def run(self, seconds: float) -> list[Measurement]:
        """The measurements of this time."""
        command = Command(position=self.hold, stiffness=np.ones(17), wheel_speed=np.zeros(3))
        return [self.exchange(command) for _ in range(round(seconds / CYCLE))]

    def run_slowly(self, cycles: int) -> Iterator[Measurement]:
        """The measurements of these cycles, one by one."""
        for _ in range(cycles):
            yield from self.run(CYCLE)

    @property
    def world(self) -> World:
        """The world around it."""
        return self._world

    @property
    def mujoco(self) -> tuple[Any, Any]:
        """MuJoCo's model and data."""
        return self._model.mj, self._data

    @property
    def time(self) -> float:
        """Time of the simulation [s]."""
        return float(self._data.time)
