"""Whether a robot should move now, as it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pepper_driver.backends.naoqi.connection import Connection, MissingServiceError, ServiceError
from pepper_driver.backends.naoqi.diagnosis import diagnosis
from pepper_driver.backends.naoqi.preflight import UnfitError, is_number
from pepper_driver.config import NaoqiSettings, RobotConfig


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
