"""``pepper run`` and ``pepper move``: play experiments and motions written in YAML."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.callbacks.events import CueEvent, PushEvent, ReflexEvent, StepEvent
from pepper_driver.cli.console import (
    AttentiveOption,
    JsonOption,
    ModelsOption,
    RealTimeOption,
    ViewOption,
    check_outputs,
    make_console,
    save_json,
    show_line,
    show_timing,
    shown_in_browser,
)
from pepper_driver.config import RobotConfig
from pepper_driver.config.steps import AnyStep, BranchStep, PlayStep, RepeatStep, Step
from pepper_driver.config.task_specs import BaseSpec, LookAtSpec, OrientationSpec, PoseSpec
from pepper_driver.experiments.experiment import ExperimentRun
from pepper_driver.experiments.reports import ExperimentReport, StepReport
from pepper_driver.observer import Contact, score
from pepper_driver.observer.scoring import group_events
from pepper_driver.recording.terminal_keys import StopKey


def step_times(step: Step) -> str:
    """Time that a step takes."""
    if step.wait is not None:
        return f"at most {step.wait.timeout:.2f} s"
    if not step.max_duration:
        return "no time"
    parts = [] if step.duration is None else [f"{step.duration:.2f} s"]
    if step.until is not None:
        parts.append(f"until reached, {step.timeout:.2f} s at most")
    if step.hold:
        parts.append(f"hold {step.hold:.2f} s")
    return ", ".join(parts)


def step_parts(step: Step, robot: RobotConfig) -> Iterator[str]:
    """Describe a step, part by part."""
    yield from map(str, CueEvent.of(step, 0.0))
    if (wait := step.wait) is not None:
        yield f"wait for a {wait}, or {'stop' if wait.on_timeout == 'stop' else 'continue'}"
    if step.posture is not None:
        yield f"posture {step.posture}"
    for joint, angle in step.joints.items():
        yield f"{joint} to {angle:g}{'' if joint in robot.hands.joints else ' rad'}"
    yield from (f"{hand} to {aperture:g}" for hand, aperture in step.hands.items())
    if step.stiffness is not None:
        yield f"posture stiffness {step.stiffness:g} 1/s2"
    if step.attentive is not None:
        yield "attentive" if step.attentive else "no longer attentive"
    for _, task in step.tasks():
        kept = ", kept" if task.keep else ""
        if isinstance(task, BaseSpec):
            parts = (("x", task.x, "m"), ("y", task.y, "m"), ("heading", task.heading, "rad"))
            goal = ", ".join(
                f"{key} {value:g} {unit}" for key, value, unit in parts if value is not None
            )
            yield f"base to {goal}{kept}"
            continue
        if isinstance(task, LookAtSpec):
            goal = task.link or f"{_numbers(task.point or ())} m"
            yield f"look at {goal}{kept}"
            continue
        base = ", with the base" if task.base else ""
        if isinstance(task, OrientationSpec):
            goal = f"quaternion {_numbers(task.quaternion)}"
        elif isinstance(task, PoseSpec):
            goal = f"{_numbers(task.position)} m, quaternion {_numbers(task.quaternion)}"
        else:
            goal = f"{_numbers(task.target)} m"
        where = "" if task.root is None else f" from {task.root}"
        yield f"{task.label} to {goal}{where}{base}{kept}"
    if (twist := step.base_velocity) is not None:
        yield f"base at {twist.vx:g} {twist.vy:g} m/s, {twist.wz:g} rad/s"


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)


Event = StepEvent | CueEvent | PushEvent | Contact | ReflexEvent


def run_command(
    file: Annotated[
        str,
        typer.Argument(
            metavar="NAME_OR_FILE", help="A shipped experiment or motion, or a file name.yaml."
        ),
    ],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to run it on.")] = "mujoco",
    models: ModelsOption = None,
    log: Annotated[Path | None, typer.Option(metavar="FILE", help="MCAP log to write.")] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Seed of random goals and contacts; by default that of the experiment.",
            min=0,
        ),
    ] = None,
    no_contacts: Annotated[
        bool, typer.Option("--no-contacts", help="Leave out the contacts for a simulated robot.")
    ] = False,
    attentive: AttentiveOption = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check everything and print the plan; move nothing.")
    ] = False,
    real_time: RealTimeOption = False,
    view: ViewOption = False,
    json_file: JsonOption = None,
) -> int:
    """Play an experiment or a motion; code 1 if it stopped early or a step gave up reaching its targets.

    The space bar or q stops the robot at once.
    """
    console = make_console()
    run = ExperimentRun(
        file,
        backend,
        log=None if dry_run else log,
        real_time=real_time or view,
        seed=seed,
        models=models,
        contacts=not no_contacts,
        attentive=attentive or None,
    )
    check_outputs(json_file)
    if dry_run:
        for line in plan_lines(run):
            console.print(line)
        save_json(json_file, plan_json(run), console)
        return 0
    print_events(console, run)
    page = shown_in_browser(console, run.pepper) if view else nullcontext()
    with page, StopKey(run.pepper.emergency_stop) as key:
        if key.listening:
            console.print(key.HELP)
        try:
            report = run.perform(on_step=lambda step: show_reached(console, step))
        finally:
            if run.report is not None:  # even where the log could not be written to its end
                show_report(console, run, run.report, log, json_file)
    return 0 if report.completed else 1


def show_report(
    console: Console,
    run: ExperimentRun,
    report: ExperimentReport,
    log: Path | None,
    json_file: Path | None,
) -> None:
    """Print what came of an experiment, and store its figures."""
    if run.pepper.paced:
        show_timing(console, run.pepper.statistics)
    console.print(str(report))
    if report.pushes:
        console.print(push_table(report, run.pepper.config))
    if log is not None:
        console.print(f"log: {log}")
    save_json(json_file, report.as_json(), console)


def show_reached(console: Console, step: StepReport) -> None:
    """Print what a step reached that has tasks, or waits for its targets."""
    if step.reached is not None or any(goal.name != "posture" for goal in step.goals):
        show_line(console, f"{step.time:8.2f} s  {step}")


def push_table(report: ExperimentReport, robot: RobotConfig) -> Table:
    """Make a table of each push: its detection delay, its place at first and at last."""
    result = score(report.pushes, report.contacts, robot)
    detected = {id(f.push): f for f in result.detected}
    last = {
        alarm.begin.id: alarm.updates[-1].link if alarm.updates else alarm.begin.link
        for alarm in group_events(report.contacts)
    }
    title = f"{len(detected)} of {len(report.pushes)} pushes detected, {len(result.false)} false contacts"
    table = Table("from", "pushed", "force", "detected after", "at first", "at last", title=title)
    table.title_justify = "left"
    for push in report.pushes:
        row = [f"{push.onset:.2f} s", push.link, f"{push.force:.1f} N"]
        if (found := detected.get(id(push))) is None:
            table.add_row(*row, "-")
        else:
            begin = found.contact
            row.append(f"{1e3 * found.delay:.0f} ms")
            table.add_row(*row, begin.link, last[begin.id])
    return table


def print_events(console: Console, run: ExperimentRun) -> None:
    """Print what happens as it happens: steps, cues, pushes, contacts, reflexes."""
    pepper = run.pepper

    def print_event(event: Event) -> None:
        if (text := event_text(event)) is not None:
            show_line(console, f"{event.time:8.2f} s  {text}")

    # One function for all events keeps their order.
    registrations: list[Callable[[Callable[..., object]], object]] = [
        pepper.on_step(),
        pepper.on_cue(),
        pepper.on_push(),
        pepper.on_reflex(phase=None),
    ]
    if run.experiment.observer is not None:
        registrations.append(pepper.on_contact(phase=None))
    for register in registrations:
        register(print_event)


def event_text(event: Event) -> str | None:
    """Describe one event; None for what is not worth a line."""
    if isinstance(event, StepEvent):
        return f"step {event.step}"
    if isinstance(event, CueEvent):
        return str(event)
    if isinstance(event, PushEvent):
        start = "" if event.push is None else f"from {event.push.onset:.2f} s "
        return f"push  {event.link}: {start}{event.text}"
    if isinstance(event, ReflexEvent):
        held = f", has {len(event.held_joints)} joints" if event.held_joints else ""
        return f"reflex {event.reflex}: {event.phase}{held}"
    if event.phase == "update":
        return None
    degrees = f"{event.intensity_deg:.1f} deg" if event.intensity_deg else "-"  # wheels have none
    torque = "" if event.torque is None else f", {abs(event.torque):.1f} N m"
    text = (
        f"{event.kind} {event.link}: {event.phase}, {event.joint or 'trunk'} {event.direction:+d}"
    )
    force = f", {event.force_text}" if event.force_text else ""
    return f"{text}, {degrees}{torque}{force}"


def plan_lines(run: ExperimentRun) -> Iterator[str]:
    """Describe what would be done, one line for each step, reaction and contact."""
    experiment, plan = run.experiment, run.plan()
    times = "at most " if experiment.is_open else ""
    yield f"{experiment.name}: {times}{experiment.max_length:.1f} s"
    yield from _step_lines(run, experiment.steps, "steps", "  ")
    for reaction in experiment.reactions:
        answers = [*map(str, CueEvent.of(reaction, 0.0))]
        answers += [f"play {reaction.play}"] if reaction.play else []
        answers += [str(reaction.reflex["do"])] if reaction.reflex else []
        yield f"  on {reaction.on}: {'; '.join(answers)}"
    for reflex in run.pepper.reflexes:
        yield f"  reflex {reflex.name}: priority {reflex.priority}, then {reflex.then}"
    for name, contacts in [
        ("begin", plan.at_begin),
        *((s.name, s.contacts) for s in plan.segments),
    ]:
        yield from (f"  {name} + {c.delay:.2f} s: {c.planned.link} {c}" for c in contacts)


def _step_lines(
    run: ExperimentRun, steps: Sequence[AnyStep], key: str, indent: str
) -> Iterator[str]:
    """Describe steps, those that they hold below them, a little further in."""
    for number, step in enumerate(steps):
        here = f"{key}.{number}"
        own = f"{here}.branch" if isinstance(step, BranchStep) else here
        for segment in run.plan().rounds.get(own, [[]])[0]:
            parts = step_parts(segment.step, run.pepper.config)
            text = "; ".join([step_times(segment.step), *parts])
            yield f"{indent}{segment.start:7.2f} s  {segment.name}: {text}"
        for title, (inner, block) in zip(_block_titles(step), step.blocks(), strict=True):
            if block:
                yield f"{indent}{title}:"
                yield from _step_lines(run, block, f"{here}.{inner}", indent + "  ")


def _block_titles(step: AnyStep) -> list[str]:
    """Describe when the blocks of a step are played."""
    if isinstance(step, RepeatStep):
        until = f", or until {step.repeat.until}" if step.repeat.until is not None else ""
        return [f"{step.repeat.times} times{until}"]
    if isinstance(step, BranchStep):
        return [*(f"after {case.on}" for case in step.branch.cases), "otherwise"]
    return [f"play {step.play}"] if isinstance(step, PlayStep) else []


def plan_json(run: ExperimentRun) -> dict[str, Any]:
    """Make the plan, for files."""
    plan = run.plan()
    return {
        "experiment": run.experiment.name,
        "max_duration": run.experiment.max_length,
        "steps": [{"key": s.key, "name": s.name, "from": s.start} for s in plan.segments],
        "reflexes": [{"name": r.name, "priority": r.priority} for r in run.pepper.reflexes],
        "contacts": len(plan.at_begin) + sum(len(s.contacts) for s in plan.segments),
    }
