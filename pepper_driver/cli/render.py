"""``pepper render``: films and pictures of a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepper_driver.cli.console import finite, make_console, make_progress
from pepper_driver.cli.log import LogArgument, StartOption, StopOption
from pepper_driver.config.errors import ArgumentError
from pepper_driver.log import read_log
from pepper_driver.rendering import Format, View
from pepper_driver.rendering.film import (
    DEFAULT_SIZE,
    MAX_FPS,
    Film,
    check_numbers,
    check_output,
)


def as_size(text: str) -> tuple[int, int]:
    """Return width and height of ``WxH``."""
    width, height = text.lower().split("x")
    return int(width), int(height)


def is_size(text: str) -> str:
    """Refuse an option that is not ``WxH``."""
    try:
        as_size(text)
    except ValueError as error:
        raise typer.BadParameter(f"must be WxH, such as 1280x720, got '{text}'") from error
    return text


def render(
    log: LogArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="By default LOG with the format as its ending."),
    ] = None,
    form: Annotated[
        Format | None,
        typer.Option("--format", help="By default the ending of FILE, or mp4."),
    ] = None,
    start: StartOption = None,
    stop: StopOption = None,
    at: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Moment of a PNG; by default that of the strongest touch.",
            callback=finite,
        ),
    ] = None,
    fps: Annotated[
        int, typer.Option(metavar="N", min=1, max=round(MAX_FPS), help="Frames a second.")
    ] = 25,
    speed: Annotated[
        float, typer.Option(metavar="X", help="Times real time.", callback=finite)
    ] = 1.0,
    size: Annotated[
        str,
        typer.Option(
            metavar="WxH", help="Width and height in pixels, even numbers.", callback=is_size
        ),
    ] = f"{DEFAULT_SIZE[0]}x{DEFAULT_SIZE[1]}",
    view: Annotated[View, typer.Option(help="Side from which the robot is seen.")] = "front",
    joints: Annotated[
        list[str] | None,
        typer.Option(
            "--joint",
            metavar="JOINT",
            help="Joint whose residual is shown, may be given up to three times; by default those with contacts.",
        ),
    ] = None,
) -> None:
    """Make a film or a picture of a log: the robot, and next to it the contacts of its joints."""
    console = make_console()
    pixels = as_size(size)
    if out is None:
        out = log.with_suffix(f".{form or 'mp4'}")
    elif form is not None and out.suffix.lower() != f".{form}":
        raise ArgumentError(f"{out}: does not end in .{form}, as --format says")
    kind = check_output(out)
    check_numbers(fps, speed, pixels)
    if at is not None and kind != "png":
        raise ArgumentError(f"--at is for a PNG, and {out.name} is a film: use --from and --to")
    film = Film(
        read_log(log),
        start=start,
        stop=stop,
        fps=fps,
        speed=speed,
        size=pixels,
        view=view,
        joints=joints or (),
    )
    if kind == "png":
        film.save_picture(out, at)
        console.print(f"picture: {out}")
        return
    with make_progress(console) as progress:
        task = progress.add_task("frames", total=len(film.times))
        film.write(out, lambda: progress.advance(task))
    console.print(f"film: {out}, {len(film.times)} frames, {len(film.times) / fps:.1f} s")
