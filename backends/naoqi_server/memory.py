"""What ALMemory holds: the robot's values, which change every cycle, and whatever anybody puts beside them."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from threading import RLock
from typing import Any, Literal, TypeAlias

from pepper_driver.backends.naoqi_server.clock import wrapped
from pepper_driver.backends.naoqi_server.robot import Robot

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
        """The value of a key.

        Raises:
            NoDataError: There is none.
        """
        if key in self._robot.keys:
            value = self._robot.value(key)
            return int(value) if key == self._time_key else value
        return self._entry(key).value

    def get_list(self, keys: Sequence[str]) -> list[Value]:
        """Values of several keys, the robot's all of one cycle; None where there is none."""
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
        """When the value was written, by the robot's clock [s since 1970].

        Raises:
            NoDataError: There is none.
        """
        if key not in self._robot.keys:
            return self._entry(key).stamp
        age = wrapped(self._robot.time() - int(self._robot.value(self._time_key)))
        return time.time() - 0.001 * age

    def names(self, *, part: str = "", kind: Kind | None = None) -> list[str]:
        """Keys that hold ``part`` in their name and are of this kind, sorted."""
        with self._lock:
            own = [k for k, entry in self._data.items() if kind in (None, entry.kind)]
        robots = [] if kind in ("Event", "MicroEvent") else list(self._robot.keys)
        return sorted(key for key in (*robots, *own) if part in key)

    def kind(self, key: str) -> Kind:
        """Whether a key is data or an event.

        Raises:
            NoDataError: There is none.
        """
        return "Data" if key in self._robot.keys else self._entry(key).kind

    def insert(self, key: str, value: Value) -> None:
        """Put a value in; those who wait for an event of this name are not told."""
        with self._lock:
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
        """Keep the value, and tell it everybody who listens to this name."""
        with self._lock:
            self._data[name] = _Entry(value, time.time(), kind)
            listeners = list(self._listeners.get(name, ()))
        for listener in listeners:
            listener(value)

    def remove(self, key: str) -> None:
        """Forget a key.

        Raises:
            NoDataError: There is none.
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
