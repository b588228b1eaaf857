"""``pepper run``: performs an experiment written in YAML."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.callbacks.events import CueEvent, PushEvent, ReflexEvent, StepEvent
from pepper_driver.cli.console import (
    JsonOption,
    RealTimeOption,
    check_outputs,
    make_console,
    save_json,
    show_line,
    show_timing,
)
from pepper_driver.cli.steps import step_parts, step_times
from pepper_driver.config import Experiment, MotionStep, RobotConfig
from pepper_driver.config.experiment_steps import (
    ContactWait,
    PlayedStep,
    SayStep,
    WaitStep,
    is_open,
)
from pepper_driver.experiment import ExperimentRun
from pepper_driver.experiment_plan import push_text
from pepper_driver.keys import StopKey
from pepper_driver.observer import Contact
from pepper_driver.reflexes import Reflex


def run_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The experiment, a YAML file.")],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to run it on.")] = "mujoco",
    log: Annotated[Path | None, typer.Option(metavar="FILE", help="MCAP log to write.")] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Check everything and print the plan; move nothing."),
    ] = False,
    real_time: RealTimeOption = False,
    json_file: JsonOption = None,
) -> int:
    """Perform an experiment; code 1 if it stopped early or a step gave up reaching its targets.

    The space bar or q stops the robot at once.
    """
    console = make_console()
    run = ExperimentRun(file, backend, log=None if dry_run else log, real_time=real_time)
    check_outputs(json_file)
    if dry_run:
        show_plan(console, run)
        save_json(json_file, plan_json(run), console)
        return 0
    if skipped := run.plan().skipped:
        console.print(skipped)
    tell_all(console, run)
    with StopKey(run.pepper.emergency_stop) as key:
        if key.listening:
            console.print(key.HELP)
        report = run.perform()
    if run.pepper.paced:
        show_timing(console, run.pepper.statistics)
    console.print(str(report))
    if log is not None:
        console.print(f"log: {log}")
    save_json(json_file, report.as_json(), console)
    return 0 if report.completed else 1


def tell_all(console: Console, run: ExperimentRun) -> None:
    """Print what happens as it happens: steps, cues, pushes, contacts, reflexes."""
    pepper = run.pepper

    def tell(event: StepEvent | CueEvent | PushEvent | Contact | ReflexEvent) -> None:
        if (text := event_text(event)) is not None:
            show_line(console, f"{event.time:8.2f} s  {text}")

    # One function for all: it is told of everything in the order in which it happened.
    ways: list[Callable[[Callable[..., object]], object]] = [
        pepper.on_step(),
        pepper.on_cue(),
        pepper.on_push(),
        pepper.on_contact(phase=None),
        pepper.on_reflex(phase=None),
    ]
    for register in ways:
        register(tell)


def event_text(event: StepEvent | CueEvent | PushEvent | Contact | ReflexEvent) -> str | None:
    """One event for people; None for what is not worth a line."""
    if isinstance(event, StepEvent):
        return f"step {event.step}"
    if isinstance(event, CueEvent):
        return str(event)
    if isinstance(event, PushEvent):
        return f"push  {event.link}: {event.text}"
    if isinstance(event, ReflexEvent):
        return f"reflex {event.reflex}: {event.phase}"
    if event.phase == "update":
        return None
    text = f"{event.kind} {event.link}: {event.phase}"
    return f"{text}, {event.joint or 'trunk'} {event.direction:+d}, {event.intensity:.1f} deg"


def show_plan(console: Console, run: ExperimentRun) -> None:
    """Print what would be done."""
    experiment, robot = run.experiment, run.pepper.config
    times = "at most " if any(is_open(step) for step in experiment.written.values()) else ""
    console.print(
        f"{experiment.name}: {len(experiment.order)} steps, {times}{experiment.length:.1f} s"
    )
    table = Table("step", "from", "times", "takes", "does", title="steps", title_justify="left")
    for row in _rows(experiment, robot):
        table.add_row(*row)
    console.print(table)
    if reflexes := run.pepper.reflexes:
        table = Table("priority", "reflex", "answers to", "then", title="reflexes")
        table.title_justify = "left"
        for reflex in reflexes:
            table.add_row(str(reflex.priority), reflex.name, _answers(reflex), reflex.then)
        console.print(table)
    pushes = run.plan()
    if pushes.skipped:
        console.print(pushes.skipped)
    elif experiment.pushes:
        table = Table("when", "link", "push", title="pushes", title_justify="left")
        names = [step.name or "" for step in experiment.written.values()]
        groups = [("begin", pushes.at_begin)]
        groups += [(names[number], touches) for number, touches in pushes.in_step.items()]
        for where, touches in groups:
            for touch in touches:
                table.add_row(f"{where} + {touch.delay:g} s", touch.planned.link, push_text(touch))
        console.print(table)


def plan_json(run: ExperimentRun) -> dict[str, Any]:
    """The plan, for files."""
    experiment, pushes = run.experiment, run.plan()
    return {
        "experiment": experiment.name,
        "longest": experiment.length,
        "steps": [
            {"key": key, "name": step.name, "from": start}
            for (key, step), start in zip(experiment.played, experiment.starts, strict=True)
        ],
        "reflexes": [
            {"name": reflex.name, "priority": reflex.priority} for reflex in run.pepper.reflexes
        ],
        "pushes": sum(map(len, (pushes.at_begin, *pushes.in_step.values()))),
        "pushes_skipped": pushes.skipped or None,
    }


def _rows(experiment: Experiment, robot: RobotConfig) -> Iterator[tuple[str, str, str, str, str]]:
    """One row for each step as the file has it."""
    played = [key for key, _ in experiment.played]
    for number, (key, step) in enumerate(experiment.written.items()):
        motion = experiment.motion.steps[number]
        yield (
            f"{number} {motion.name or ''}".strip(),
            f"{experiment.starts[played.index(key)]:.2f} s",
            str(played.count(key)),
            _takes(step, motion),
            "; ".join(_does(step, robot)),
        )


def _takes(step: PlayedStep, motion: MotionStep) -> str:
    if isinstance(step, MotionStep):
        return step_times(step)
    if isinstance(step, WaitStep):
        return f"{'at most ' if is_open(step) else ''}{motion.longest:.2f} s"
    return "no time"


def _does(step: PlayedStep, robot: RobotConfig) -> Iterator[str]:
    if isinstance(step, MotionStep):
        yield from step_parts(step, robot)
    elif isinstance(step, SayStep):
        yield f"say: {step.say}"
    elif isinstance(step, WaitStep):
        yield _waits(step)
    else:
        r, g, b = step.leds.colour
        yield f"{step.leds.group} to {r:g} {g:g} {b:g}"


def _waits(step: WaitStep) -> str:
    wait = step.wait
    if not isinstance(wait, ContactWait):
        return "wait"
    which = _which(wait.link, wait.joint, wait.kind, wait.min_intensity)
    return f"wait for {which}, or {'stop' if wait.otherwise == 'stop' else 'go on'}"


def _answers(reflex: Reflex) -> str:
    return _which(reflex.link, reflex.joint, reflex.kind, reflex.min_intensity)


def _which(link: str | None, joint: str | None, kind: str | None, intensity: float) -> str:
    """Contacts of a choice, for people."""
    text = f"a {kind or 'contact'}"
    if link is not None:
        text += f" on {link}"
    if joint is not None:
        text += f" felt by {joint}"
    return text + (f", {intensity:g} deg and more" if intensity else "")
