"""Checks of a robot before it moves."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from math import isnan
from operator import attrgetter
from typing import Any

import numpy as np

from pepper_driver.backends import Backend, DeviceError, Measurement
from pepper_driver.config import (
    ControllerSettings,
    DoctorSettings,
    RobotConfig,
    RobotIdentity,
    SafetySettings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import ModelSet
from pepper_driver.observer.recording import STALE_AGE
from pepper_driver.observers import source_of
from pepper_driver.realtime import (
    priority_obstacle,
)


class CheckStatus(Enum):
    """OK; WARNING: it may move; FAILED: it should not; UNKNOWN: this robot, or this computer, does not tell."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "FAILED"
    UNKNOWN = "not known here"


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """One check.

    Attributes:
        name: What was looked at.
        status: How it is.
        found: What was measured, for people.
        remedy: What to do about it; empty where there is nothing to do.
    """

    name: str
    status: CheckStatus
    found: str
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        """All of it by name."""
        return {**asdict(self), "status": self.status.value}


def failed(results: Iterable[Result]) -> bool:
    """Return true if a check failed."""
    return any(result.status is CheckStatus.FAILED for result in results)


def rated(
    name: str,
    found: str,
    *,
    failure: bool = False,
    warning: bool = False,
    remedy: str = "",
) -> Result:
    """Return a result from what is wrong; the remedy counts only when something is."""
    if failure:
        return Result(name=name, status=CheckStatus.FAILED, found=found, remedy=remedy)
    if warning:
        return Result(name=name, status=CheckStatus.WARNING, found=found, remedy=remedy)
    return Result(name=name, status=CheckStatus.OK, found=found)


def unknown(name: str, found: str) -> Result:
    """Return a result of a check that cannot be made."""
    return Result(name=name, status=CheckStatus.UNKNOWN, found=found)


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """Measurements in the order they came, the one of ``open`` first.

    Attributes:
        samples: Two at least; in real time the same one again where there was no newer one.
        missed: Ticks that this computer missed.
        wall: How long it took by this computer's clock [s]; None in simulated time.
        diagnosis: As the backend gave it.
    """

    samples: tuple[Measurement, ...]
    missed: int
    wall: float | None
    diagnosis: tuple[DeviceError, ...] | None

    def values(self, name: str) -> FloatArray:
        """(n, ...) one field of all measurements, with a dot for those of the IMU."""
        return np.array([attrgetter(name)(sample) for sample in self.samples], dtype=np.float64)

    @property
    def last(self) -> Measurement:
        """The newest."""
        return self.samples[-1]


MOST_NAMED = 4
"""Joints named in one line."""


def check_joints(inspection: Inspection, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Check that all joints answer, and rest while nothing drives them."""
    positions = inspection.values("position")
    broken = [not np.isfinite(column).all() for column in positions.T]
    if any(broken):
        lost = named(robot.joint_names, broken)
        return rated(
            "joints",
            f"no position of {lost}",
            failure=True,
            remedy="start the robot again; if that does not help, its encoder or its board is broken",
        )
    ranges = np.ptp(positions, axis=0)
    moving = ranges > settings.rest
    worst = int(ranges.argmax())
    seconds = len(inspection.samples) * robot.cycle
    found = (
        f"all {len(ranges)} answer; {robot.joint_names[worst]} changes most, by "
        f"{_amount(robot, worst, ranges[worst])} in {seconds:.1f} s"
    )
    return rated(
        "joints",
        found,
        warning=bool(moving.any()),
        remedy=f"let the robot rest: {named(robot.joint_names, moving)} moves by itself, or by a hand",
    )


def check_limits(inspection: Inspection, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Check that the joints are within their limits: the start would pull back those that are not."""
    position = inspection.last.position
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
        remedy=f"move {named(robot.joint_names, over)} by hand to within the limits, robot at rest; "
        "if it looks as if it were there, the joint needs calibration by the maker's tools",
    )


