"""``pepper replay``: contacts of a recording, detected again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.cli.console import JsonOption, check_outputs, make_console, save_json
from pepper_driver.cli.log import LogArgument
from pepper_driver.cli.view import show_log
from pepper_driver.log import LogEvent
from pepper_driver.observer import Contact
from pepper_driver.reflexes import Reflex
from pepper_driver.reflexes.declared import load_reflexes
from pepper_driver.replay import Comparison, LoggedRun, Replayed, compare, load_run, replay
from pepper_driver.replay.comparison import MatchedPair

NONE = "none"


def replay_command(
    log: LogArgument,
    observer: Annotated[
        str | None, typer.Option(metavar="NAME", help="Observer; by default that of the run.")
    ] = None,
    models: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Model file; by default the one shipped.")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--observer-settings",
            metavar="FILE",
            help="Settings such as observer.yaml; by default those of the run.",
        ),
    ] = None,
    reflexes: Annotated[
        str | None,
        typer.Option(metavar="FILE", help=f"Reflexes, or '{NONE}'; by default those of the run."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="MCAP log of the replay to write.")
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", help="Then show both in the browser, over a time line."),
    ] = False,
    json_file: JsonOption = None,
) -> int:
    """Run observer and reflexes on a recording; code 1 if they do not decide the same, bit for bit."""
    console = make_console()
    run = load_run(log)
    observing = run.observer(observer, models, settings)
    acting = _reflexes(run, reflexes)
    check_outputs(json_file)
    found = replay(run, observing, acting, out=out)
    result = compare(run, found)
    _print(console, run, found, result)
    if out is not None:
        console.print(f"log: {out}")
    save_json(json_file, result.as_json(), console)
    if view:
        show_log(console, log, pairs=result.contacts)
    return 0 if result.identical else 1


def _reflexes(run: LoggedRun, asked: str | None) -> Sequence[Reflex]:
    if asked is None:
        return run.reflexes()
    return () if asked == NONE else load_reflexes(Path(asked), run.robot)


def _print(console: Console, run: LoggedRun, found: Replayed, result: Comparison) -> None:
    console.print(f"{run.path}: {run.log.metadata.get('backend')}, {result.ticks} ticks")
    then, now = run.log.metadata.get("observer", NONE), found.observer or NONE
    console.print(f"observer: {now}" + ("" if then == now else f"\n    then: {then}"))
    console.print(f"reflexes: {', '.join(found.reflexes) or NONE}")
    if result.contacts:
        console.print(_contacts(result.contacts))
    if result.reflexes:
        console.print(_events(result.reflexes))
    commands = result.commands
    console.print(f"commands: {commands.compared} compared, {commands.differing} differ")
    for note in result.notes:
        console.print(note)
    if result.identical:
        console.print("identical bit for bit")
    for number, difference in enumerate(result.differences):
        start = "first difference" if number == 0 else "then"
        console.print(f"{start}, at {difference.time:.3f} s: {difference.text}")


def _contacts(pairs: Sequence[MatchedPair[Contact]]) -> Table:
    table = _table("contacts", ("joint", "kind"), ("then s", "now s", "later ms", "deg", "now deg"))
    for pair in pairs:
        then, now = pair.recorded, pair.found
        table.add_row(
            _change(*(None if c is None else c.joint or c.link for c in (then, now))),
            _change(*(None if c is None else c.kind for c in (then, now))),
            *("-" if c is None else f"{c.detection_time:.3f}" for c in (then, now)),
            _later(pair),
            *(f"{c.intensity_deg:.2f}" if c and c.intensity_deg else "-" for c in (then, now)),
        )
    return table


def _events(pairs: Sequence[MatchedPair[LogEvent]]) -> Table:
    table = _table("reflexes", ("reflex", "phase"), ("then s", "now s", "later ms"))
    for pair in pairs:
        then, now = pair.recorded, pair.found
        table.add_row(
            _change(*(None if e is None else e.name for e in (then, now))),
            _change(*(None if e is None else e.phase for e in (then, now))),
            *("-" if e is None else f"{e.time:.3f}" for e in (then, now)),
            _later(pair),
        )
    return table


def _table(title: str, names: Sequence[str], figures: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left")
    for name in names:
        table.add_column(name, no_wrap=True)
    for name in figures:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _change(then: str | None, now: str | None) -> str:
    """One text where both are the same, or there is only one; what is new where they are not."""
    different = None not in (then, now) and then != now
    return f"now {now}" if different else then or now or "-"


def _later(pair: MatchedPair[Contact] | MatchedPair[LogEvent]) -> str:
    return "-" if pair.later is None else f"{1e3 * pair.later:.0f}"
