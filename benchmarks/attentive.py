"""Sensitivity of a standing robot, attentive or not, and its cost: detected pushes, false contacts, heat and current.

Pushes: the robot stands in POSTURE for 40 s, attentive or not (amplitude 0), then its hands are pushed in turn, at the
origin of the wrist's link, for 1 s every 3.5 s, in random directions and in random order of the forces. A push is felt
when a contact begins on that arm from its onset to 0.15 s after its end; direction and joint do not count. A contact on
another limb, or longer than 0.8 s after a push, is false. Shares have 95 % intervals (Clopper-Pearson).

Free: the robot stands for an hour and nothing touches it. Every contact is false.

What is chosen is chosen on the development seeds; the figures in the documentation are of the test seeds. Each run that
is over is in the JSON file: the same command goes on after Ctrl-C.
Run: python benchmarks/attentive.py --seeds test --json attentive.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table
from seeded_runs import FILE_WIDTH, Parser, Result, perform, rate_bound, seeds, share

from pepper_driver import Pepper, PepperError
from pepper_driver.config import load_controller_settings, load_observer_settings, load_robot
from pepper_driver.config.plant import plant_names
from pepper_driver.controller import Tick
from pepper_driver.observer import ContactObserver, KnownPush, ModelSet, score
from pepper_driver.observer.models.model_file import shipped

ROOTS = {"development": 20261122, "test": 20261123}
POSTURE = {
    "LShoulderPitch": 0.9,
    "LShoulderRoll": 0.25,
    "LElbowYaw": -1.2,
    "LElbowRoll": -1.0,
    "RShoulderPitch": 0.9,
    "RShoulderRoll": -0.25,
    "RElbowYaw": 1.2,
    "RElbowRoll": 1.0,
}
HANDS = {"l_wrist": "LShoulderRoll", "r_wrist": "RShoulderRoll"}  # a joint of the same limb
PUSH_PLANTS = ("nominal", "integral")
AMPLITUDES = (0.0, 1.5, 2.0)  # [deg]
FORCES = (3.0, 5.0, 8.0, 12.0, 20.0)  # [N]
EACH = 6  # pushes with each force in one run
SETTLING, PERIOD, DURATION, RISE = 40.0, 3.5, 1.0, 0.05  # [s]
ARM = slice(5, 9)  # of the left arm in the order of joints: from shoulder to elbow
MAX_AMPLITUDE, MAX_MINUTES = 5.0, 1440.0


def observer(plant: str) -> ContactObserver:
    """With the models that ship for the plant it is a variant of."""
    kind = "integral" if "integral" in plant else "nominal"
    return ContactObserver(
        load_robot(), ModelSet.load(shipped("fusion")[kind]), load_observer_settings()
    )


def make_pepper(plant: str, amplitude: float, seed: int) -> Pepper:
    """Make a robot whose amplitude, unless it is 0, is that of an attentive one [deg]."""
    robot = load_robot()
    settings = load_controller_settings(robot)
    attentive = replace(settings.attentive, amplitude_deg=amplitude)
    pepper = Pepper(
        f"mujoco://?plant={plant}&seed={seed}",
        observer=observer(plant),
        controller=replace(settings, attentive=attentive),
        robot=robot,
    )
    pepper.attentive = amplitude > 0.0
    return pepper


def stand(pepper: Pepper) -> None:
    """Go to POSTURE, and stand there until thresholds have settled."""
    pepper.set_posture(POSTURE, duration=2.0)
    pepper.run(SETTLING)


def push(plant: str, amplitude: float, seed: int) -> Result:
    """One run with pushes; the forces of those felt and missed [N], delays [s], and the other contacts."""
    rng = np.random.default_rng(seed)
    forces = rng.permutation(np.repeat(FORCES, EACH))
    directions = rng.normal(size=(len(forces), 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    pushes = []
    with make_pepper(plant, amplitude, seed % 2**31) as pepper:
        stand(pepper)
        before = len(pepper.contact_history)
        for number, (force, direction) in enumerate(zip(forces, directions, strict=True)):
            link = list(HANDS)[number % 2]
            pepper.push(link, force * direction, [0.0, 0.0, 0.0], DURATION, rise=RISE)
            onset = pepper.time
            pushes.append(
                KnownPush(
                    joint=HANDS[link],
                    link=link,
                    direction=1,
                    force=float(force),
                    torque=float("nan"),
                    degrees=float("nan"),
                    onset=onset,
                    release=onset + DURATION,
                    moving=False,
                )
            )
            pepper.run(PERIOD)
        fallen = pepper.backend.truth.fallen
        outcome = score(pushes, pepper.contact_history, pepper.config)
    return {
        "detected": [[one.push.force, one.delay] for one in outcome.detected],
        "missed": [one.force for one in outcome.missed],
        "false": len(outcome.false),
        "before": before,
        "after_release": len(outcome.rebounds),
        "on_trunk": len(outcome.on_trunk),
        "fallen": bool(fallen),
    }


def stand_free(plant: str, amplitude: float, minutes: float, seed: int) -> Result:
    """One run without touch: false contacts with joint and time, current and temperature of the arm's motors."""
    with make_pepper(plant, amplitude, seed % 2**31) as pepper:
        start = pepper.measurement.temperature[ARM]
        pepper.set_posture(POSTURE, duration=2.0)
        total, ticks = np.zeros(len(start)), 0

        def note(tick: Tick, _: object) -> None:
            nonlocal total, ticks
            total = total + tick.measurement.current[ARM]
            ticks += 1

        pepper.run(60.0 * minutes, on_tick=note)
        false = score([], pepper.contact_history, pepper.config).false
        end, battery = pepper.measurement.temperature[ARM], pepper.measurement.battery
        names = pepper.config.joint_names[ARM]
    return {
        "minutes": minutes,
        "false": [[contact.joint or "trunk", round(contact.time, 2)] for contact in false],
        "current": dict(zip(names, (total / ticks).tolist(), strict=True)),
        "temperature_rise": dict(zip(names, (end - start).tolist(), strict=True)),
        "battery": battery,
    }


