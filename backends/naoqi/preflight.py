"""Checks before the joints get stiff: type of robot, DCM, readiness, diagnosis.

NAOqi 2.5 and 2.8 pages "ALDiagnosis", "ALDiagnosis API", "Diagnosis effect". A summary names the devices of the gravest
level alone; a key ``Diagnosis/KIND/DEVICE/Error`` is there for each device, and not 0 where it is broken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from pepper_driver.backends.interface import DeviceError
from pepper_driver.backends.naoqi.connection import (
    Connection,
    MissingServiceError,
    ServiceError,
)
from pepper_driver.backends.readiness import (
    MAX_NAMED,
    CheckResult,
    NotReadyError,
    check_battery,
    check_diagnosis,
    check_flap,
    check_limits,
    check_positions,
    named,
    rated,
    refuse_failed,
)
from pepper_driver.config import NaoqiSettings, RobotConfig, SafetySettings

CRITICAL = 2
"""Level at which NAOqi itself sends the robot to rest, for any device. 1 is SERIOUS, 0 NEGLIGIBLE."""

_TEXTS = {
    "Active": "failed the test that the robot makes when it wakes up",
    "Passive": "its board does not answer, or reports an error",
    "Temperature": "too hot",
}
_MOVING = ("Brake", "Fuse", "Battery", "Inertial", "ChestBoard")
"""Parts of names of other devices, next to joints and wheels, that must work before anything moves."""


@dataclass
class _Finding:
    level: int | None = None
    kinds: list[str] = field(default_factory=list)


def diagnosis(connection: Connection, robot: RobotConfig) -> tuple[DeviceError, ...] | None:
    """Return the parts that the robot finds broken; None without a diagnosis. A few calls, so not for the tick.

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
            # Level None: only its key reports the device, because a summary names those of the gravest level alone.
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
    """Read the keys; return False if there are none."""
    try:
        listed = connection.call("ALMemory", "getDataList", "Diagnosis/")
        names = [
            name for name in listed if name.startswith("Diagnosis/") and name.endswith("/Error")
        ]
        values = connection.call("ALMemory", "getListData", names)
    except (MissingServiceError, ServiceError):
        return False
    for name, value in zip(names, values, strict=False):
        # Names of devices may hold slashes.
        _, kind, *device, _ = name.split("/")
        if isinstance(value, int | float) and value != 0:
            finding = found.setdefault("/".join(device), _Finding())
            if kind not in finding.kinds:
                finding.kinds.append(kind)
    return bool(names)


def check_robot(
    connection: Connection,
    robot: RobotConfig,
    settings: NaoqiSettings,
    safety: SafetySettings,
    *,
    may_sleep: bool = False,
) -> None:
    """Refuse a robot that should not move now. To be asked before ``activate`` touches anything.

    Args:
        connection: With it.
        robot: Its limits.
        settings: What NAOqi must say of it.
        safety: What it must be.
        may_sleep: Whether it is woken up after this.

    Raises:
        NotReadyError: Motors off, a joint outside its limits or too hot, a low battery, an open charging flap, or a
            broken device: the first of them.
    """
    for result in _checks(connection, robot, settings, safety, may_sleep):
        refuse_failed(f"'{connection.address.uri}' is not activated", [result])


def _checks(
    connection: Connection,
    robot: RobotConfig,
    settings: NaoqiSettings,
    safety: SafetySettings,
    may_sleep: bool,
) -> Iterator[CheckResult]:
    """Make one check after the other: none asks the robot anything before the one ahead of it is well."""
    names = robot.naoqi
    (flap,) = _numbers(connection, robot, [names.charging_flap])
    yield check_flap(flap, refused=settings.charging_flap == "refuse")
    (charge,) = _numbers(connection, robot, [names.battery_charge])
    yield check_battery(charge, safety)
    serious = [error for error in diagnosis(connection, robot) or () if error.serious]
    yield check_diagnosis(serious[:MAX_NAMED])
    keys = [names.position.format(joint=joint) for joint in robot.joint_names]
    position = np.array(_numbers(connection, robot, keys))
    yield check_positions(position, robot)
    yield check_limits(position, robot, safety)
    keys = [names.temperature_status.format(joint=joint) for joint in robot.joint_names]
    status = np.array(_numbers(connection, robot, keys))
    # NaN is not above: a robot without this key is not refused for it.
    hot = status > settings.temperature_status
    yield rated(
        "motors",
        f"too hot, status {status[hot].max():g} of 3: {named(robot.joint_names, hot)}"
        if hot.any()
        else "cool",
        failure=bool(hot.any()),
        remedy="let the robot rest and cool down",
    )
    # With ?wake=1 it is woken up after these checks.
    asleep = not (may_sleep or awake(connection))
    yield rated(
        "motors",
        "off, the robot is at rest" if asleep else "on",
        failure=asleep,
        remedy="press the chest button twice to wake it up, or add ?wake=1, with room for its arms",
    )


