"""ALMemory: data, subscribers, events of sensors."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from threading import RLock
from typing import Any, Literal, TypeAlias

import numpy as np

from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.backends.naoqi_server.ipc import Robot
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock
from pepper_driver.config.naoqi_devices import NaoqiDevices

Kind = Literal["Data", "Event", "MicroEvent"]

Value: TypeAlias = Any
"""A value as NAOqi's services take and give it: number, text, truth value, None, or a list or mapping of those."""

Listener = Callable[[Value], None]


class NoDataError(LookupError):
    """ALMemory holds nothing under this key."""


@dataclass(slots=True)
class _Entry:
    value: Value
    stamp: float
    kind: Kind


class Memory:
    """Values by key, and events. Safe to use from several threads.

    Args:
        robot: Whose values are read through. Others cannot change them: the robot overwrites them every cycle.
        time_key: The one among them that is a whole number.
        data: What is there from the start.
    """

    def __init__(self, robot: Robot, time_key: str, data: Mapping[str, Value]) -> None:
        self._robot = robot
        self._time_key = time_key
        self._data = {key: _Entry(value, time.time(), "Data") for key, value in data.items()}
        self._listeners: dict[str, list[Listener]] = defaultdict(list)
        self._lock = RLock()

    def get(self, key: str) -> Value:
        """Return the value of a key.

        Raises:
            NoDataError: The key does not exist.
        """
        if key in self._robot.keys:
            value = self._robot.value(key)
            # The table has floats only; NAOqi gives the time as a whole number.
            return int(value) if key == self._time_key else value
        return self._entry(key).value

    def get_list(self, keys: Sequence[str]) -> list[Value]:
        """Values of several keys, the robot's all of one cycle; None for unknown keys."""
        places, values = self._robot.keys, self._robot.values()
        found: list[Value] = []
        for key in keys:
            place = places.get(key)
            if place is None:
                entry = self._data.get(key)
                found.append(None if entry is None else entry.value)
            elif key == self._time_key:
                found.append(int(values[place]))
            else:
                found.append(values[place])
        return found

    def stamp(self, key: str) -> float:
        """Return the time at which the value was written, by the robot's clock [s since 1970].

        Raises:
            NoDataError: The key does not exist.
        """
        if key not in self._robot.keys:
            return self._entry(key).stamp
        # Both have 32 bits: the difference wraps, so that a roll-over has no consequence.
        age = wrapped(self._robot.time() - int(self._robot.value(self._time_key)))
        return time.time() - 0.001 * age

    def names(self, *, part: str = "", kind: Kind | None = None) -> list[str]:
        """Keys that hold ``part`` in their name and are of this kind, sorted."""
        with self._lock:
            own = [k for k, entry in self._data.items() if kind in (None, entry.kind)]
        robots = [] if kind in ("Event", "MicroEvent") else list(self._robot.keys)
        return sorted(key for key in (*robots, *own) if part in key)

    def kind(self, key: str) -> Kind:
        """Return the kind of a key: data or an event.

        Raises:
            NoDataError: The key does not exist.
        """
        return "Data" if key in self._robot.keys else self._entry(key).kind

    def insert(self, key: str, value: Value) -> None:
        """Insert a value; subscribers of an event of this name are not notified."""
        with self._lock:
            # The robot overwrites its own keys in each cycle.
            if key in self._robot.keys:
                return
            entry = self._data.get(key)
            kind: Kind = "Data" if entry is None else entry.kind
            self._data[key] = _Entry(value, time.time(), kind)

    def declare(self, name: str, kind: Kind = "Event") -> None:
        """Make an event known, without a value."""
        with self._lock:
            entry = self._data.get(name)
            self._data[name] = _Entry(None if entry is None else entry.value, time.time(), kind)

    def raise_event(self, name: str, value: Value, kind: Kind = "Event") -> None:
        """Keep the value, and send it to all subscribers of this name."""
        with self._lock:
            self._data[name] = _Entry(value, time.time(), kind)
            listeners = list(self._listeners.get(name, ()))
        # Without the lock: a listener may use ALMemory, also from another thread.
        for listener in listeners:
            listener(value)

    def remove(self, key: str) -> None:
        """Forget a key.

        Raises:
            NoDataError: The key does not exist.
        """
        with self._lock:
            self._entry(key)
            del self._data[key]

    def listen(self, name: str, listener: Listener) -> None:
        """Call ``listener`` with the value each time the event is raised, on the thread that raises it."""
        with self._lock:
            self._listeners[name].append(listener)

    def _entry(self, key: str) -> _Entry:
        try:
            return self._data[key]
        except KeyError:
            raise NoDataError(f"no data under '{key}'") from None


SENSOR_PERIOD = 0.012
"""[s] between two readings: the period of the sensors."""

CLICKS = (
    "ALChestButton/SimpleClickOccurred",
    "ALChestButton/DoubleClickOccurred",
    "ALChestButton/TripleClickOccurred",
)

CLICK_GAP = 0.5
"""[s] after which the next click is a new one. ASSUMED."""

BUTTON = "ChestButtonPressed"


class SensorEvents:
    """Reads the sensors on a thread of its own.

    Attributes:
        on: Whether events are raised. On a robot the module ALTouch raises them, and can be ended.
    """

    def __init__(
        self,
        robot: Robot,
        memory: Memory,
        devices: NaoqiDevices,
        clock: Clock = MONOTONIC_CLOCK,
    ) -> None:
        self._clock = clock
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
        """State of each sensor, true if touched, by its name in ``TouchChanged``."""
        names = (touch for _, touch in self._events.values())
        return dict(zip(names, (value > 0.0 for value in self._last), strict=True))

    def start(self) -> None:
        """Begin to read, until the process ends."""
        self._clock.start(self._run, "sensor events")

    def _run(self) -> None:
        while True:
            self._clock.sleep(SENSOR_PERIOD)
            if self.on:
                self.read_sensors(self._clock.seconds())

    def read_sensors(self, now: float) -> None:
        """Raise events of changes since the last reading; ``now`` [s] dates the clicks."""
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
