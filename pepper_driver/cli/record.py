"""``pepper record``: a log of a run in which someone says when the robot is touched."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepper_driver.cli.console import check_outputs, duration_text, make_console, show_line
from pepper_driver.config import load_experiment, load_robot
from pepper_driver.config.file_lock import lock_file
from pepper_driver.config.touch_prompts import load_touch_prompts
from pepper_driver.recording.labels import LabelSource
from pepper_driver.recording.record import label_text, prompt_text, record_labelled
from pepper_driver.recording.terminal_keys import SpaceBar

DEFAULT_SECONDS = 60.0
"""[s] for which a robot that plays nothing holds its posture."""


def record(
    out: Annotated[Path, typer.Option(metavar="LOG", help="MCAP log to write.")],
    label: Annotated[
        LabelSource,
        typer.Option(help="Source of the labels; key is the space bar, and q stops the robot."),
    ],
    backend: Annotated[str, typer.Option(metavar="URI", help="Robot to record.")] = "mujoco",
    seconds: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help=f"How long the posture is held, {DEFAULT_SECONDS:g} by default, or what is played is repeated.",
        ),
    ] = None,
    play: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE",
            help="Motion or experiment to play, without its reactions; by default the posture is held.",
        ),
    ] = None,
    prompts: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE",
            help="Touches that the robot asks for, one after the other: standard or scale for thirty shipped ones, by "
            "hand alone or also with a spring scale.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Seed of random goals; by default that of the experiment.", min=0
        ),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="What is touched; by default the link of the sensor."),
    ] = None,
    joint: Annotated[
        str | None,
        typer.Option(
            metavar="JOINT",
            help="The joint that should detect it; by default the one that carries the link.",
        ),
    ] = None,
) -> None:
    """Record a run with labels of touches: on a real robot too. Ctrl-C ends it; what was recorded stays.

    The space bar or q stops the robot at once. With --label key the space bar labels touches, and q alone stops it.
    """
    console = make_console()
    check_outputs(out)
    lock_file(out).release()  # what the log would refuse, before the robot moves
    robot = load_robot()
    experiment = None if play is None else load_experiment(play, robot)
    asked = None
    if prompts is not None:
        asked = load_touch_prompts(robot, prompts)
    elif experiment is None and seconds is None:
        seconds = DEFAULT_SECONDS

    def start() -> None:
        how = (
            f"press the space bar before a touch, and again after it; {SpaceBar.HELP}"
            if label == "key"
            else f"touch the robot; '{label}' labels it"
        )
        console.print(f"recording: {how}; Ctrl-C ends it")
        if asked is not None:
            touches = "1 touch" if len(asked.touches) == 1 else f"{len(asked.touches)} touches"
            console.print(f"{touches} in {duration_text(asked.seconds)}; each is asked for")

    done = record_labelled(
        backend,
        out,
        label,
        experiment=experiment,
        prompts=asked,
        seconds=seconds,
        seed=seed,
        link=link,
        joint=joint,
        on_prompt=lambda number, prompt: show_line(console, prompt_text(number, prompt)),
        on_label=lambda made: show_line(console, label_text(made)),
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