def check_temperatures(
    inspection: Inspection, robot: RobotConfig, safety: SafetySettings
) -> Result:
    """Check that motors are cool enough: levels of the safety gate."""
    temperature = inspection.last.temperature
    known = np.isfinite(temperature)
    if not known.any():
        return unknown("temperatures", "no motor tells its temperature")
    hot = known & (temperature >= safety.temperature_fault)
    warm = known & (temperature >= safety.temperature_warning)
    worst = int(np.nanargmax(temperature))
    found = f"{robot.joint_names[worst]} is warmest with {temperature[worst]:.0f} deg C"
    remedies = []
    if warm.any():
        remedies.append(
            f"let {named(robot.joint_names, warm)} cool without stiffness to below "
            f"{safety.temperature_warning:.0f} deg C"
        )
    if not known.all():
        found += f"; not told: {named(robot.joint_names, ~known)}"
        remedies.append("watch the motors that do not tell by hand")
    return rated(
        "temperatures",
        found,
        failure=bool(hot.any()),
        warning=bool(remedies),
        remedy="; ".join(remedies),
    )


def check_wheels(inspection: Inspection, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Check that the wheels answer and stand still."""
    speed = inspection.values("wheel_speed")
    if not np.isfinite(speed).all():
        return rated(
            "wheels",
            "a wheel tells no speed",
            failure=True,
            remedy="start the robot again; do not drive a base whose wheels are not measured",
        )
    # Noise of single samples is no motion.
    fastest = float(np.abs(np.median(speed, axis=0)).max())
    return rated(
        "wheels",
        f"{speed.shape[1]} answer, at {fastest:.2f} rad/s",
        failure=fastest > settings.wheel_rest,
        remedy="stop the base: level floor, nobody pushes, no other program drives it",
    )


def check_diagnosis(inspection: Inspection) -> Result:
    """Check the robot's own diagnosis for broken parts."""
    if inspection.diagnosis is None:
        return unknown("diagnosis", "this robot has no diagnosis of its own")
    if not inspection.diagnosis:
        return rated("diagnosis", "the robot finds nothing broken")
    return Result(
        name="diagnosis",
        status=CheckStatus.FAILED
        if any(e.serious for e in inspection.diagnosis)
        else CheckStatus.WARNING,
        found="; ".join(f"{error.device}: {error.text}" for error in inspection.diagnosis),
        remedy="start the robot again; an error that stays is one for the maker's service",
    )


def named(names: Iterable[str], chosen: Iterable[bool]) -> str:
    """Return the chosen names in one line."""
    there = [name for name, is_chosen in zip(names, chosen, strict=True) if is_chosen]
    more = len(there) - MOST_NAMED
    return ", ".join(there[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _amount(robot: RobotConfig, joint: int, value: float) -> str:
    """Return a change of a joint for people."""
    if robot.joint_names[joint] in robot.hands.joints:
        return f"{value:.2f} of its way"
    return f"{np.degrees(value):.1f} deg"


NETWORK = (
    "look at the network: a cable rather than wireless, and no other heavy program on the robot"
)


def check_clock(inspection: Inspection, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Check that time passes in steps of the cycle, without jumps, and as fast as on this computer."""
    clock = inspection.values("time")
    if not np.isfinite(clock).all():
        return rated(
            "clock",
            "it is not a number",
            failure=True,
            remedy="start the robot again",
        )
    ticks = np.diff([sample.tick for sample in inspection.samples])
    steps = np.diff(clock)
    fresh = steps[ticks != 0]
    if not len(fresh):
        return rated(
            "clock", "no new sample came", failure=True, remedy=f"start it again; {NETWORK}"
        )
    per_cycle = float(np.median(fresh / ticks[ticks != 0]))
    off = abs(per_cycle / robot.cycle - 1.0)
    jitter = float(np.abs(fresh - robot.cycle * ticks[ticks != 0]).max())
    back, longest = float(steps.min()), float(steps.max())
    found = f"steps of {per_cycle * 1e3:.2f} ms, off by {jitter * 1e3:.1f} ms at most"
    failures, warnings = [], []
    if back < 0.0:
        failures.append(f"goes back by {-back:.3f} s")
    if longest > settings.clock_jump:
        failures.append(f"jumps by {longest:.3f} s")
    if off > settings.clock_rate:
        failures.append(f"should make steps of {robot.cycle * 1e3:g} ms")
    if inspection.wall:
        rate = float(clock[-1] - clock[0]) / inspection.wall
        found += f", {rate:.3f} times as fast as this computer's"
        # The first and the last sample may each be a cycle older than another.
        if abs(rate - 1.0) > settings.clock_rate + 2.0 * robot.cycle / inspection.wall:
            warnings.append("runs at another rate than this computer's")
    parts = failures + warnings
    return rated(
        "clock",
        "; ".join([found, *parts]),
        failure=bool(failures),
        warning=bool(warnings),
        remedy=f"end what sets the robot's clock while it runs, then start it again; {NETWORK}",
    )


def check_samples(
    inspection: Inspection, robot: RobotConfig, safety: SafetySettings, settings: DoctorSettings
) -> Result:
    """Check that samples are young enough for the gate, and their median for the observer."""
    age = inspection.values("age")
    if not np.isfinite(age).all():
        return rated("samples", "their age is not known", failure=True, remedy="start it again")
    ticks = [sample.tick for sample in inspection.samples]
    missing = float(np.mean(np.diff(ticks) == 0))
    late = float(np.mean(age > STALE_AGE))
    median, oldest = np.percentile(age, [50, 100]) * 1e3
    found = f"age {median:.0f} ms, at most {oldest:.0f} ms"
    if missing:
        found += f"; in {missing:.1%} of the cycles none"
    if inspection.missed:
        found += f"; this computer missed {inspection.missed} ticks"
    share = max(late, missing, inspection.missed / (len(ticks) + inspection.missed))
    stale = oldest > safety.stale_hold * 1e3
    remedies = [NETWORK]
    if inspection.missed:
        remedies.append("end other programs on this computer")
    return rated(
        "samples",
        found,
        failure=bool(stale),
        warning=share > settings.late_share,
        remedy="; ".join(remedies)
        + f"; beyond {safety.stale_hold * 1e3:.0f} ms the joints are held, "
        f"beyond {safety.stale_fault * 1e3:.0f} ms the robot is stopped, and with samples older than "
        f"{STALE_AGE * 1e3:.0f} ms nothing is felt",
    )


def check_settings(safety: SafetySettings, controller: ControllerSettings) -> Result:
    """Check that no protection is switched off."""
    found = (
        f"fault at {np.degrees(safety.divergence):.0f} deg from the command for {safety.divergence_time:g} s, "
        f"at samples {safety.stale_fault * 1e3:.0f} ms old, at {safety.temperature_fault:.0f} deg C"
    )
    off = []
    if not safety.chest_button:
        off.append("the chest button stops nothing (safety.yaml: chest_button)")
    for name in ("self_collision", "balance", "coupled_limits"):
        if not getattr(controller.constraints, name):
            off.append(f"no {name.replace('_', ' ')} (controller.yaml: constraints.{name})")
    if controller.velocity == "robot":
        off.append("joints at the robot's full speed (controller.yaml: velocity)")
    return rated(
        "settings",
        "; ".join([found, *off]),
        warning=bool(off),
        remedy="set back in these files what was not meant",
    )


def check_computer(backend: Backend) -> Result:
    """Check that this computer can make ticks in time."""
    found = f"Python {platform.python_version()}, {os.cpu_count()} processors"
    if not backend.real_time:
        return rated("computer", f"{found}; simulated time needs no priority")
    obstacle = priority_obstacle()
    if obstacle:
        reason, _, remedy = obstacle.partition("; ")
        return rated(
            "computer",
            f"{found}; {reason}: ticks may come late",
            warning=True,
            remedy=remedy or "run it on Linux",
        )
    return rated("computer", f"{found}; real-time priority permitted")


def check_models(
    models: ModelSet, identities: Sequence[RobotIdentity], robot: RobotConfig
) -> Result:
    """Check that models are of all joints and of this version; they were found for these ``identities``."""
    here, source = _version(), source_of(models, identities)
    without = [name not in models.models for name in robot.joint_names]
    found = (
        f"{models.kind} models of {len(models.models)} of {len(without)} joints, "
        f"identified on '{source.name}', "
        f"{'' if source == identities[0] else 'of which it is a variant, '}version {models.version}"
    )
    remedies = []
    if any(without):
        remedies.append(
            f"identify {named(robot.joint_names, without)} too: there nothing is felt directly"
        )
    if models.version != here:
        found += f" (this is {here})"
        remedies.append("identify again ('pepper identify') where this version's notes say so")
    return rated("models", found, warning=bool(remedies), remedy="; ".join(remedies))


def _version() -> str:
    """Return the version of this package; some systems install without metadata."""
    try:
        return version("pepper-driver")
    except PackageNotFoundError:
        return "unknown"


PRESSED = 0.5
"""Between 0, not pressed, and 1."""


def check_battery(inspection: Inspection, safety: SafetySettings) -> Result:
    """Check the charge of the battery: levels of the safety gate."""
    charge = inspection.last.battery
    if isnan(charge):
        return unknown("battery", "the charge cannot be read, and nothing watches it")
    low = charge < safety.battery_warning
    return rated(
        "battery",
        f"{charge:.0%}",
        failure=charge < safety.battery_activate,
        warning=low,
        remedy=f"charge it: below {safety.battery_activate:.0%} the robot does not start, "
        f"below {safety.battery_fault:.0%} it is stopped",
    )


def check_flap(inspection: Inspection) -> Result:
    """Check that the charging flap is closed."""
    flap = inspection.last.charging_flap
    if isnan(flap):
        return unknown("charging flap", "this robot does not tell")
    is_open = flap > PRESSED
    return rated(
        "charging flap",
        "open" if is_open else "closed",
        warning=is_open,
        remedy="unplug the cable and close the flap; while it is open, the base stands still",
    )


def check_touch(inspection: Inspection, robot: RobotConfig) -> Result:
    """Check that the touch sensors of head and hands are free."""
    names = tuple(robot.sensors.touch)
    touched, lost = _pressed(inspection, "touch")
    found = f"touched: {named(names, touched)}" if any(touched) else "nothing touches"
    if any(lost):
        found += f"; not told: {named(names, lost)}"
    return rated(
        "touch sensors",
        found,
        warning=any(touched) or any(lost),
        remedy="take hands off the robot; a sensor that stays is broken or dirty: do not label touches by it",
    )


def check_bumpers(inspection: Inspection, robot: RobotConfig) -> Result:
    """Check that the bumpers are free; one that cannot be read stops the base as if it were pressed."""
    names = tuple(robot.sensors.bumpers)
    pressed, lost = _pressed(inspection, "bumpers")
    return rated(
        "bumpers",
        _what(names, pressed, lost),
        failure=any(pressed) or any(lost),
        remedy="move what stands against the base away; a bumper that stays pressed is jammed",
    )


def check_buttons(inspection: Inspection, robot: RobotConfig, safety: SafetySettings) -> Result:
    """Check that the button on the chest is free; where it stops the robot, it must be readable."""
    names = tuple(robot.sensors.buttons)
    pressed, lost = _pressed(inspection, "buttons")
    wrong = any(pressed) or any(lost)
    return rated(
        "chest button",
        _what(names, pressed, lost),
        failure=wrong and safety.chest_button,
        warning=wrong,
        remedy="let it go; one that stays pressed is jammed, and the robot must not move without it",
    )


def check_imu(inspection: Inspection, settings: DoctorSettings) -> Result:
    """Check by its own inertial unit that the robot stands upright."""
    attitude = inspection.values("imu.attitude")
    acceleration = inspection.values("imu.acceleration")
    if not (np.isfinite(attitude).all() and np.isfinite(acceleration).all()):
        return rated(
            "inertial unit",
            "it does not answer",
            failure=True,
            remedy="start the robot again: nothing tells whether it is about to fall",
        )
    roll, pitch = np.median(attitude, axis=0)[:2]
    tilt = float(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0)))
    gravity = float(np.linalg.norm(np.median(acceleration, axis=0)))
    strange = not settings.gravity[0] <= gravity <= settings.gravity[1]
    remedies = []
    if tilt > settings.tilt_warning:
        remedies.append(
            "put the robot upright on level floor, with nothing under its wheels, and nobody leaning on it"
        )
    if strange:
        remedies.append("let the robot rest; an acceleration that stays strange is a broken sensor")
    return rated(
        "inertial unit",
        f"tilted by {np.degrees(tilt):.1f} deg; gravity {gravity:.2f} m/s2",
        failure=tilt > settings.tilt_failure,
        warning=bool(remedies),
        remedy="; ".join(remedies),
    )


def _pressed(inspection: Inspection, sensor: str) -> tuple[list[bool], list[bool]]:
    """Return the names that were pressed at any time, and those that could not be read."""
    columns = inspection.values(sensor).T
    return [bool((c > PRESSED).any()) for c in columns], [bool(np.isnan(c).any()) for c in columns]


def _what(names: Sequence[str], pressed: Sequence[bool], lost: Sequence[bool]) -> str:
    parts = []
    if any(pressed):
        parts.append(f"pressed: {named(names, pressed)}")
    if any(lost):
        parts.append(f"not told: {named(names, lost)}")
    return "; ".join(parts) or "none pressed"
