"""What the robot itself finds broken: ALDiagnosis and the keys ``Diagnosis/*``.

NAOqi 2.5 and 2.8 pages "ALDiagnosis", "ALDiagnosis API", "Diagnosis effect". A summary names the devices of the gravest
level alone; a key ``Diagnosis/KIND/DEVICE/Error`` is there for each device, and not 0 where it is broken.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pepper_driver.backends.interface import DeviceError
from pepper_driver.backends.naoqi.connection import (
    Connection,
    MissingServiceError,
    ServiceError,
)
from pepper_driver.config import RobotConfig

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
