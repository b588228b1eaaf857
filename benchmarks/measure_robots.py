"""Facts that identification measures of a robot first, compared with the plant: delay, speed, torque, friction, loss.

Simulated robots make the runs with which `pepper identify --weight 0.5` begins; no models are fitted. Samples are
paired with commands as over NAOqi before anything is measured: ASSUMED_DELAY ticks apart. Each fact is compared with
the value of the plant, which only this program reads:

- delay: whole ticks from a command to the sample that answers it;
- speed: at which the plant's limiter holds the targets of a joint that was commanded more;
- torque scale: torque of the motor by its documented constant per torque at the joint. The plant has it from the
  efficiency of the gear and the temperature of the magnet. Of the joints that carry the weight;
- friction: of motor and link with the teeth in contact, at the speed of the sweeps and the temperature of the grease,
  in torque of the motor. What the load adds to it is not in it. Wrists apart: their currents are below a step of the
  sensor;
- lost: fraction of samples that do not arrive.

A plant that is drawn is measured on each of --draws. Robots that are done are in the JSON file: the same command goes
on after Ctrl-C. Run: python benchmarks/measure_robots.py --draws 0-19 --json robots.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from seeded_runs import FILE_WIDTH, Parser, Result, fraction_text, perform

from pepper_driver import PepperError
from pepper_driver.backends.fields import RECORDED_FIELDS
from pepper_driver.backends.selection import with_query
from pepper_driver.config import PlantConfig, load_plant, load_robot
from pepper_driver.config.plant import draws
from pepper_driver.config.plant_parts import FrictionParameters
from pepper_driver.config.population import parse_draws
from pepper_driver.identification import runs
from pepper_driver.identification.measurements.program import (
    Hand,
    held_weight,
    measure_robot,
)
from pepper_driver.observer import Recording
from pepper_driver.observer.models.measured_robot import MeasuredRobot

ASSUMED_DELAY = 3
"""[ticks] As the settings of NAOqi have it."""

MASS = 0.5
"""[kg] Of the weight."""

HAND: Hand = "left"
"""That holds it."""

CARRYING = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll")
"""Joints whose load changes with the weight: not that of the wrist, through whose axis it pulls."""

FAST = tuple(
    side + joint
    for side in "LR"
    for joint in ("ShoulderPitch", "ElbowYaw", "ElbowRoll", "WristYaw")
)
"""Joints that are commanded more and more speed."""


SWEEP_SPEED = 0.15
"""[rad/s] About that of the slow sweeps."""


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Largest error that a fact may have: in its own unit, or as a fraction of the true value."""

    error: float
    relative: bool

    def error_of(self, measured: float, true: float) -> float:
        """Return the size of an error, as the bound has it."""
        return abs(measured - true) / (true if self.relative else 1.0)

    def text(self, error: float) -> str:
        """Return a human-readable error."""
        return f"{100.0 * error:.1f} %" if self.relative else f"{error:.2g}"


BOUNDS = {
    "delay": Bound(error=0.5, relative=False),
    "speed": Bound(error=0.1, relative=True),
    "torque scale": Bound(error=0.1, relative=True),
    "friction": Bound(error=0.3, relative=True),
    "friction of wrists": Bound(error=0.3, relative=True),
    "lost": Bound(error=0.005, relative=False),
}


def measure(uri: str, plant: PlantConfig) -> Result:
    """Have a robot make its runs; return its facts and those of the plant."""
    robot, weight = load_robot(), held_weight(MASS, HAND)
    recordings = {}
    for run in runs.plan_measurements(robot, weight=weight):
        recording = runs.perform(runs.seeded_uri(uri, run), run)
        name = run.name.rpartition("-")[0]
        recordings[name] = paired_later(recording, ASSUMED_DELAY - plant.response_delay)
    return {"facts": compare(measure_robot(recordings, ASSUMED_DELAY, robot, weight), plant)}


def paired_later(recording: Recording, ticks: int) -> Recording:
    """Return a run whose commands are paired with samples that many ticks later; earlier below 0."""
    count = len(recording) - abs(ticks)
    columns: dict[str, Any] = {}
    for field in RECORDED_FIELDS:
        is_sample = field.owner.startswith("measurement")
        first = max(0, ticks) if is_sample else max(0, -ticks)
        columns[field.column] = getattr(recording, field.column)[first : first + count]
    return replace(recording, **columns)


