"""What the services of the stand-in may do with the robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from pepper_driver.backends.naoqi_server.black_box import BlackBox
from pepper_driver.backends.naoqi_server.dcm import TimedCommand, UpdateType


class Robot(Protocol):
    """The robot, seen from another process. Safe to use from several threads."""

    @property
    def keys(self) -> Mapping[str, int]:
        """Full key of each value ("Device/SubDeviceList/HeadYaw/Position/Sensor/Value", "DCM/Time"), to its place."""

    @property
    def actuators(self) -> frozenset[str]:
        """Those among the keys that :meth:`order` takes."""

    @property
    def info(self) -> Mapping[str, Any]:
        """What the robot says of itself: ``identity``, ``plant``, ``links``, ``posture``, ..."""

    def values(self) -> list[float]:
        """Newest values of all keys, of one cycle, in the order of ``keys``."""

    def value(self, key: str) -> float:
        """Newest value of one key."""

    def time(self) -> int:
        """The DCM's time now [ms], 32 bits with a sign."""

    def order(
        self,
        actuators: Sequence[str],
        update: UpdateType,
        commands: Sequence[Sequence[TimedCommand]],
    ) -> None:
        """Give the DCM timed commands (value, DCM time), a sequence for each actuator; taken when this returns.

        Raises:
            BackendError: A buffer is full, or the robot does not answer.
        """

    def push(self, **arguments: object) -> None:
        """Push a link; arguments of :meth:`Backend.push`.

        Raises:
            BackendError: Not possible, for the reason given.
        """

    def grab(self, **arguments: object) -> None:
        """Take a link in a springy hand; arguments of :meth:`Backend.grab`.

        Raises:
            BackendError: Not possible, for the reason given.
        """

    def set_fault(self, name: str, **arguments: object) -> None:
        """Let something be wrong with the robot, or change how.

        Raises:
            BackendError: No such fault, or its arguments make no sense.
        """

    def clear_faults(self) -> None:
        """End all faults that can end."""

    def black_box(self, last: int | None = None) -> BlackBox:
        """What the robot really did in the last cycles; all that is kept, or that many."""
