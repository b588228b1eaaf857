"""Common parts of the sub-commands: progress bars, the options ``--json``, ``--models`` and ``--real-time``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from pepper_driver.config import ConfigError
from pepper_driver.config.files import check_writable, write_json
from pepper_driver.realtime import Statistics

if TYPE_CHECKING:
    from pepper_driver.config.workers import Workers
    from pepper_driver.robot import Pepper

LINE_INTERVAL = 2.0
"""[s] between two lines of a progress."""

RealTimeOption = Annotated[
    bool, typer.Option("--real-time", help="Pace a simulation to the wall clock.")
]

ViewOption = Annotated[
    bool,
    typer.Option("--view", help="Show the robot in the browser, a simulated one in real time."),
]

ModelsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Model file of the observer; by default the one shipped for this robot.",
    ),
]

AttentiveOption = Annotated[
    bool,
    typer.Option(
        "--attentive",
        help="Let arms and head oscillate a little, to detect lighter touches.",
    ),
]

WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        min=1,
        max=1000,
        help="Processes that work at the same time; by default one per core.",
        show_default=False,
    ),
]

ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work, such as tcp://10.0.0.1:8786; by default processes here do.",
        show_default=False,
    ),
]

JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Also write the printed results to FILE."),
]


def finite(value: float | None) -> float | None:
    """Refuse an option that is NaN or infinite."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"must be a finite number, got {value}")
    return value


def make_console() -> Console:
    """Make the console that commands print to: plain text with square brackets, and lines that are not folded."""
    return Console(highlight=False, markup=False, soft_wrap=True)


class LineProgress(Progress):
    """A progress bar; where there is no terminal for it, a line for each part or tenth, with the time that remains.

    A task that continues earlier work has what was done before as its field ``before``, which does not count for the
    speed.
    """

    def __init__(self, console: Console, *, count: bool = False, lines: bool = True) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn() if count else TaskProgressColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
            speed_estimate_period=3600.0,  # [s] parts may take minutes
        )
        self._count, self._lines = count, lines
        self._shown: dict[TaskID, tuple[str, int]] = {}
        self._stopped = Event()

    def start(self) -> None:
        """Show what is done from now on."""
        super().start()
        if self.disable and self._lines:
            self._stopped = Event()
            # A thread of its own: a pipe without a reader must not block a tick.
            Thread(target=self._run, args=(self._stopped,), name="progress", daemon=True).start()

    def stop(self) -> None:
        """Show nothing more."""
        self._stopped.set()
        super().stop()

    def lines(self) -> Iterator[str]:
        """Yield a line for each task that has come further by a part or a tenth since the last call."""
        for task in self.tasks:
            total = task.total or 1.0
            fraction = task.completed / total
            step = (task.description, int(task.completed if self._count else 10.0 * fraction))
            if self._shown.get(task.id) != step:
                self._shown[task.id] = step
                shown = f"{task.completed:.0f} of {total:.0f}" if self._count else f"{fraction:.0%}"
                done = task.completed - task.fields.get("before", 0.0)
                remaining = (
                    (task.elapsed or 0.0) * (total - task.completed) / done if done else None
                )
                estimate = "" if remaining is None else f", about {duration_text(remaining)} left"
                yield f"{task.description}: {shown}{estimate}"

    def _run(self, stopped: Event) -> None:
        while not stopped.wait(LINE_INTERVAL):
            for line in self.lines():
                show_line(self.console, line)


def make_progress(console: Console, *, count: bool = False, lines: bool = True) -> LineProgress:
    """Return a progress with the time that remains.

    Args:
        console: Where to show it.
        count: Show n/N in place of per cent.
        lines: False for a command that prints enough by itself where there is no terminal.
    """
    return LineProgress(console, count=count, lines=lines)


def duration_text(seconds: float) -> str:
    """Return a human-readable duration: ``40 s``, ``12 min``, ``2 h 05 min``."""
    if round(seconds) < 100:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


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


@contextmanager
def shown_in_browser(console: Console, pepper: Pepper) -> Iterator[None]:
    """Show a robot in the browser as long as the block is open; print the address.

    Raises:
        PepperError: The page cannot be served.
    """
    from pepper_driver.viewer.view import View  # brings more than most commands need

    with View() as view:
        view.show(pepper)
        show_line(console, f"view: {view.address}")
        view.open()
        yield


@contextmanager
def chosen_workers(workers: int | None, cluster: str | None, console: Console) -> Iterator[Workers]:
    """Yield who works: processes of this machine, or the workers of a cluster, which are looked at first.

    Raises:
        ConfigError: Both are given.
        PepperError: The cluster cannot be used.
    """
    if cluster is None:
        yield workers or -1
        return
    if workers is not None:
        raise ConfigError(
            "option '--workers': with '--cluster' all workers of the cluster work; leave it out"
        )
    from pepper_driver.config.cluster import connected  # slow to import, for commands without it

    with connected(cluster, waiting=console.print) as found:
        console.print(str(found))
        yield found


def check_outputs(*paths: Path | None) -> None:
    """Refuse files that cannot be written, before the work is done rather than after."""
    for path in paths:
        if path is not None:
            check_writable(path)


def save_json(path: Path | None, content: Mapping[str, Any], console: Console) -> None:
    """Write the results of a command, when asked to."""
    if path is not None:
        write_json(path, content)
        console.print(f"results: {path}")
