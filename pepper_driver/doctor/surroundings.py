"""Checks of power, of what touches the robot, and of how it stands."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

import numpy as np

from pepper_driver.config import DoctorSettings, RobotConfig, SafetySettings
from pepper_driver.doctor.body import named
from pepper_driver.doctor.look import Look
from pepper_driver.doctor.result import Result, rated, unknown

PRESSED = 0.5
"""Between 0, not pressed, and 1."""


def check_battery(look: Look, safety: SafetySettings) -> Result:
    """Whether there is charge enough: levels of the safety gate."""
    charge = look.last.battery
    if isnan(charge):
        return unknown("battery", "the charge cannot be read, and nothing watches it")
    low = charge < safety.battery_warning
    return rated(
        "battery",
        f"{charge:.0%}",
        failure=charge < safety.battery_activate,
        warning=low,
        cure=f"charge it: below {safety.battery_activate:.0%} the robot does not start, "
        f"below {safety.battery_fault:.0%} it is stopped",
    )


def check_flap(look: Look) -> Result:
    """Whether the charging flap is closed."""
    flap = look.last.charging_flap
    if isnan(flap):
        return unknown("charging flap", "this robot does not tell")
    is_open = flap > PRESSED
    return rated(
        "charging flap",
        "open" if is_open else "closed",
        warning=is_open,
        cure="unplug the cable and close the flap; while it is open, the base stands still",
    )


def check_touch(look: Look, robot: RobotConfig) -> Result:
    """Whether nobody touches the sensors of head and hands."""
    names = tuple(robot.sensors.touch)
    touched, lost = _pressed(look, "touch")
    found = f"touched: {named(names, touched)}" if any(touched) else "nothing touches"
    if any(lost):
        found += f"; not told: {named(names, lost)}"
    return rated(
        "touch sensors",
        found,
        warning=any(touched) or any(lost),
        cure="take hands off the robot; a sensor that stays is broken or dirty: do not label touches by it",
    )


def check_bumpers(look: Look, robot: RobotConfig) -> Result:
    """Whether the bumpers are free; one that cannot be read stops the base as if it were pressed."""
    names = tuple(robot.sensors.bumpers)
    pressed, lost = _pressed(look, "bumpers")
    return rated(
        "bumpers",
        _what(names, pressed, lost),
        failure=any(pressed) or any(lost),
        cure="move what stands against the base away; a bumper that stays pressed is jammed",
    )


def check_buttons(look: Look, robot: RobotConfig, safety: SafetySettings) -> Result:
    """Whether the button on the chest is free; where it stops the robot, it must be readable."""
    names = tuple(robot.sensors.buttons)
    pressed, lost = _pressed(look, "buttons")
    wrong = any(pressed) or any(lost)
    return rated(
        "chest button",
        _what(names, pressed, lost),
        failure=wrong and safety.chest_button,
        warning=wrong,
        cure="let it go; one that stays pressed is jammed, and the robot must not move without it",
    )


def check_imu(look: Look, settings: DoctorSettings) -> Result:
    """Whether the robot stands upright, by its own inertial unit."""
    attitude = look.values("imu.attitude")
    acceleration = look.values("imu.acceleration")
    if not (np.isfinite(attitude).all() and np.isfinite(acceleration).all()):
        return rated(
            "inertial unit",
            "it does not answer",
            failure=True,
            cure="start the robot again: nothing tells whether it is about to fall",
        )
    roll, pitch = np.median(attitude, axis=0)[:2]
    tilt = float(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0)))
    gravity = float(np.linalg.norm(np.median(acceleration, axis=0)))
    strange = not settings.gravity[0] <= gravity <= settings.gravity[1]
    cures = []
    if tilt > settings.tilt_warning:
        cures.append(
            "put the robot upright on level floor, with nothing under its wheels, and nobody leaning on it"
        )
    if strange:
        cures.append("let the robot rest; an acceleration that stays strange is a broken sensor")
    return rated(
        "inertial unit",
        f"tilted by {np.degrees(tilt):.1f} deg; gravity {gravity:.2f} m/s2",
        failure=tilt > settings.tilt_failure,
        warning=bool(cures),
        cure="; ".join(cures),
    )


def _pressed(look: Look, sensor: str) -> tuple[list[bool], list[bool]]:
    """Which were pressed at any time, and which could not be read."""
    columns = look.values(sensor).T
    return [bool((c > PRESSED).any()) for c in columns], [bool(np.isnan(c).any()) for c in columns]


def _what(names: Sequence[str], pressed: Sequence[bool], lost: Sequence[bool]) -> str:
    parts = []
    if any(pressed):
        parts.append(f"pressed: {named(names, pressed)}")
    if any(lost):
        parts.append(f"not told: {named(names, lost)}")
    return "; ".join(parts) or "none pressed"
