"""``pepper log`` and ``pepper plot``: what a log holds, in figures, tables and pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.cli.app import CommandGroup
from pepper_driver.cli.console import JsonOption, check_outputs, finite, make_console, save_json
from pepper_driver.figure_style import check_picture
from pepper_driver.log import read_log
from pepper_driver.log.export import Format, export_log
from pepper_driver.log.plots import plot_contacts
from pepper_driver.log.repair import repair_log
from pepper_driver.log.summary import LogSummary, summarise

StartOption = Annotated[
    float | None,
    typer.Option(
        "--from",
        metavar="SECONDS",
        help="Begin, on the clock of the robot; by default the first tick.",
        callback=finite,
    ),
]
StopOption = Annotated[
    float | None,
    typer.Option(
        "--to",
        metavar="SECONDS",
        help="End, on the clock of the robot; by default the last tick.",
        callback=finite,
    ),
]


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
    start: StartOption = None,
    stop: StopOption = None,
) -> None:
    """Draw trajectories, tracking errors with their prediction, residuals with thresholds, contacts and reflexes."""
    out = out or log.with_suffix(".png")
    check_picture(out)
    plot_contacts(read_log(log), out, joints, start=start, stop=stop)
    make_console().print(f"figure: {out}")


LogArgument = Annotated[Path, typer.Argument(metavar="LOG", help="MCAP log of a run.")]

app = typer.Typer(
    cls=CommandGroup,
    help="Say what a log holds, export it, or repair it.",
    add_completion=False,
    no_args_is_help=True,
)

SHOWN = (
    "start",
    "experiment",
    "backend",
    "seed",
    "identity",
    "observer",
    "pepper_driver",
    "machine",
)
"""Of the metadata; ``--json`` has all of it."""


@app.command(epilog="Example: pepper log info run.mcap --json figures.json\n\nMore: docs/log.md")
def info(log: LogArgument, json_file: JsonOption = None) -> None:
    """Say what a log holds: length, timing, contacts, reflexes, faults, and the run it is of."""
    console = make_console()
    check_outputs(json_file)
    summary = summarise(read_log(log))
    _print_run(console, log, summary)
    _print_timing(console, summary)
    _print_events(console, summary)
    save_json(json_file, summary.as_json(), console)


@app.command(epilog="Example: pepper log export run.mcap --format csv\n\nMore: docs/log.md")
def export(
    log: LogArgument,
    to: Annotated[
        Format, typer.Option("--format", help="Format; Parquet needs the extra 'export'.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File for the ticks; by default next to the log."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there.")] = False,
) -> None:
    """Write a log in a format for other tools; contacts and events go to files of their own next to it."""
    console = make_console()
    for file in export_log(read_log(log), out or log.with_suffix(f".{to}"), to, force=force):
        console.print(str(file))


@app.command()
def repair(
    log: LogArgument,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New log to write.")],
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Write the intact chunks of a damaged log as a new log that every program reads."""
    file = repair_log(log, out, force=force)
    make_console().print(f"{out}: {file.missing or f'{log} is whole; this is a copy'}")


def _print_run(console: Console, path: Path, summary: LogSummary) -> None:
    cut = ("" if summary.complete else ", cut short") + (", with gaps" if summary.gaps else "")
    ticks = "1 tick" if summary.ticks == 1 else f"{summary.ticks} ticks"
    console.print(f"{path}: {summary.robot}, {summary.duration:.1f} s, {ticks}{cut}")
    for name in SHOWN:
        if name in summary.metadata:
            console.print(f"  {name:14s} {summary.metadata[name]}")


def _print_timing(console: Console, summary: LogSummary) -> None:
    console.print(
        f"missed: {summary.missed} ticks; not in the log: {summary.dropped}; "
        f"dropped commands: {summary.dropped_commands}"
    )
    table = Table(title="milliseconds", title_justify="left")
    for name in ("time", "median", "p99", "max"):
        table.add_column(name, justify="left" if name == "time" else "right")
    for name, spread in (("tick end", summary.tick_end), ("sample age", summary.sample_age)):
        if spread is not None:
            table.add_row(name, f"{spread.median:.2f}", f"{spread.p99:.2f}", f"{spread.max:.2f}")
    if table.row_count:
        console.print(table)
    if summary.ticks and summary.tick_end is None:
        console.print("tick end: not known, ticks were not paced")


def _print_events(console: Console, summary: LogSummary) -> None:
    for name, counts in (
        ("contacts", summary.contacts),
        ("joints of contacts", summary.joints),
        ("reflexes", summary.reflexes),
    ):
        listed = ", ".join(f"{count} {of}" for of, count in counts.items())
        if listed or name == "contacts":
            console.print(f"{name}: {listed or 'none'}")
    if summary.touches:
        console.print(f"labelled touches: {summary.touches}")
    for time, reason in summary.faults:
        console.print(f"stopped at {time:.2f} s: {reason}")
