"""Check of the robot's clock, and of how fresh its samples are."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import DoctorSettings, RobotConfig, SafetySettings
from pepper_driver.doctor.look import Look
from pepper_driver.doctor.result import Result, rated
from pepper_driver.observer.recording import STALE_AGE

NETWORK = (
    "look at the network: a cable rather than wireless, and no other heavy program on the robot"
)


def check_clock(look: Look, robot: RobotConfig, settings: DoctorSettings) -> Result:
    """Whether time passes in steps of the cycle, without jumps, and as fast as here."""
    clock = look.values("time")
    if not np.isfinite(clock).all():
        return rated(
            "clock",
            "it is not a number",
            failure=True,
            cure="start the robot again",
        )
    ticks = np.diff([sample.tick for sample in look.samples])
    steps = np.diff(clock)
    fresh = steps[ticks != 0]
    if not len(fresh):
        return rated("clock", "no new sample came", failure=True, cure=f"start it again; {NETWORK}")
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
    if look.wall:
        rate = float(clock[-1] - clock[0]) / look.wall
        found += f", {rate:.3f} times as fast as this computer's"
        # The first and the last sample may each be a cycle older than another.
        if abs(rate - 1.0) > settings.clock_rate + 2.0 * robot.cycle / look.wall:
            warnings.append("runs at another rate than this computer's")
    parts = failures + warnings
    return rated(
        "clock",
        "; ".join([found, *parts]),
        failure=bool(failures),
        warning=bool(warnings),
        cure=f"end what sets the robot's clock while it runs, then start it again; {NETWORK}",
    )


def check_samples(
    look: Look, robot: RobotConfig, safety: SafetySettings, settings: DoctorSettings
) -> Result:
    """Whether samples are young enough for the gate, and as a rule for the observer."""
    age = look.values("age")
    if not np.isfinite(age).all():
        return rated("samples", "their age is not known", failure=True, cure="start it again")
    ticks = [sample.tick for sample in look.samples]
    missing = float(np.mean(np.diff(ticks) == 0))
    late = float(np.mean(age > STALE_AGE))
    median, oldest = np.percentile(age, [50, 100]) * 1e3
    found = f"age {median:.0f} ms, at most {oldest:.0f} ms"
    if missing:
        found += f"; in {missing:.1%} of the cycles none"
    if look.missed:
        found += f"; this computer missed {look.missed} ticks"
    share = max(late, missing, look.missed / (len(ticks) + look.missed))
    stale = oldest > safety.stale_hold * 1e3
    cures = [NETWORK]
    if look.missed:
        cures.append("end other programs on this computer")
    return rated(
        "samples",
        found,
        failure=bool(stale),
        warning=share > settings.late_share,
        cure="; ".join(cures) + f"; beyond {safety.stale_hold * 1e3:.0f} ms the joints are held, "
        f"beyond {safety.stale_fault * 1e3:.0f} ms the robot is stopped, and with samples older than "
        f"{STALE_AGE * 1e3:.0f} ms nothing is felt",
    )