def compare(found: MeasuredRobot, plant: PlantConfig) -> list[dict[str, Any]]:
    """Return facts with joint, measured and true value; None for a value that there is not."""
    facts = [
        _fact("delay", "", found.response_delay, plant.response_delay),
        _fact("lost", "", found.lost, plant.transport.lost),
    ]
    warmer = plant.heat.start - plant.heat.reference
    magnet, grease = (1.0 + rate * warmer for rate in (plant.heat.magnet, plant.heat.grease))
    for joint, one in found.joints.items():
        drive = plant.actuator(joint)
        scale = 1.0 / (drive.efficiency * magnet)
        friction = scale * grease * _sliding_friction(drive.friction)
        facts.append(_fact("friction", joint, one.friction, friction))
        if joint in CARRYING:
            facts.append(_fact("torque scale", joint, one.torque_scale, scale))
        if joint in FAST:
            speed = one.speed if one.speed_limited else None
            facts.append(_fact("speed", joint, speed, plant.targets.speed_limit))
    return facts


def _sliding_friction(friction: FrictionParameters) -> float:
    """Return the friction of a drive in slow motion, at the joint and at the reference temperature [N m]."""
    contact = friction.contact
    falling = 1.0 + (SWEEP_SPEED / friction.stribeck_velocity) ** 2
    sticking = 1.0 + (friction.breakaway - 1.0) / falling
    viscous = contact.motor_viscous + contact.link_viscous
    return sticking * (contact.motor + contact.link) + viscous * SWEEP_SPEED


def _fact(name: str, joint: str, measured: float | None, true: float | None) -> dict[str, Any]:
    return {"fact": name, "joint": joint, "measured": measured, "true": true}


def _row(fact: dict[str, Any]) -> str:
    """Return the row of the table in which a fact counts."""
    name: str = fact["fact"]
    return f"{name} of wrists" if name == "friction" and "Wrist" in fact["joint"] else name


def plan(plants: list[str], drawn: tuple[int, ...]) -> dict[str, Callable[[], Result]]:
    """Return the jobs by name of the robot."""
    robot = load_robot()
    jobs: dict[str, Callable[[], Result]] = {}
    for name in plants:
        for draw in drawn if draws(name, robot) else (None,):
            plant = load_plant(name, robot, draw=draw)
            uri = with_query("mujoco://", plant=name, draw=draw)
            jobs[plant.name] = partial(measure, uri, plant)
    return jobs


@dataclass(frozen=True, kw_only=True)
class Error:
    """Error of one fact of one robot, by its bound."""

    size: float
    place: str


def fact_table(results: dict[str, Result]) -> Table:
    """Return a row for each fact. Robots that lack what is measured count where it was found all the same."""
    table = Table(
        "fact", "bound", "robots", "joints", "not measured", "found in vain", "median error", "worst error",
        "within the bound", "worst at", title="Simulated: robots as identification measures them",
    )  # fmt: skip
    for name, bound in BOUNDS.items():
        facts = [
            (robot, fact)
            for robot, result in results.items()
            for fact in result["facts"]
            if _row(fact) == name
        ]
        true = [(robot, fact) for robot, fact in facts if fact["true"] is not None]
        vain = sum(fact["true"] is None and fact["measured"] is not None for _, fact in facts)
        errors = [
            Error(
                size=bound.error_of(fact["measured"], fact["true"]),
                place=f"{robot} {fact['joint']} ({fact['measured']:.3g}, not {fact['true']:.3g})",
            )
            for robot, fact in true
            if fact["measured"] is not None
        ]
        cells = ["-"] * 4
        if errors:
            worst = max(errors, key=lambda error: error.size)
            within = sum(error.size <= bound.error for error in errors)
            median = float(np.median([error.size for error in errors]))
            cells = [
                bound.text(median),
                bound.text(worst.size),
                fraction_text(within, len(errors)),
                worst.place,
            ]
        counts = (len({robot for robot, _ in true}), len(true), len(true) - len(errors), vain)
        table.add_row(name, bound.text(bound.error), *map(str, counts), *cells)
    return table


def arguments() -> argparse.Namespace:
    """Return the options."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="+", default=["random"], help="names or files")
    parser.add_argument("--draws", default="0-19", help="of plants that are drawn")
    parser.add_argument("--workers", type=int, default=1, help="processes; -1 for one per core")
    parser.add_argument(
        "--json", type=Path, help="results, and where a run that was broken off goes on"
    )
    given = parser.parse_args()
    if given.workers < 1 and given.workers != -1:
        parser.error(f"--workers must be 1 or more, or -1, got {given.workers}")
    return given


def main() -> int:
    """Measure, print the table, and return the exit code."""
    given = arguments()
    try:
        jobs = plan(given.plants, parse_draws(given.draws))
        results = perform(jobs, given.json, given.workers, Console(stderr=True))
    except PepperError as error:
        print(f"measure_robots.py: {error}", file=sys.stderr)
        return 2
    # A file has no width that cells would have to be folded for.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else FILE_WIDTH)
    console.print(fact_table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
