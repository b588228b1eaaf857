"""``pepper move``: plays a motion written in YAML."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from pepper_driver.cli.console import (
    JsonOption,
    RealTimeOption,
    check_outputs,
    make_console,
    save_json,
    show_line,
    show_timing,
)
from pepper_driver.config import Motion, MotionStep, RobotConfig, load_motion, load_robot
from pepper_driver.config.motion_tasks import BaseSpec, LookAtSpec, OrientationSpec, PoseSpec
from pepper_driver.keys import StopKey
from pepper_driver.robot import Pepper


def move(
    motion: Annotated[
        str, typer.Argument(metavar="NAME_OR_FILE", help="A shipped motion, or a file name.yaml.")
    ],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to move.")] = "mujoco",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check the motion and print its steps; move nothing.")
    ] = False,
    log: Annotated[Path | None, typer.Option(metavar="FILE", help="MCAP log to write.")] = None,
    real_time: RealTimeOption = False,
    json_file: JsonOption = None,
) -> int:
    """Play a motion and say what each step reached; code 1 if one that waits for its targets gave up.

    The space bar or q stops the robot at once.
    """
    console = make_console()
    robot = load_robot()
    chosen = load_motion(motion, robot)
    pepper = Pepper(
        backend, observer=None, log=None if dry_run else log, real_time=real_time, robot=robot
    )
    check_outputs(json_file)
    if dry_run:
        for line in plan(chosen, robot):
            console.print(line)
        save_json(json_file, {"motion": chosen.name, "longest": chosen.longest}, console)
        return 0
    with StopKey(pepper.emergency_stop) as key, pepper:
        if key.listening:
            console.print(key.HELP)
        report = pepper.play(chosen, on_step=lambda step: show_line(console, str(step)))
    if pepper.paced:
        show_timing(console, pepper.statistics)
    if log is not None:
        console.print(f"log: {log}")
    save_json(json_file, report.as_json(), console)
    return 0 if report.reached else 1


def plan(motion: Motion, robot: RobotConfig) -> Iterator[str]:
    """What a motion will do, one line a step."""
    times = "" if motion.repeat == 1 else f", {motion.repeat} times"
    count = len(motion.steps)
    steps = "1 step" if count == 1 else f"{count} steps"
    yield f"{motion.name}: {steps}{times}, {motion.longest:.1f} s at most"
    for number, step in enumerate(motion.steps):
        text = "; ".join([_times(step), *_parts(step, robot)])
        yield f"step {number}{'' if step.name is None else f' {step.name}'}: {text}"


def _times(step: MotionStep) -> str:
    parts = [] if step.duration is None else [f"{step.duration:.2f} s"]
    if step.until is not None:
        parts.append(f"until reached, {step.timeout:.2f} s at most")
    if step.hold:
        parts.append(f"hold {step.hold:.2f} s")
    return ", ".join(parts)


def _parts(step: MotionStep, robot: RobotConfig) -> Iterator[str]:
    if step.posture is not None:
        yield f"posture {step.posture}"
    for joint, angle in step.joints.items():
        yield f"{joint} to {angle:g}{'' if joint in robot.hands.joints else ' rad'}"
    yield from (f"{hand} to {aperture:g}" for hand, aperture in step.hands.items())
    if step.stiffness is not None:
        yield f"posture stiffness {step.stiffness:g} 1/s2"
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
        where = "" if task.seen_from is None else f" from {task.seen_from}"
        yield f"{task.label} to {goal}{where}{base}{kept}"
    if (twist := step.base_velocity) is not None:
        yield f"base at {twist.vx:g} {twist.vy:g} m/s, {twist.wz:g} rad/s"


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
