"""``pepper evaluate --split``: robots of a population that people touch, judged by the events that a program gets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from pepper_driver.cli.console import make_progress
from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.cluster import Cluster
from pepper_driver.config.files import make_folder
from pepper_driver.config.population import parse_draws
from pepper_driver.config.touch_suites import Split, TouchSuites, load_touch_suites
from pepper_driver.config.workers import Workers
from pepper_driver.evaluation.touch.ledger import Look, as_rows, read_ledger
from pepper_driver.evaluation.touch.look import (
    LEDGER,
    last_look,
    repository,
    repository_or_none,
    take_look,
)
from pepper_driver.evaluation.touch.observers import DEFAULT, DEVELOPMENT, check_observers
from pepper_driver.evaluation.touch.records import RobotRecord
from pepper_driver.evaluation.touch.report import Origin
from pepper_driver.evaluation.touch.split import Judging, judge
from pepper_driver.evaluation.touch.summary import summarise_touch
from pepper_driver.evaluation.touch.summary_data import (
    ALL,
    GROUPS,
    Cell,
    FalseContacts,
    ObserverSummary,
    TouchSummary,
)

DEFAULT_FOLDER = Path("runs/evaluation/touch")

PARTS = ("touch", "free")
"""Of a split: takes with touches, and those without."""


@dataclass(frozen=True, kw_only=True)
class SplitOptions:
    """Options of the command; None for the usual."""

    split: Split
    draws: str | None = None
    parts: tuple[str, ...] | None = None
    observers: tuple[str, ...] | None = None
    quick: bool = False
    note: str = ""
    give_up: bool = False
    last_look: bool = False
    folder: Path = DEFAULT_FOLDER


@dataclass(frozen=True, kw_only=True)
class JudgedSplit:
    """Robots of a split, and the results of all observers.

    Attributes:
        options: As they were given.
        suites: By which they were judged.
        look: Line of the ledger; None of a development split.
        records: The robots.
        observers: Names.
        summary: The results.
    """

    options: SplitOptions
    suites: TouchSuites
    look: Look | None
    records: tuple[RobotRecord, ...]
    observers: tuple[str, ...]
    summary: TouchSummary

    def as_json(self) -> dict[str, Any]:
        """Return the results, and the look that they are of."""
        look = None if self.look is None else as_rows([self.look])[0]
        return {
            "split": self.options.split,
            "simulated": True,
            "quick": self.options.quick,
            "suites": self.suites.digest if self.look is None else self.look.suites,
            "look": look,
            **self.summary.as_json(),
        }

    def origin(self, report: Path) -> Origin:
        """Return the origin of the results, for a page."""
        robots = ", ".join(str(record.draw) for record in self.records)
        look, suites = self.look, self.suites.digest
        quick = " Few and short takes: to try, not to quote." if self.options.quick else ""
        if look is not None:
            suites = look.suites
        by = (
            f"Look {look.look} at the test split, begun {look.begun.date()}, from commit {look.commit[:12]}: code "
            f"{look.code}, constants {look.constants}"
            if look is not None
            else "Development split: robots that constants may be chosen on"
        )
        root = repository_or_none()
        return Origin(
            command=f"pepper evaluate --split {self.options.split}"
            f"{' --last-look' if self.options.last_look else ''} --report {report.name}",
            lines=(
                f"{by}. Suites {suites}. Draws of `{self.suites.population}`: {robots}.{quick}",
            ),
            development=look is None,
            ledger=() if root is None else read_ledger(root / LEDGER),
        )

    @property
    def failed(self) -> bool:
        """True if a robot, a take or an observer gave no result."""
        return any(robot.failure or robot.failed_takes for robot in self.summary.robots) or any(
            observer.failures for observer in self.summary.observers
        )


def judge_split(options: SplitOptions, workers: Workers, console: Console) -> JudgedSplit:
    """Judge the robots of a split, and print what is done.

    Raises:
        PepperError: An option is wrong, or the split cannot be judged.
    """
    robot = load_robot()
    suites = load_touch_suites(robot)
    _check_options(options)
    if options.last_look:
        look, records = last_look(repository())
        found = (name for record in records for take in record.takes for name in take.hearings)
        return _summed(options, suites, look, records, tuple(dict.fromkeys(found)))
    spec = suites.splits[options.split]
    parts = options.parts or PARTS
    if unknown := [name for name in parts if name not in PARTS]:
        raise ConfigError(f"a split has the suites {' and '.join(PARTS)}, not '{unknown[0]}'")
    names = options.observers or (DEFAULT if options.split == "test" else DEVELOPMENT)
    check_observers(names)
    judging = Judging(
        suites=suites,
        free=spec.free if "free" in parts else 0.0,
        observers=names,
        folder=options.folder,
        records=options.folder / options.split,
        quick=options.quick,
        touch="touch" in parts,
        keep_recordings=options.split == "development",
    )
    if isinstance(workers, Cluster):
        workers.check(
            partial(make_folder, options.folder), "give '--folder' a folder that all machines share"
        )
    begun: Look | None = None
    with make_progress(console) as progress:
        bar = progress.add_task("judging", total=None)

        def show(what: str, done: float, total: float) -> None:
            progress.update(bar, completed=done, total=total, description=f"judging ({what})")

        if options.split == "test":
            begun, records = take_look(
                judging,
                root=repository(),
                note=options.note,
                give_up=options.give_up,
                workers=workers,
                begun=lambda look: console.print(
                    f"look {look.look} at the draws {look.draws}, from commit {look.commit[:12]}; its line is in the "
                    "ledger"
                ),
                progress=show,
            )
        else:
            draws = range(spec.first, spec.first + spec.robots)
            numbers = tuple(draws) if options.draws is None else parse_draws(options.draws)
            records = judge(judging, numbers, workers=workers, progress=show)
    return _summed(options, suites, begun, records, names)


def _summed(
    options: SplitOptions,
    suites: TouchSuites,
    look: Look | None,
    records: tuple[RobotRecord, ...],
    observers: tuple[str, ...],
) -> JudgedSplit:
    return JudgedSplit(
        options=options,
        suites=suites,
        look=look,
        records=records,
        observers=observers,
        summary=summarise_touch(records, observers, load_robot(), suites=suites),
    )


def _check_options(options: SplitOptions) -> None:
    """Refuse options of the other split, and those that would make a look another than the looks before."""
    if options.split == "development":
        of_looks = {
            "--note": options.note,
            "--give-up": options.give_up,
            "--last-look": options.last_look,
        }
        for name, value in of_looks.items():
            if value:
                raise ConfigError(f"{name} is for looks at the test split: leave it out")
        return
    given = {
        "--draws": options.draws,
        "--suite": options.parts,
        "--observer": options.observers,
        "--quick": options.quick or None,
    }
    for name, value in given.items():
        if value is not None:
            raise ConfigError(
                f"the test split is judged whole: leave out {name}; it is for the development split"
            )


def print_summary(console: Console, summary: TouchSummary, observers: Sequence[str]) -> None:
    """Print N90 of the first observer, the false contacts of all, and what failed."""
    ours = summary.observer(observers[0])
    if ours is not None:
        _print_n90(console, summary, ours)
    events = _table(
        "by the events of a program", "observer", "detected", "false", "hours", "an hour, 95 %"
    )
    where = _table("of detected touches", "observer", "limb", "joint, 150 ms", "direction")
    for name in observers:
        one = summary.observer(name)
        if one is None:
            continue
        detected, located = one.detected(), next((p for p in one.located if p.law == ALL), None)
        counts = f"{detected.count} of {detected.of}"
        events.add_row(name, counts, *_false_cells(one.false_contacts()))
        if located is not None:
            parts = (located.first_limb, located.joint_later, located.direction)
            where.add_row(name, *(_fraction(part.fraction) for part in parts))
    for table in (events, where):
        if table.row_count:
            console.print(table)
    for robot in summary.robots:
        if robot.failure:
            console.print(
                f"failed: {robot.robot}: not identified, its touches count as not detected: {robot.failure}"
            )
        for take, reason in robot.failed_takes.items():
            console.print(f"failed: {robot.robot}, {take}: {reason}")
    for name in observers:
        for reason, count in _failures(summary, name):
            console.print(f"failed: {name}, {count} takes: {reason}")


def _failures(summary: TouchSummary, name: str) -> Iterable[tuple[str, int]]:
    one = next((o for o in summary.observers if o.name == name), None)
    return () if one is None else one.failures.items()


def _print_n90(console: Console, summary: TouchSummary, ours: ObserverSummary) -> None:
    for law in summary.laws:
        groups = [group for group in GROUPS if any(c.state == group for c in ours.groups)]
        title = f"N90 of {ours.name} in newtons, boards as of '{law}'"
        table = _table(title, "place", *groups)
        for place in summary.places:
            cells = [ours.group(law, place, group) for group in groups]
            if any(cell is not None for cell in cells):
                table.add_row(place, *map(_n90, cells))
        if table.row_count:
            console.print(table)


def _n90(cell: Cell | None) -> str:
    return "-" if cell is None or cell.n90 is None else cell.n90.text


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left")
    for number, name in enumerate(columns):
        table.add_column(name, justify="right" if number else "left")
    return table


def _false_cells(false: FalseContacts | None) -> tuple[str, str, str]:
    if false is None:
        return ("-",) * 3
    rate = false.rate
    per_hour = (
        "-" if rate.per_hour is None else f"{rate.per_hour:.1f} ({rate.low:.1f}-{rate.high:.1f})"
    )
    return f"{false.begins} + {false.moves} moves", f"{false.hours:.2f}", per_hour


def _fraction(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
