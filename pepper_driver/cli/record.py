"""``pepper record``: a log of a run in which someone says when the robot is touched."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepper_driver.cli.console import check_outputs, make_console, show_line
from pepper_driver.config import load_motion, load_robot, load_scenario
from pepper_driver.log import Label
from pepper_driver.record import record_labelled

DEFAULT_SECONDS = 60.0
"""[s] for which a robot without a motion holds its posture."""


def record(
    out: Annotated[Path, typer.Option(metavar="LOG", help="MCAP log to write.")],
    label: Annotated[
        str,
        typer.Option(
            help="What tells that the robot is touched: key (the space bar), head, hand-left, hand-right or bumper."
        ),
    ],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to record.")] = "mujoco",
    seconds: Annotated[
        float | None,
        typer.Option(
            help=f"How long the posture is held ({DEFAULT_SECONDS:g} by default), or the motion is repeated."
        ),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(metavar="NAME_OR_FILE", help="Motion to play; else the posture is held."),
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(metavar="NAME_OR_FILE", help="Scenario to perform, in its place.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the scenario; else its own.", min=0)] = None,
    link: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="What is touched; else the link of the sensor."),
    ] = None,
    joint: Annotated[
        str | None,
        typer.Option(
            metavar="JOINT",
            help="The joint that should feel it; else the one that carries the link.",
        ),
    ] = None,
) -> None:
    """Record a run with labels of touches: on a real robot too. Ctrl-C ends it; what was recorded stays."""
    console = make_console()
    check_outputs(out)
    robot = load_robot()
    chosen_motion = None if motion is None else load_motion(motion, robot)
    chosen_scenario = None if scenario is None else load_scenario(scenario, robot)
    if chosen_motion is None and chosen_scenario is None and seconds is None:
        seconds = DEFAULT_SECONDS

    def start() -> None:
        how = (
            "press the space bar before a touch, and again after it"
            if label == "key"
            else f"touch the robot; '{label}' tells when"
        )
        console.print(f"recording: {how}; Ctrl-C ends it")

    def tell(told: Label) -> None:
        show_line(console, f"{told.time:8.2f} s  {told.phase}")

    done = record_labelled(
        backend,
        out,
        label,
        motion=chosen_motion,
        scenario=chosen_scenario,
        seconds=seconds,
        seed=seed,
        link=link,
        joint=joint,
        on_label=tell,
        on_start=lambda _: start(),
    )
    touches = "1 touch" if done.touches == 1 else f"{done.touches} touches"
    console.print(f"{done.seconds:.1f} s, {touches}")
    if not done.released:
        console.print("the last touch was not released: it counts until the end of the log")
    if done.missing:
        console.print(f"{done.missing} ticks are missing: the disk was too slow")
    console.print(f"log: {out}")
    if done.interrupt is not None:
        raise done.interrupt
