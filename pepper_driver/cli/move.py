"""``pepper move``: plays a motion written in YAML."""

from __future__ import annotations

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
from pepper_driver.cli.steps import plan
from pepper_driver.config import load_motion, load_robot
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
