"""Checks of joints, motors and wheels."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pepper_driver.config import DoctorSettings, RobotConfig, SafetySettings
from pepper_driver.doctor.look import Look
from pepper_driver.doctor.result import Outcome, Result, rated, unknown

MOST_NAMED = 4
"""Joints named in one line."""


def check_joints(look: Look, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Whether all joints answer, and rest while nothing drives them."""
    positions = look.values("position")
    broken = [not np.isfinite(column).all() for column in positions.T]
    if any(broken):
        lost = named(robot.joint_names, broken)
        return rated(
            "joints",
            f"no position of {lost}",
            failure=True,
            cure="start the robot again; if that does not help, its encoder or its board is broken",
        )
    ranges = np.ptp(positions, axis=0)
    moving = ranges > settings.rest
    worst = int(ranges.argmax())
    seconds = len(look.samples) * robot.cycle
    found = (
        f"all {len(ranges)} answer; {robot.joint_names[worst]} changes most, by "
        f"{_amount(robot, worst, ranges[worst])} in {seconds:.1f} s"
    )
    return rated(
        "joints",
        found,
        warning=bool(moving.any()),
        cure=f"let the robot rest: {named(robot.joint_names, moving)} moves by itself, or by a hand",
    )


def check_limits(look: Look, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Whether the joints are within their limits: the start would pull back those that are not."""
    position = look.last.position
    if not np.isfinite(position).all():
        return unknown("limits", "not all positions are known")
    outside = np.maximum(robot.lower - position, position - robot.upper)
    over = outside > settings.outside_warning
    worst = int(outside.argmax())
    name = robot.joint_names[worst]
    if outside[worst] <= 0.0:
        found = "all joints are within their limits"
    else:
        found = f"{name} is {_amount(robot, worst, outside[worst])} beyond its limit"
    return rated(
        "limits",
        found,
        failure=bool(outside[worst] > settings.outside_failure),
        warning=bool(over.any()),
        cure=f"move {named(robot.joint_names, over)} by hand to within the limits, robot at rest; "
        "if it looks as if it were there, the joint needs calibration by the maker's tools",
    )


def check_temperatures(look: Look, robot: RobotConfig, safety: SafetySettings) -> Result:
    """Whether motors are cool enough: levels of the safety gate."""
    temperature = look.last.temperature
    known = np.isfinite(temperature)
    if not known.any():
        return unknown("temperatures", "no motor tells its temperature")
    hot = known & (temperature >= safety.temperature_fault)
    warm = known & (temperature >= safety.temperature_warning)
    worst = int(np.nanargmax(temperature))
    found = f"{robot.joint_names[worst]} is warmest with {temperature[worst]:.0f} deg C"
    cures = []
    if warm.any():
        cures.append(
            f"let {named(robot.joint_names, warm)} cool without stiffness to below "
            f"{safety.temperature_warning:.0f} deg C"
        )
    if not known.all():
        found += f"; not told: {named(robot.joint_names, ~known)}"
        cures.append("watch the motors that do not tell by hand")
    return rated(
        "temperatures",
        found,
        failure=bool(hot.any()),
        warning=bool(cures),
        cure="; ".join(cures),
    )


def check_wheels(look: Look, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Whether the wheels answer and stand."""
    speed = look.values("wheel_speed")
    if not np.isfinite(speed).all():
        return rated(
            "wheels",
            "a wheel tells no speed",
            failure=True,
            cure="start the robot again; do not drive a base whose wheels are not measured",
        )
    # Noise of single samples is no motion.
    fastest = float(np.abs(np.median(speed, axis=0)).max())
    return rated(
        "wheels",
        f"{speed.shape[1]} answer, at {fastest:.2f} rad/s",
        failure=fastest > settings.wheel_rest,
        cure="stop the base: level floor, nobody pushes, no other program drives it",
    )


def check_diagnosis(look: Look) -> Result:
    """What the robot itself finds broken."""
    if look.diagnosis is None:
        return unknown("diagnosis", "this robot has no diagnosis of its own")
    if not look.diagnosis:
        return rated("diagnosis", "the robot finds nothing broken")
    return Result(
        name="diagnosis",
        outcome=Outcome.FAILED if any(e.serious for e in look.diagnosis) else Outcome.WARNING,
        found="; ".join(f"{error.device}: {error.text}" for error in look.diagnosis),
        cure="start the robot again; an error that stays is one for the maker's service",
    )


def named(names: Iterable[str], chosen: Iterable[bool]) -> str:
    """The chosen names in one line."""
    there = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    more = len(there) - MOST_NAMED
    return ", ".join(there[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _amount(robot: RobotConfig, joint: int, value: float) -> str:
    """A change of a joint for people."""
    if robot.joint_names[joint] in robot.hands.joints:
        return f"{value:.2f} of its way"
    return f"{np.degrees(value):.1f} deg"
