"""``pepper plot``: a picture of a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pepper_driver.cli.console import finite, make_console
from pepper_driver.cli.log import LogArgument
from pepper_driver.log import read_log
from pepper_driver.log.plots import check_picture, plot_contacts


def plot(
    log: LogArgument,
    joints: Annotated[
        list[str] | None,
        typer.Option(
            "--joint",
            metavar="JOINT",
            help="Joint to show, may be given again; by default those with most contacts.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="PNG, SVG or PDF by its ending; by default LOG's name with .png."
        ),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(
            "--from",
            metavar="SECONDS",
            help="Begin, on the clock of the robot; by default the first tick.",
            callback=finite,
        ),
    ] = None,
    stop: Annotated[
        float | None,
        typer.Option(
            "--to",
            metavar="SECONDS",
            help="End, on the clock of the robot; by default the last tick.",
            callback=finite,
        ),
    ] = None,
) -> None:
    """Draw trajectories, tracking errors with their prediction, residuals with thresholds, contacts and reflexes."""
    out = out or log.with_suffix(".png")
    check_picture(out)
    plot_contacts(read_log(log), out, joints, start=start, stop=stop)
    make_console().print(f"figure: {out}")
