"""``pepper calibrate --recordings``: a simulated robot fitted to the recordings of one robot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import isfinite
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pepper_driver.calibration.drive import DriveValues, plant_text
from pepper_driver.calibration.recorded_robot import (
    JointCalibration,
    RobotCalibration,
    calibrate_to,
)
from pepper_driver.cli.console import make_progress
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.workers import Workers
from pepper_driver.first_hour.bundle import Part, open_bundle
from pepper_driver.identification import MANIFEST


def calibrate_robot(
    console: Console,
    path: Path,
    start: PlantConfig,
    robot: RobotConfig,
    name: str,
    workers: Workers,
) -> RobotCalibration:
    """Fit a plant to the recordings of one robot, and print how near it comes.

    Args:
        console: Where it is printed.
        path: Bundle of a first hour, or folder of ``pepper identify --recordings``.
        start: Plant to begin from.
        robot: Its description.
        name: Of the fitted plant.
        workers: Processes, or a cluster.

    Raises:
        PepperError: As :func:`calibrate_to` and :func:`open_bundle`.
    """
    with _recordings(path) as folder, make_progress(console) as progress:
        bar = progress.add_task("replaying", total=1.0)
        found = calibrate_to(
            folder,
            start,
            robot,
            workers=workers,
            progress=lambda fraction: progress.update(bar, completed=fraction),
        )
    found = replace(found, plant=replace(found.plant, name=name))
    _print(console, found, start)
    return found


def robot_plant_text(found: RobotCalibration, start: PlantConfig, extends: str) -> str:
    """Return the plant file of a fitted robot."""
    whose = "a simulated robot" if found.simulated else "a real robot"
    return plant_text(
        start,
        found.plant,
        name=found.plant.name,
        extends=extends,
        comment=f"Fitted by `pepper calibrate --recordings` to those of {whose}; see docs/plant.md.",
    )


@contextmanager
def _recordings(path: Path) -> Iterator[Path]:
    """Yield the folder of recordings: the path itself, or that of a bundle."""
    if (path / MANIFEST).is_file():
        yield path
        return
    parts: tuple[Part, ...] = ("identification",)
    with open_bundle(path, parts=parts) as bundle:
        yield bundle.identification


def _print(console: Console, found: RobotCalibration, start: PlantConfig) -> None:
    whose = "a simulated robot" if found.simulated else "a real robot"
    title = f"plant {found.plant.name}, fitted to recordings of {whose}: before, after"
    console.print(_values(found, title))
    console.print(_tracking(found, f"tracking errors under the same commands: {whose}, simulated"))
    delay, facts = found.plant.response_delay, found.facts
    speed = found.plant.targets.speed_limit
    console.print(
        f"delay from command to sample: {found.delay_before} ticks in '{start.name}', {delay} as measured; late "
        f"{100.0 * facts.late:.1f} %, lost {100.0 * facts.lost:.1f} % of samples; targets run at most "
        + ("as fast as their commands" if speed is None else f"{speed:.2f} rad/s")
    )
    if facts.weight is None:
        console.print(
            f"{facts.weight_doubt or 'no known weight was held'}: heavier arms and weaker motors look alike, and both "
            "count as weaker motors"
        )
    if found.kept:
        console.print(
            f"hardly moved, so their values are those of '{start.name}': {', '.join(found.kept)}"
        )


def _values(found: RobotCalibration, title: str) -> Table:
    table = _table(title, "joint", "K N m/rad", "F N m", "lead ms", "dead band deg", "Ti s", "eta")
    for name, joint in found.joints.items():
        before, after = _cells(joint.before), _cells(joint.after)
        pairs = (a if a == b == "-" else f"{b}, {a}" for b, a in zip(before, after, strict=True))
        table.add_row(name, *pairs, f"{joint.efficiency:.2f}")
    return table


def _cells(values: DriveValues) -> list[str]:
    band, lead = float(np.degrees(values.dead_band)), values.lead or 0.0
    return [
        f"{values.stiffness:.3g}",
        f"{values.friction:.2g}",
        f"{1e3 * lead:.1f}",
        f"{band:.2f}" if band else "-",
        f"{values.integral_time:.2g}" if isfinite(values.integral_time) else "-",
    ]


def _tracking(found: RobotCalibration, title: str) -> Table:
    table = _table(
        title, "joint", "p50/p90 deg", "before", "after", "fit before", "after %", "runs"
    )
    for name, joint in found.joints.items():
        table.add_row(name, *_row(joint))
    return table


def _row(joint: JointCalibration) -> list[str]:
    before, after = joint.tracking_before, joint.tracking_after
    return [
        f"{joint.median_deg:.2f}/{joint.p90_deg:.2f}",
        f"{before.median_deg:.2f}/{before.p90_deg:.2f}",
        f"{after.median_deg:.2f}/{after.p90_deg:.2f}",
        f"{before.fit:.0f}",
        f"{after.fit:.0f}",
        "held out" if joint.held_out else "of the fit",
    ]


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(name, justify="right" if number else "left")
    return table
