"""Checks of readiness: what a robot must be before it moves, each with its limit, finding and remedy.

The safety gate refuses a start where one fails, and so does the NAOqi backend; ``pepper doctor`` shows them all. Limits
are those of ``safety.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.interface import BackendError, DeviceError
from pepper_driver.config import RobotConfig, SafetySettings
from pepper_driver.config.arrays import FloatArray

PRESSED = 0.5
"""Between 0, not pressed, and 1."""

MAX_NAMED = 4
"""Names in one line."""


class NotReadyError(BackendError):
    """The robot should not move, or cannot be used as it is; the message says why, and what to do."""


class CheckStatus(Enum):
    """OK; WARNING: it may move; FAILED: it should not; UNKNOWN: this robot, or this computer, does not report it."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "FAILED"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckResult:
    """One check.

    Attributes:
        name: What was looked at.
        status: How it is.
        found: Human-readable result of the measurement.
        remedy: What to do about it; empty where there is nothing to do.
    """

    name: str
    status: CheckStatus
    found: str
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        """All of it by name."""
        return {**asdict(self), "status": self.status.value}

    def __str__(self) -> str:
        return f"{self.name}: {self.found}" + (f" ({self.remedy})" if self.remedy else "")


def failed(results: Iterable[CheckResult]) -> bool:
    """Return true if a check failed."""
    return any(result.status is CheckStatus.FAILED for result in results)


def refuse_failed(who: str, results: Iterable[CheckResult]) -> None:
    """Refuse a robot for which a check failed.

    Raises:
        NotReadyError: The message names every reason and its remedy.
    """
    reasons = [str(result) for result in results if result.status is CheckStatus.FAILED]
    if reasons:
        raise NotReadyError(f"{who}: {'; '.join(reasons)}")


def rated(
    name: str,
    found: str,
    *,
    failure: bool = False,
    warning: bool = False,
    remedy: str = "",
) -> CheckResult:
    """Return a result from what is wrong; the remedy counts only when something is."""
    status = CheckStatus.WARNING if warning else CheckStatus.OK
    status = CheckStatus.FAILED if failure else status
    remedy = "" if status is CheckStatus.OK else remedy
    return CheckResult(name=name, status=status, found=found, remedy=remedy)


def unknown(name: str, found: str) -> CheckResult:
    """Return a result of a check that cannot be made."""
    return CheckResult(name=name, status=CheckStatus.UNKNOWN, found=found)


def named(names: Iterable[str], chosen: Iterable[bool]) -> str:
    """Return the chosen names in one line."""
    there = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    more = len(there) - MAX_NAMED
    return ", ".join(there[:MAX_NAMED]) + (f" and {more} more" if more > 0 else "")


def amount(robot: RobotConfig, joint: int, value: float) -> str:
    """Return a human-readable change of a joint."""
    if robot.joint_names[joint] in robot.hands.joints:
        return f"{value:.2f} of its travel"
    return f"{np.degrees(value):.1f} deg"


def check_readiness(
    measurement: Measurement, robot: RobotConfig, safety: SafetySettings
) -> tuple[CheckResult, ...]:
    """Check what a single measurement says, of any robot."""
    return (
        check_positions(measurement.position, robot),
        check_buttons(measurement.buttons, robot, safety),
        check_battery(measurement.battery, safety),
        check_temperatures(measurement.temperature, robot, safety),
    )


def check_positions(position: FloatArray, robot: RobotConfig) -> CheckResult:
    """Check that all joints answer; ``position`` is (17,) or (n, 17) [rad]."""
    rows = position.reshape(-1, len(robot.joint_names))
    broken = [not np.isfinite(column).all() for column in rows.T]
    found = f"no position of {named(robot.joint_names, broken)}"
    return rated(
        "joints",
        found if any(broken) else f"all {len(broken)} answer",
        failure=any(broken),
        remedy="start the robot again; if that does not help, its encoder or its board is broken",
    )


