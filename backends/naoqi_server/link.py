"""The robot as other processes see it: they read the table and send requests."""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping, Sequence
from itertools import count
from threading import Lock
from typing import Any

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.black_box import BlackBox
from pepper_driver.backends.naoqi_server.dcm import TimedCommand, UpdateType
from pepper_driver.backends.naoqi_server.messages import PACKET, receive, send
from pepper_driver.backends.naoqi_server.table import Table

_MOST_COMMANDS = PACKET // 64
"""In one packet; a longer order is given in parts."""


class RobotLink:
    """A :class:`~.robot.Robot` over a table and a socket."""

    def __init__(
        self, table: Table, end: socket.socket, keys: Mapping[str, int], actuators: frozenset[str]
    ) -> None:
        self._table, self._end = table, end
        self._keys, self._actuators = keys, actuators
        self._lock = Lock()
        self._numbers = count(time.monotonic_ns())  # no other process had them
        end.settimeout(REPLY_TIMEOUT)

    @property
    def keys(self) -> Mapping[str, int]:
        """Full key of each value, to its place."""
        return self._keys

    @property
    def actuators(self) -> frozenset[str]:
        """Keys that :meth:`order` takes."""
        return self._actuators

    @property
    def info(self) -> dict[str, Any]:
        """What the robot says of itself."""
        return self._table.info

    def values(self) -> list[float]:
        """Newest values of all keys, of one cycle."""
        values: list[float] = self._table.read().tolist()
        return values

    def value(self, key: str) -> float:
        """Newest value of one key."""
        return float(self._table.read()[self._keys[key]])

    def time(self) -> int:
        """The DCM's time now [ms], 32 bits with a sign."""
        return self._table.clock.shown

    def order(
        self,
        actuators: Sequence[str],
        update: UpdateType,
        commands: Sequence[Sequence[TimedCommand]],
    ) -> None:
        """Give the DCM timed commands; see :meth:`Robot.order`."""
        parts: list[tuple[list[str], list[Sequence[TimedCommand]]]] = [([], [])]
        size = 0
        for actuator, its in zip(actuators, commands, strict=True):
            if size + len(its) > _MOST_COMMANDS and parts[-1][0]:
                parts.append(([], []))
                size = 0
            parts[-1][0].append(actuator)
            parts[-1][1].append(its)
            size += len(its)
        for keys, lists in parts:
            self.ask("order", actuators=keys, update=update, commands=lists)

    def push(self, **arguments: object) -> None:
        """Push a link; see :meth:`Robot.push`."""
        self.ask("push", **arguments)

    def grab(self, **arguments: object) -> None:
        """Take a link in a springy hand; see :meth:`Robot.grab`."""
        self.ask("grab", **arguments)

    def set_fault(self, name: str, **arguments: object) -> None:
        """Let something be wrong with the robot; see :meth:`Robot.set_fault`."""
        self.ask("set_fault", name=name, arguments=arguments)

    def clear_faults(self) -> None:
        """End all faults that can end."""
        self.ask("clear_faults")

    def black_box(self, last: int | None = None) -> BlackBox:
        """What the robot really did in the last cycles."""
        return self._table.black_box(last)

    def ask(self, what: str, **arguments: object) -> None:
        """Send one request and wait until the robot process took it.

        Raises:
            BackendError: It refuses, for the reason given, or does not answer.
        """
        with self._lock:
            number = next(self._numbers)
            try:
                send(self._end, {"number": number, "ask": what, "arguments": arguments})
                answer = receive(self._end)
                while answer is not None and answer["number"] != number:
                    answer = receive(self._end)  # to a request of a process that died meanwhile
            except OSError as error:
                reason = "does not answer" if isinstance(error, TimeoutError) else "has ended"
                raise BackendError(f"the stand-in's robot process {reason}") from error
        if answer is None:
            raise BackendError("the stand-in's robot process has ended")
        if "error" in answer:
            raise BackendError(str(answer["error"]))
