"""Checks of ``pepper doctor`` before the robot moves: joints, wheels, clock, samples, settings, models, sensors."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from operator import attrgetter

import numpy as np

from pepper_driver.backends import Backend, DeviceError, Measurement
from pepper_driver.backends.readiness import (
    CheckResult,
    CheckStatus,
    amount,
    check_positions,
    named,
    pressed,
    rated,
)
from pepper_driver.config import (
    ControllerSettings,
    DoctorSettings,
    RobotConfig,
    RobotIdentity,
    SafetySettings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import ModelSet
from pepper_driver.observer.contact_observer import numb_joints
from pepper_driver.observer.recording import STALE_AGE
from pepper_driver.observers import source_of
from pepper_driver.realtime import (
    priority_obstacle,
)


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


def check_joints(
    inspection: Inspection, robot: RobotConfig, settings: DoctorSettings
) -> CheckResult:
    """Check that all joints answer, and rest while nothing drives them."""
    positions = inspection.values("position")
    answer = check_positions(positions, robot)
    if answer.status is CheckStatus.FAILED:
        return answer
    ranges = np.ptp(positions, axis=0)
    moving = ranges > settings.max_drift
    worst = int(ranges.argmax())
    seconds = len(inspection.samples) * robot.cycle
    found = (
        f"{answer.found}; {robot.joint_names[worst]} changes most, by "
        f"{amount(robot, worst, ranges[worst])} in {seconds:.1f} s"
    )
    return rated(
        "joints",
        found,
        warning=bool(moving.any()),
        remedy=f"let the robot rest: {named(robot.joint_names, moving)} moves by itself, or a hand moves it",
    )


def check_wheels(
    inspection: Inspection, robot: RobotConfig, settings: DoctorSettings
) -> CheckResult:
    """Check that the wheels answer and stand still."""
    speed = inspection.values("wheel_speed")
    if not np.isfinite(speed).all():
        return rated(
            "wheels",
            "a wheel reports no speed",
            failure=True,
            remedy="start the robot again; do not drive a base whose wheels are not measured",
        )
    # Noise of single samples is no motion.
    fastest = float(np.abs(np.median(speed, axis=0)).max())
    return rated(
        "wheels",
        f"{speed.shape[1]} answer, at {fastest:.2f} rad/s",
        failure=fastest > settings.wheel_rest,
        remedy="stop the base: level floor, no person pushes, no other program drives it",
    )


NETWORK = "check the network: a cable, not wireless, and no other heavy program on the robot"


def check_clock(
    inspection: Inspection, robot: RobotConfig, settings: DoctorSettings
) -> CheckResult:
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
) -> CheckResult:
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
    fraction = max(late, missing, inspection.missed / (len(ticks) + inspection.missed))
    stale = oldest > safety.stale_hold * 1e3
    remedies = [NETWORK]
    if inspection.missed:
        remedies.append("end other programs on this computer")
    return rated(
        "samples",
        found,
        failure=bool(stale),
        warning=fraction > settings.late_fraction,
        remedy="; ".join(remedies)
        + f"; beyond {safety.stale_hold * 1e3:.0f} ms the joints are held, "
        f"beyond {safety.stale_fault * 1e3:.0f} ms the robot is stopped, and with samples older than "
        f"{STALE_AGE * 1e3:.0f} ms nothing is detected",
    )


def check_settings(safety: SafetySettings, controller: ControllerSettings) -> CheckResult:
    """Check that no protection is switched off."""
    found = (
        f"fault at {np.degrees(safety.following_error):.0f} deg from the command for "
        f"{safety.following_error_time:g} s, "
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


def check_computer(backend: Backend) -> CheckResult:
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
) -> CheckResult:
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
            f"identify {named(robot.joint_names, without)} too: nothing is detected directly there"
        )
    if numb := numb_joints(models):
        found += f"; no touch reaches the thresholds of {', '.join(numb)}"
        remedies.append(f"nothing is detected at {', '.join(numb)}; identify again, more slowly")
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


def check_touch(inspection: Inspection, robot: RobotConfig) -> CheckResult:
    """Check that the touch sensors of head and hands are free."""
    found, is_free = pressed(inspection.values("touch"), tuple(robot.sensors.touch))
    return rated(
        "touch sensors",
        found,
        warning=not is_free,
        remedy="take hands off the robot; a sensor that stays is broken or dirty: do not label touches by it",
    )


def check_bumpers(inspection: Inspection, robot: RobotConfig) -> CheckResult:
    """Check that the bumpers are free; one that cannot be read stops the base as if it were pressed."""
    found, is_free = pressed(inspection.values("bumpers"), tuple(robot.sensors.bumpers))
    return rated(
        "bumpers",
        found,
        failure=not is_free,
        remedy="move what stands against the base away; a bumper that stays pressed is jammed",
    )


def check_imu(inspection: Inspection, settings: DoctorSettings) -> CheckResult:
    """Check by its own inertial unit that the robot stands upright."""
    attitude = inspection.values("imu.attitude")
    acceleration = inspection.values("imu.acceleration")
    if not (np.isfinite(attitude).all() and np.isfinite(acceleration).all()):
        return rated(
            "inertial unit",
            "it does not answer",
            failure=True,
            remedy="start the robot again: a fall cannot be noticed",
        )
    roll, pitch = np.median(attitude, axis=0)[:2]
    tilt = float(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0)))
    gravity = float(np.linalg.norm(np.median(acceleration, axis=0)))
    strange = not settings.gravity[0] <= gravity <= settings.gravity[1]
    remedies = []
    if tilt > settings.tilt_warning:
        remedies.append(
            "put the robot upright on level floor, with nothing under its wheels, and no person leaning on it"
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
