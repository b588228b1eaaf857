"""``pepper first-hour``: from the first look at a robot to an archive with models, recordings and labelled touches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.backends.readiness import CheckResult
from pepper_driver.backends.selection import parse_uri
from pepper_driver.cli.console import (
    JsonOption,
    LineProgress,
    WorkersOption,
    check_outputs,
    duration_text,
    finite,
    make_console,
    make_progress,
    save_json,
    show_line,
)
from pepper_driver.cli.doctor import print_checks
from pepper_driver.cli.identify import (
    print_fits,
    print_measured,
    recording_progress,
    refuse_unattended,
)
from pepper_driver.config import ConfigError, PepperError, load_robot
from pepper_driver.config.first_hour import load_first_hour
from pepper_driver.first_hour.bundle import ARCHIVE
from pepper_driver.first_hour.hour import run_hour
from pepper_driver.first_hour.operator import Consent, Operator, TerminalOperator
from pepper_driver.first_hour.plan import BY_KEY, HourPlan, PlannedStep, plan_hour
from pepper_driver.first_hour.state import STATE, FirstHour, StepName, new_hour
from pepper_driver.first_hour.steps import RobotSteps, check_readiness, read_robot
from pepper_driver.identification import Identification
from pepper_driver.identification import Progress as RecordingProgress
from pepper_driver.identification.measurements.program import Hand, held_weight
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from pepper_driver.recording.labels import LabelSource
from pepper_driver.recording.terminal_keys import NoTerminalError


def first_hour(
    out: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER", help="For all that is recorded; one that was begun is continued."
        ),
    ],
    backend: Annotated[str, typer.Option(metavar="URI", help="The robot.")] = "mujoco",
    label: Annotated[
        LabelSource,
        typer.Option(
            help="Source of the labels of touches; key is the space bar, and q then stops the robot."
        ),
    ] = "key",
    prompts: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE",
            help="Touches that the robot asks for: standard, scale for a person with a spring scale, or a file.",
        ),
    ] = None,
    weight: Annotated[
        float | None,
        typer.Option(
            metavar="KG",
            help="Known weight, such as 0.5, that you hang into a hand when asked: it fixes the scale of torques.",
            callback=finite,
        ),
    ] = None,
    hand: Annotated[Hand, typer.Option(help="Hand that carries the weight.")] = "left",
    pack: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help=f"Archive to pack at the end; by default {ARCHIVE} in the folder."
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Plan of your own; by default the shipped first_hour.yaml."
        ),
    ] = None,
    again: Annotated[
        StepName | None,
        typer.Option(
            help="Step to make again although it is done, as where a person touched the robot. Its log is kept under "
            "another name, and the page of results counts the attempts.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the plan; no robot is looked for.")
    ] = False,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes", help="Do not ask before the robot moves; on a real one not with --weight."
        ),
    ] = False,
    workers: WorkersOption = None,
    json_file: JsonOption = None,
) -> int:
    """Check, measure and identify a robot, count false contacts, ask for touches, and pack all of it; resumable."""
    console = make_console()
    robot = load_robot()
    settings = load_first_hour(plan)
    held = None if weight is None else held_weight(weight, hand)
    hour_plan = plan_hour(robot, settings, label=label, weight=held, prompts=prompts)
    print_plan(console, hour_plan)
    if dry_run:
        return 0
    archive = out / ARCHIVE if pack is None else pack
    if archive.suffix != ".zip":
        raise ConfigError(f"{archive}: the packed hour is an archive and ends in .zip")
    check_outputs(json_file, pack)
    if parse_uri(backend).query.get("wake", "0") != "0":
        raise ConfigError(
            "with '?wake=1' the robot would lie down after each of many runs: wake it up once, by pressing the button "
            "on its chest twice, and leave that out"
        )
    if yes:
        refuse_unattended(backend, held)
    show = _shower(console)
    operator: Operator = Consent(show) if yes else TerminalOperator(show, settings.answer)
    if label == BY_KEY and (sys.stdin is None or not sys.stdin.isatty()):
        raise NoTerminalError
    try:
        info, _ = read_robot(backend, robot)
    except PepperError:
        if (out / STATE).exists():
            console.print(
                f"all that was recorded is kept in {out}: the same command goes on from there"
            )
        raise
    asked = new_hour(
        robot,
        info,
        plan=hour_plan.hash(),
        prompts=hour_plan.prompts,
        label=label,
        weight=held,
    )
    steps = RobotSteps(
        uri=backend,
        info=info,
        robot=robot,
        plan=hour_plan,
        folder=out,
        archive=archive,
        operator=operator,
        display=ConsoleDisplay(console),
        workers=workers or -1,
    )
    hour = run_hour(
        out,
        asked,
        hour_plan,
        steps.actions(),
        operator,
        introduce=partial(_print_step, console),
        check=partial(check_readiness, backend, robot, info.identity),
        show=console.print,
        again=again,
    )
    if not archive.exists():  # all steps were done before, and --pack names another file now
        steps.pack()
    _print_end(console, hour)
    save_json(json_file, {step.name: dict(step.figures) for step in hour.steps}, console)
    console.print(f"folder: {out}; archive: {archive}")
    return 0


def print_plan(console: Console, plan: HourPlan) -> None:
    """Print the steps, with their times, and both sums."""
    table = Table(title="first hour", title_justify="left")
    table.add_column("step")
    table.add_column("robot", justify="right")
    table.add_column("your hands", justify="right")
    table.add_column("what")
    for step in plan.steps:
        table.add_row(step.name, duration_text(step.robot), duration_text(step.hands), step.title)
    console.print(table)
    console.print(
        f"robot time {duration_text(plan.robot)} in all; your hands are needed for {duration_text(plan.hands)}. Each "
        "step is confirmed before the robot moves; between steps it is let go"
    )


def _print_step(console: Console, step: PlannedStep) -> None:
    console.print(f"\n{step.name}: {step.title}, {duration_text(step.robot)}")
    console.print(f"  do      {step.do}")
    console.print(f"  stop    {step.stop}")
    console.print(f"  normal  {step.normal}")


def _print_end(console: Console, hour: FirstHour) -> None:
    for step in hour.steps:
        figures = ", ".join(f"{name} {_text(value)}" for name, value in step.figures.items())
        console.print(f"{step.name}: {figures}")


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, tuple):
        return "none" if not value else "+".join(map(str, value))
    return str(value)


def _shower(console: Console) -> Callable[[str], None]:
    return lambda text: console.print(text)


class ConsoleDisplay:
    """Shows on a console what the steps do and find."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def line(self, text: str) -> None:
        """Show a line, also from a callback's thread."""
        show_line(self._console, text)

    def checks(self, results: Sequence[CheckResult]) -> None:
        """Show checks of the doctor."""
        print_checks(self._console, results)

    def measured(self, robot: MeasuredRobot) -> None:
        """Show facts about a robot."""
        print_measured(self._console, robot)

    def identification(self, result: Identification) -> None:
        """Show models: how they fit, and what touch they notice."""
        print_fits(self._console, result)

    @contextmanager
    def bar(self, what: str) -> Iterator[Callable[[float], None]]:
        """Show a bar while the block is open."""
        with make_progress(self._console) as progress:
            bar = progress.add_task(what, total=1.0)
            yield lambda fraction: progress.update(bar, completed=fraction)

    @contextmanager
    def runs(self, operator: Operator) -> Iterator[tuple[RecordingProgress, Operator]]:
        """Show the progress of runs, and make room for questions."""
        with recording_progress(self._console) as (progress, bars):
            yield progress, _WithoutBars(operator, bars)


class _WithoutBars:
    """Asks an operator while no bar is shown."""

    def __init__(self, operator: Operator, bars: LineProgress) -> None:
        self._operator, self._bars = operator, bars

    def confirm(self, question: str) -> None:
        self._bars.stop()
        self._operator.confirm(question)
        self._bars.start()

    def offer(self, question: str) -> bool:
        self._bars.stop()
        answer = self._operator.offer(question)
        self._bars.start()
        return answer
