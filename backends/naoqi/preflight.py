"""What a robot is asked before anything is done with it: whether it is a Pepper, and complete."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.connection import Connection, MissingServiceError, ServiceError
from pepper_driver.config import RobotConfig

PEPPER = ("pepper", "juliette")
"""What a Pepper calls its type, in small letters; Juliette was its first name."""

TYPE_KEY = "RobotConfig/Body/Type"
BODY_KEY = "Device/DeviceList/ChestBoard/BodyId"


class UnfitError(BackendError):
    """The robot cannot or should not be used as it is; the message says why, and what to do."""


@dataclass(frozen=True, kw_only=True)
class Preflight:
    """What was found at ``open``.

    Attributes:
        version: Of NAOqi, such as ``"2.5.10.7"``; ``"?"`` where it does not say.
        body_id: Serial number of the robot; ``"?"`` where it does not say.
    """

    version: str
    body_id: str


def preflight(
    connection: Connection, robot: RobotConfig, keys: Sequence[str], *, need_dcm: bool = True
) -> Preflight:
    """Ask the robot what it is, and read all ``keys`` of its memory once. Nothing moves.

    Args:
        connection: With it.
        robot: What it should be.
        keys: Of its memory, all of which must be there and be numbers.
        need_dcm: Whether to refuse a robot whose DCM cannot be reached.

    Raises:
        UnfitError: No Pepper, no DCM, or a key that is not there.
    """
    uri = connection.address.uri
    kind = _text(connection, TYPE_KEY) or _answer(connection, "ALRobotModel", "getRobotType")
    if kind.lower() not in PEPPER:
        what = f"is a '{kind}'" if kind else "does not say what robot it is"
        raise UnfitError(
            f"'{uri}': {connection.address.host} {what}, and not a Pepper; check the address"
        )
    version = _answer(connection, "ALSystem", "systemVersion") or "?"
    if need_dcm and "DCM" not in connection.service_names:
        raise UnfitError(
            f"'{uri}': this robot (NAOqi {version}) has no DCM, so its joints cannot be commanded every "
            f"{robot.cycle * 1000:g} ms; with ?mode=angles it moves through ALMotion, slower, and touch is not felt"
        )
    values = connection.call("ALMemory", "getListData", list(keys))
    missing = [key for key, value in zip(keys, values, strict=True) if not is_number(value)]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise UnfitError(
            f"'{uri}': this robot (NAOqi {version}) has no value for {', '.join(missing[:3])}{more}; with "
            "NAOqi 2.5 a board is disconnected: restart the robot, or have it repaired"
        )
    return Preflight(version=version, body_id=_text(connection, BODY_KEY) or "?")


def is_number(value: object) -> bool:
    """Whether a value of the robot's memory is one; what is not there, or broken, is None."""
    return isinstance(value, int | float) and math.isfinite(value)


def _text(connection: Connection, key: str) -> str:
    """A text in the memory; empty where there is none."""
    return _answer(connection, "ALMemory", "getData", key)


def _answer(connection: Connection, service: str, method: str, *arguments: object) -> str:
    """A text that a service gives; empty where it does not."""
    try:
        answer = connection.call(service, method, *arguments)
    except (MissingServiceError, ServiceError):
        return ""
    return answer if isinstance(answer, str) else ""
