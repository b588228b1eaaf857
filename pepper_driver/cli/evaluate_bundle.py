"""``pepper evaluate --log BUNDLE``: the first hour of a robot, judged like simulated robots and compared with them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from pepper_driver.cli.evaluate_split import print_summary
from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.touch_suites import load_touch_suites
from pepper_driver.config.workers import Workers
from pepper_driver.evaluation.touch.bundles import (
    BUNDLE_OBSERVERS,
    JUDGED,
    JudgedBundle,
    judge_bundles,
)
from pepper_driver.evaluation.touch.ledger import Look, read_ledger
from pepper_driver.evaluation.touch.logs import LogFailure
from pepper_driver.evaluation.touch.look import LEDGER, records_of_look, repository_or_none
from pepper_driver.evaluation.touch.observers import FUSION, check_observers
from pepper_driver.evaluation.touch.page import SimulatedRobots
from pepper_driver.evaluation.touch.report import Origin, write_touch_report
from pepper_driver.evaluation.touch.summary import summarise_touch
from pepper_driver.evaluation.touch.summary_data import TouchSummary
from pepper_driver.first_hour.bundle import is_bundle, open_bundle


@dataclass(frozen=True, kw_only=True)
class EvaluatedBundles:
    """Bundles, and the results of their robots.

    Attributes:
        paths: As given.
        bundles: Those that could be judged.
        failures: Those that could not.
        observers: Names.
        summary: All results.
    """

    paths: tuple[Path, ...]
    bundles: tuple[JudgedBundle, ...]
    failures: tuple[LogFailure, ...]
    observers: tuple[str, ...]
    summary: TouchSummary

    def as_json(self) -> dict[str, Any]:
        """Results of the summary, ``bundles`` and ``failures``."""
        return {
            **self.summary.as_json(),
            "bundles": [
                {
                    "robot": one.record.robot,
                    "identity": one.record.identity,
                    "simulated": one.simulated,
                    "touches": len(one.record.takes[-1].touches),
                    "asked": one.asked,
                    "pressed": one.pressed,
                    "attempts": {log: len(earlier) + 1 for log, earlier in one.earlier.items()},
                }
                for one in self.bundles
            ],
            "failures": [{"title": str(f.path), "reason": f.reason} for f in self.failures],
        }


def bundles_of(paths: Sequence[Path]) -> bool:
    """Return True for bundles of a first hour, False for logs.

    Raises:
        ConfigError: There are some of both.
    """
    found = [path.is_dir() or path.suffix == ".zip" or is_bundle(path) for path in paths]
    if any(found) and not all(found):
        path = paths[found.index(False)]
        raise ConfigError(
            f"{path}: a log among bundles of a first hour; logs are judged by models of your choice and bundles by "
            "their own: give either"
        )
    return any(found)


def evaluate_bundles(
    console: Console, paths: Sequence[Path], observers: Sequence[str] | None, workers: Workers
) -> EvaluatedBundles:
    """Judge the robots of bundles by their own models, and print what was found.

    Raises:
        PepperError: A bundle lacks a part, is damaged, or of another version; no such observer.
    """
    names = tuple(observers or BUNDLE_OBSERVERS)
    check_observers(names)
    robot = load_robot()
    with ExitStack() as opened:
        bundles = [opened.enter_context(open_bundle(path, parts=JUDGED)) for path in paths]
        judged, failures = judge_bundles(bundles, names, workers=workers)
    summary = summarise_touch(
        [one.record for one in judged], names, robot, suites=load_touch_suites(robot)
    )
    print_summary(console, summary, names)
    for one in judged:
        for line in one.lines:
            console.print(line)
    for failure in failures:
        console.print(f"failed: {failure.path}: {failure.reason}")
    return EvaluatedBundles(
        paths=tuple(paths), bundles=judged, failures=failures, observers=names, summary=summary
    )


def write_bundle_report(console: Console, found: EvaluatedBundles, report: Path) -> None:
    """Write the page of bundles, compared with the last complete look at simulated test robots.

    Raises:
        PepperError: The page cannot be written; the ledger or a record of the look is damaged.
    """
    ledger, simulated_robots = _last_complete_look()
    lines = [line for one in found.bundles for line in one.lines]
    lines += [f"{one.path} could not be judged: {one.reason}" for one in found.failures]
    if simulated_robots is None:
        text = (
            "No look at the simulated test robots is complete here: nothing to compare these with."
        )
        lines.append(text)
        console.print(text)
    command = f"pepper evaluate --log {' '.join(path.name for path in found.paths)}"
    origin = Origin(
        command=f"{command} --report {report.name}",
        lines=tuple(lines),
        simulated=bool(found.bundles) and all(one.simulated for one in found.bundles),
        ledger=ledger,
    )
    write_touch_report(
        found.summary, report, load_robot(), origin, simulated_robots=simulated_robots
    )
    console.print(f"report: {report}")


def _last_complete_look() -> tuple[tuple[Look, ...], SimulatedRobots | None]:
    """Return the looks so far, and the robots of the last one that is complete and kept."""
    root = repository_or_none()
    if root is None:
        return (), None
    ledger = read_ledger(root / LEDGER)
    for look in reversed(ledger):
        records = records_of_look(root, look) if look.state == "complete" else ()
        if records and len(records) == look.robots:
            robot = load_robot()
            summary = summarise_touch(
                records, (FUSION,), robot, suites=load_touch_suites(robot), by_state=()
            )
            return ledger, SimulatedRobots(
                summary=summary,
                what=f"the {len(records)} simulated test robots of look {look.look} (draws {look.draws}), each with "
                "models of its own",
            )
    return ledger, None