def awake(connection: Connection) -> bool:
    """Check if the motors are on: woken up, and not at rest. A robot that does not report it counts as awake."""
    try:
        return bool(connection.call("ALMotion", "robotIsWakeUp"))
    except (MissingServiceError, ServiceError):
        return True


def _numbers(connection: Connection, robot: RobotConfig, names: Sequence[str]) -> list[float]:
    """Values of keys behind the prefix, NaN for missing ones."""
    keys = [robot.naoqi.prefix + name for name in names]
    values = connection.call("ALMemory", "getListData", keys)
    return [float(value) if is_number(value) else math.nan for value in values]


PEPPER = ("pepper", "juliette")
"""What a Pepper calls its type, in small letters; Juliette was its first name."""

TYPE_KEY = "RobotConfig/Body/Type"
BODY_KEY = "Device/DeviceList/ChestBoard/BodyId"


@dataclass(frozen=True, kw_only=True)
class Preflight:
    """Findings of ``open``.

    Attributes:
        kind: Type of the robot, such as ``"Juliette"``.
        version: Of NAOqi, such as ``"2.5.10.7"``; ``"?"`` where it does not say.
        body_id: Serial number of the robot; ``"?"`` where it does not say.
    """

    kind: str
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
        NotReadyError: No Pepper, no DCM, or a key that is not there.
    """
    uri = connection.address.uri
    kind = _text(connection, TYPE_KEY) or _answer(connection, "ALRobotModel", "getRobotType")
    if kind.lower() not in PEPPER:
        what = f"is a '{kind}'" if kind else "does not say what robot it is"
        raise NotReadyError(
            f"'{uri}': {connection.address.host} {what}, and not a Pepper; check the address"
        )
    version = _answer(connection, "ALSystem", "systemVersion") or "?"
    if need_dcm and "DCM" not in connection.service_names:
        raise NotReadyError(
            f"'{uri}': this robot (NAOqi {version}) has no DCM, so its joints cannot be commanded every "
            f"{robot.cycle * 1000:g} ms; with ?mode=angles it moves through ALMotion, slower, and touch is not detected"
        )
    values = connection.call("ALMemory", "getListData", list(keys))
    # ALMemory replies None for a key that does not exist (NAOqi 2.5.10, ALMemory).
    missing = [key for key, value in zip(keys, values, strict=True) if not is_number(value)]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise NotReadyError(
            f"'{uri}': this robot (NAOqi {version}) has no value for {', '.join(missing[:3])}{more}; with "
            "NAOqi 2.5 a board is disconnected: restart the robot, or have it repaired"
        )
    return Preflight(kind=kind, version=version, body_id=_text(connection, BODY_KEY) or "?")


def is_number(value: object) -> bool:
    """Return true if a value of the robot's memory is a number; one that is missing or broken is None."""
    return isinstance(value, int | float) and math.isfinite(value)


def _text(connection: Connection, key: str) -> str:
    """Return a text in the memory; empty if it is missing."""
    return _answer(connection, "ALMemory", "getData", key)


def _answer(connection: Connection, service: str, method: str, *arguments: object) -> str:
    """Return a text that a service gives; empty where it does not."""
    try:
        answer = connection.call(service, method, *arguments)
    except (MissingServiceError, ServiceError):
        return ""
    return answer if isinstance(answer, str) else ""