def check_limits(position: FloatArray, robot: RobotConfig, safety: SafetySettings) -> CheckResult:
    """Check that the joints are within their limits: the start would pull back those that are not."""
    if not np.isfinite(position).all():
        return unknown("limits", "not all positions are known")
    outside = np.maximum(robot.lower - position, position - robot.upper)
    over = outside > safety.limit_warning
    worst = int(outside.argmax())
    found = f"{robot.joint_names[worst]} is {amount(robot, worst, outside[worst])} beyond its limit"
    return rated(
        "limits",
        found if outside[worst] > 0.0 else "all joints are within their limits",
        failure=bool(outside[worst] > safety.limit_activate),
        warning=bool(over.any()),
        remedy=f"move {named(robot.joint_names, over)} by hand to within the limits, robot at rest; "
        "if the joint seems to be in range, it needs calibration by the maker's tools",
    )


def check_temperatures(
    temperature: FloatArray, robot: RobotConfig, safety: SafetySettings
) -> CheckResult:
    """Check that motors are cool enough."""
    known = np.isfinite(temperature)
    if not known.any():
        return unknown("temperatures", "no motor reports its temperature")
    warm = temperature >= safety.temperature_warning
    # nanargmax raises a ValueError where all are NaN, hence the check above.
    worst = int(np.nanargmax(temperature))
    found = f"{robot.joint_names[worst]} is warmest with {temperature[worst]:.0f} deg C"
    remedies = []
    if warm.any():
        remedies.append(
            f"let {named(robot.joint_names, warm)} cool without stiffness to below "
            f"{safety.temperature_warning:.0f} deg C"
        )
    if not known.all():
        found += f"; unknown: {named(robot.joint_names, ~known)}"
        remedies.append("check the motors without a reading by hand")
    return rated(
        "temperatures",
        found,
        failure=bool((temperature >= safety.temperature_fault).any()),
        warning=bool(remedies),
        remedy="; ".join(remedies),
    )


def check_battery(charge: float, safety: SafetySettings) -> CheckResult:
    """Check the charge of the battery."""
    if isnan(charge):
        return unknown("battery", "the charge cannot be read, and nothing watches it")
    return rated(
        "battery",
        f"{charge:.0%}",
        failure=charge < safety.battery_activate,
        warning=charge < safety.battery_warning,
        remedy=f"charge it: below {safety.battery_activate:.0%} the robot does not start, "
        f"below {safety.battery_fault:.0%} it is stopped",
    )


def check_flap(flap: float, *, refused: bool = False) -> CheckResult:
    """Check that the charging flap is closed; ``refused`` where an open one is a failure."""
    if isnan(flap):
        return unknown("charging flap", "this robot does not report it")
    is_open = flap > PRESSED
    way_out = "'charging_flap: stand' in a file for ?settings= moves head and arms alone"
    return rated(
        "charging flap",
        "open" if is_open else "closed",
        failure=is_open and refused,
        warning=is_open,
        remedy="unplug the cable and close the flap; "
        + (way_out if refused else "while it is open, the base stands still"),
    )


def check_buttons(buttons: FloatArray, robot: RobotConfig, safety: SafetySettings) -> CheckResult:
    """Check that the button on the chest is free, (1,) or (n, 1); where it stops the robot, it must be readable."""
    found, is_free = pressed(buttons, tuple(robot.sensors.buttons))
    return rated(
        "chest button",
        found,
        # A button that cannot be read cannot stop the robot either.
        failure=not is_free and safety.chest_button,
        warning=not is_free,
        remedy="release it; one that stays pressed is jammed, and the robot must not move without it",
    )


def check_diagnosis(errors: Sequence[DeviceError] | None) -> CheckResult:
    """Check the robot's own diagnosis for broken parts; None where it has none."""
    if errors is None:
        return unknown("diagnosis", "this robot has no diagnosis of its own")
    found = "; ".join(f"{error.device}: {error.text}" for error in errors)
    return rated(
        "diagnosis",
        found or "the robot finds nothing broken",
        failure=any(error.serious for error in errors),
        warning=bool(errors),
        remedy="start the robot again; an error that stays is one for the maker's service",
    )


def pressed(values: NDArray[Any], names: Sequence[str]) -> tuple[str, bool]:
    """Return a text of what was pressed or unknown at any time of (n,) or (rows, n) values; True if nothing."""
    columns = values.reshape(-1, len(names)).T
    down = [bool((column > PRESSED).any()) for column in columns]
    lost = [bool(np.isnan(column).any()) for column in columns]
    parts = [f"pressed: {named(names, down)}"] if any(down) else []
    parts += [f"unknown: {named(names, lost)}"] if any(lost) else []
    return "; ".join(parts) or "none pressed", not parts
