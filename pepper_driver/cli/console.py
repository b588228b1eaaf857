"""What the sub-commands share: progress bars, the options ``--json`` and ``--real-time``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from pepper_driver.output import check_writable, write_json
from pepper_driver.realtime import Statistics

RealTimeOption = Annotated[
    bool, typer.Option("--real-time", help="Pace a simulation to the wall clock.")
]

JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Also write the printed figures to FILE."),
]


def make_console() -> Console:
    """The console commands print to: text as it is, square brackets too, and lines as long as they are."""
    return Console(highlight=False, markup=False, soft_wrap=True)


def make_progress(console: Console, *, count: bool = False) -> Progress:
    """A progress bar with the time that remains; ``count`` shows n/N in place of per cent."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn() if count else TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def show_line(console: Console, line: str) -> None:
    """Print from a callback's thread; a pipe or terminal that is closed ends the printing, not the run."""
    try:
        console.print(line)
    except KeyboardInterrupt:
        raise
    except (OSError, SystemExit):  # rich turns a broken pipe into an exit
        pass


def show_timing(console: Console, statistics: Statistics) -> None:
    """Say at the end of a run in real time whether ticks were missed; where some were, show what took how long."""
    console.print(str(statistics) if statistics.missed else statistics.summary)


def check_outputs(*paths: Path | None) -> None:
    """Refuse files that cannot be written, before the work is done rather than after."""
    for path in paths:
        if path is not None:
            check_writable(path)


def save_json(path: Path | None, content: Mapping[str, Any], console: Console) -> None:
    """Write the figures of a command, when asked to."""
    if path is not None:
        write_json(path, content)
        console.print(f"figures: {path}")
