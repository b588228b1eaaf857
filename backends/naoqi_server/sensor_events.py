"""Events of touch sensors, bumpers and the chest button, raised when the robot's sensors change."""

from __future__ import annotations

import time
from threading import Thread

import numpy as np

from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.config.naoqi_devices import NaoqiDevices

PERIOD = 0.012
"""[s] between two looks: that of the sensors."""

CLICKS = (
    "ALChestButton/SimpleClickOccurred",
    "ALChestButton/DoubleClickOccurred",
    "ALChestButton/TripleClickOccurred",
)

CLICK_GAP = 0.5
"""[s] after which the next click is a new one. ASSUMED."""

BUTTON = "ChestButtonPressed"


class SensorEvents:
    """Looks at the sensors on a thread of its own.

    Attributes:
        on: Whether events are raised. On a robot the module ALTouch raises them, and can be ended.
    """

    def __init__(self, robot: Robot, memory: Memory, devices: NaoqiDevices) -> None:
        self._robot, self._memory = robot, memory
        self._events = devices.events
        self._places = np.array([robot.keys[key] for key, _ in devices.events.values()])
        self._last = [0.0] * len(self._places)
        self._clicks, self._released = 0, 0.0
        self.on = True
        for name in self._events:
            memory.raise_event(name, 0.0)
        for name in ("TouchChanged", *CLICKS):
            memory.declare(name)

    @property
    def touched(self) -> dict[str, bool]:
        """Whether each sensor is touched, by its name in ``TouchChanged``."""
        names = (touch for _, touch in self._events.values())
        return dict(zip(names, (value > 0.0 for value in self._last), strict=True))

    def start(self) -> None:
        """Begin to look, until the process ends."""
        Thread(target=self._run, name="sensor events", daemon=True).start()

    def _run(self) -> None:
        while True:
            time.sleep(PERIOD)
            if self.on:
                self.look(time.monotonic())

    def look(self, now: float) -> None:
        """Raise what changed since the last look; ``now`` [s] is told for the clicks."""
        values = self._robot.values()
        new = [values[place] for place in self._places]
        changed = []
        for (name, (_, touch)), before, value in zip(
            self._events.items(), self._last, new, strict=True
        ):
            if value != before:
                self._memory.raise_event(name, value)
                changed.append([touch, value > 0.0])
                if name == BUTTON and value == 0.0:
                    self._clicks, self._released = self._clicks + 1, now
        self._last = new
        if changed:
            self._memory.raise_event("TouchChanged", changed)
        if self._clicks and now - self._released > CLICK_GAP:
            self._memory.raise_event(CLICKS[min(self._clicks, len(CLICKS)) - 1], 1.0)
            self._clicks = 0
