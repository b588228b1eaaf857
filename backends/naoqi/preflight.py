"""Checks before the joints get stiff: type of robot, DCM, readiness, diagnosis.

NAOqi 2.5 and 2.8 pages "ALDiagnosis", "ALDiagnosis API", "Diagnosis effect". A summary names the devices of the gravest
level alone; a key ``Diagnosis/KIND/DEVICE/Error`` is there for each device, and not 0 where it is broken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from pepper_driver.backends.interface import BackendError, DeviceError
from pepper_driver.backends.naoqi.connection import (
    Connection,
    MissingServiceError,
    ServiceError,
)
from pepper_driver.config import NaoqiSettings, RobotConfig

CRITICAL = 2
"""Level at which NAOqi itself sends the robot to rest, whatever the device. 1 is SERIOUS, 0 NEGLIGIBLE."""

_TEXTS = {
    "Active": "failed the test that the robot makes when it wakes up",
    "Passive": "its board does not answer, or tells of an error",
    "Temperature": "too hot",
}
_MOVING = ("Brake", "Fuse", "Battery", "Inertial", "ChestBoard")
"""In names of devices without which nothing should move, beside joints and wheels."""


@dataclass
class _Finding:
    level: int | None = None
    kinds: list[str] = field(default_factory=list)


def diagnosis(connection: Connection, robot: RobotConfig) -> tuple[DeviceError, ...] | None:
    """What the robot finds broken now; None where it has no diagnosis. A few calls, so not for the tick.

    Raises:
        NotConnectedError: The connection is lost.
        CallTimeoutError: The robot does not answer.
    """
    found: dict[str, _Finding] = {}
    summaries = [_summary(connection, kind, found) for kind in ("Passive", "Active")]
    keys = _keys(connection, found)
    if not any(summaries) and not keys:
        return None
    moving = (*robot.joint_names, *robot.wheels.names, *_MOVING)
    return tuple(
        DeviceError(
            device=device,
            text="; ".join(_TEXTS.get(kind, kind) for kind in finding.kinds),
            serious=finding.level == CRITICAL
            or (finding.level != 0 and any(name in device for name in moving)),
        )
        for device, finding in sorted(found.items())
    )


def _summary(connection: Connection, kind: str, found: dict[str, _Finding]) -> bool:
    """Take in ``[level, [devices]]``, or an empty list; False where the robot gives none."""
    try:
        answer = connection.call("ALDiagnosis", f"get{kind}Diagnosis")
    except (MissingServiceError, ServiceError):
        return False
    if isinstance(answer, list | tuple) and len(answer) == 2 and isinstance(answer[0], int):
        level, devices = answer
        for device in devices:
            finding = found.setdefault(str(device), _Finding())
            finding.level = max(level, finding.level or 0)
            finding.kinds.append(kind)
    return True


def _keys(connection: Connection, found: dict[str, _Finding]) -> bool:
    """Take in the keys; False where there are none."""
    try:
        listed = connection.call("ALMemory", "getDataList", "Diagnosis/")
        names = [
            name for name in listed if name.startswith("Diagnosis/") and name.endswith("/Error")
        ]
        values = connection.call("ALMemory", "getListData", names)
    except (MissingServiceError, ServiceError):
        return False
    for name, value in zip(names, values, strict=False):
        _, kind, *device, _ = name.split("/")
        if isinstance(value, int | float) and value != 0:
            finding = found.setdefault("/".join(device), _Finding())
            if kind not in finding.kinds:
                finding.kinds.append(kind)
    return bool(names)


def check_fit(
    connection: Connection, robot: RobotConfig, settings: NaoqiSettings, *, may_sleep: bool = False
) -> None:
    """Refuse a robot that should not move now. To be asked before ``activate`` touches anything.

    Args:
        connection: With it.
        robot: Its limits.
        settings: What it must be.
        may_sleep: Whether it is woken up after this.

    Raises:
        UnfitError: Motors off, a joint outside its limits or too hot, a low battery, an open charging flap, or a broken
            device: the first of them.
    """
    for reason in (
        _flap(connection, robot, settings),
        _battery(connection, robot, settings),
        _broken(connection, robot),
        _joints(connection, robot, settings),
        None if may_sleep else _asleep(connection),
    ):
        if reason:
            raise UnfitError(f"'{connection.address.uri}' is not activated: {reason}")


def awake(connection: Connection) -> bool:
    """Whether the motors are on: woken up, and not at rest. A robot that does not say so counts as awake."""
    try:
        return bool(connection.call("ALMotion", "robotIsWakeUp"))
    except (MissingServiceError, ServiceError):
        return True


def _asleep(connection: Connection) -> str | None:
    if awake(connection):
        return None
    return (
        "its motors are off, it is at rest; press the chest button twice to wake it up, or add ?wake=1, with room for "
        "its arms"
    )


def _flap(connection: Connection, robot: RobotConfig, settings: NaoqiSettings) -> str | None:
    (value,) = _numbers(connection, robot, [robot.naoqi.charging_flap])
    if settings.charging_flap == "stand" or not value > 0.5:
        return None
    return (
        "its charging flap is open; unplug the cable and close the flap, or set 'charging_flap: stand' in a "
        "file for ?settings= to move head and arms alone"
    )


def _battery(connection: Connection, robot: RobotConfig, settings: NaoqiSettings) -> str | None:
    (charge,) = _numbers(connection, robot, [robot.naoqi.battery_charge])
    if not charge < settings.fit.battery:
        return None
    return f"its battery is at {charge:.0%}, and {settings.fit.battery:.0%} is the least; charge it"


def _broken(connection: Connection, robot: RobotConfig) -> str | None:
    serious = [error for error in diagnosis(connection, robot) or () if error.serious]
    if not serious:
        return None
    found = "; ".join(f"{error.device}: {error.text}" for error in serious[:3])
    return (
        f"its own diagnosis finds {len(serious)} broken ({found}); restart it, let it cool down, or have it repaired; "
        "'pepper doctor' shows all"
    )


def _joints(connection: Connection, robot: RobotConfig, settings: NaoqiSettings) -> str | None:
    names, limit = robot.naoqi, settings.fit.outside
    position = _numbers(
        connection, robot, [names.position.format(joint=j) for j in robot.joint_names]
    )
    for joint, value in zip(robot.joints, position, strict=True):
        if math.isnan(value):
            return (
                f"{joint.name} tells no position; restart the robot, its board may be disconnected"
            )
        if not joint.lower - limit <= value <= joint.upper + limit:
            return (
                f"{joint.name} is at {value:.3f} rad, outside its limits {joint.lower:.3f} to {joint.upper:.3f}; move "
                "it inside by hand while the motors are off, then wake the robot up"
            )
    keys = [names.temperature_status.format(joint=joint) for joint in robot.joint_names]
    for name, status in zip(robot.joint_names, _numbers(connection, robot, keys), strict=True):
        if status > settings.fit.temperature_status:
            return f"{name} is too hot (status {status:g} of 3); let the robot rest and cool down"
    return None


def _numbers(connection: Connection, robot: RobotConfig, names: Sequence[str]) -> list[float]:
    """Values of keys behind the prefix, NaN where there is none."""
    keys = [robot.naoqi.prefix + name for name in names]
    values = connection.call("ALMemory", "getListData", keys)
    return [float(value) if is_number(value) else math.nan for value in values]


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