def plan(options: argparse.Namespace) -> dict[str, Callable[[], Result]]:
    """Return the runs by name. All amplitudes meet the same pushes."""
    runs: dict[str, Callable[[], Result]] = {}
    root = options.seeds
    for plant in options.push_plants:
        for number, seed in enumerate(seeds(ROOTS[root], options.runs, 0, *plant.encode())):
            for amplitude in options.amplitudes:
                name = f"{root} push {plant} {amplitude:g} deg {number}"
                runs[name] = partial(push, plant, amplitude, seed)
    if options.minutes:
        # First the plants that must have no false contact; last, for heat and current, the same robots without it.
        plants = sorted(options.plants, key=lambda plant: plant not in PUSH_PLANTS)
        pairs = [(plant, options.amplitude) for plant in plants]
        pairs += [(plant, 0.0) for plant in plants if plant in PUSH_PLANTS]
        for plant, amplitude in pairs:
            [seed] = seeds(ROOTS[root], 1, 1, *plant.encode())
            name = f"{root} free {plant} {amplitude:g} deg {options.minutes:g} min"
            runs[name] = partial(stand_free, plant, amplitude, options.minutes, seed)
    return runs


def push_table(results: dict[str, Result], options: argparse.Namespace) -> Table:
    """Return a row for each plant and amplitude."""
    columns = ["plant", "amplitude", *(f"{force:g} N" for force in FORCES)]
    columns += ["median delay", "false", "before the first push", "on the trunk", "after release"]
    table = Table(*columns, title="Simulated: pushes on the hands of a standing robot, felt")
    for plant in options.push_plants:
        for amplitude in options.amplitudes:
            begin = f"{options.seeds} push {plant} {amplitude:g} deg "
            runs = [result for name, result in results.items() if name.startswith(begin)]
            felt = [pair for run in runs for pair in run["detected"]]
            missed = [force for run in runs for force in run["missed"]]
            cells = []
            for force in FORCES:
                count = sum(pair[0] == force for pair in felt)
                cells.append(share(count, count + missed.count(force)))
            delay = f"{1e3 * np.median([pair[1] for pair in felt]):.0f} ms" if felt else "-"
            sums = (
                sum(run[key] for run in runs)
                for key in ("false", "before", "on_trunk", "after_release")
            )
            table.add_row(plant, f"{amplitude:g} deg", *cells, delay, *map(str, sums))
    return table


def free_table(results: dict[str, Result]) -> Table:
    """Return a row for each run without touch."""
    table = Table(
        "plant", "amplitude", "minutes", "false contacts", "on", "below, an hour",
        "current, A", "warmer by, K", title="Simulated: nothing touches the standing robot",
    )  # fmt: skip
    for name, result in results.items():
        if " free " not in name:
            continue
        _, _, plant, amplitude, *_ = name.split()
        joints = sorted({joint for joint, _ in result["false"]})
        count = len(result["false"])
        table.add_row(
            plant,
            f"{amplitude} deg",
            f"{result['minutes']:g}",
            str(count),
            ", ".join(joints),
            f"{rate_bound(count, result['minutes'] / 60.0):.1f}",
            " ".join(f"{value:.2f}" for value in result["current"].values()),
            " ".join(f"{value:.0f}" for value in result["temperature_rise"].values()),
        )
    return table


def arguments() -> argparse.Namespace:
    """Return the options, checked."""
    known = plant_names()
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_run_options(roots=ROOTS, runs=10, runs_help=f"with {EACH} pushes a force, each")
    parser.add_argument("--push-plants", nargs="*", default=PUSH_PLANTS, choices=known)
    parser.add_argument(
        "--amplitudes", nargs="+", type=float, default=AMPLITUDES, help="[deg], 0 is off"
    )
    parser.add_argument("--plants", nargs="*", default=known, choices=known, help="without touch")
    parser.add_argument("--amplitude", type=float, default=2.0, help="without touch [deg]")
    parser.add_argument("--minutes", type=float, default=60.0, help="without touch; 0 for none")
    given = parser.parse_args()
    for amplitude in (*given.amplitudes, given.amplitude):
        if not 0.0 <= amplitude <= MAX_AMPLITUDE:
            parser.error(f"an amplitude is 0 to {MAX_AMPLITUDE:g} deg, got {amplitude:g}")
    if not 0.0 <= given.minutes <= MAX_MINUTES:
        parser.error(f"--minutes must be 0 to {MAX_MINUTES:g}, got {given.minutes:g}")
    parser.check_run_options(given)
    return given


def main() -> int:
    """Measure, print tables, and return the exit code."""
    given = arguments()
    try:
        results = perform(plan(given), given.json, given.jobs, Console(stderr=True))
    except PepperError as error:
        print(f"attentive.py: {error}", file=sys.stderr)
        return 2
    # A file has no width that cells would have to be folded for.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else FILE_WIDTH)
    if given.push_plants:
        console.print(push_table(results, given))
    if given.minutes and given.plants:
        console.print(free_table(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
