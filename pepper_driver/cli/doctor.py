"""``pepper doctor``: whether a robot is fit to move, and what to do where it is not."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.backends.readiness import unknown
from pepper_driver.backends.selection import make_backend
from pepper_driver.cli.console import (
    JsonOption,
    check_outputs,
    make_console,
    make_progress,
    save_json,
)
from pepper_driver.config import ConfigError, load_doctor_settings, load_robot
from pepper_driver.config.passwords import without_secrets
from pepper_driver.doctor import (
    CheckResult,
    CheckStatus,
    Examination,
    JointFit,
    MotionTest,
    Verdict,
    examine,
    try_motion,
)
from pepper_driver.doctor.bundle import write_bundle
from pepper_driver.doctor.motion_test import RESPONSE_TIME, make_pepper
from pepper_driver.observer import ModelSet
from pepper_driver.recording.terminal_keys import StopKey


def doctor(
    uri: Annotated[str, typer.Argument(metavar="URI", help="Robot to examine.")] = "mujoco",
    models: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Model file; by default the one shipped for this robot."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask before the robot moves.")] = False,
    no_motion: Annotated[
        bool, typer.Option("--no-motion", help="Only inspect: the robot does not move.")
    ] = False,
    json_file: JsonOption = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also write all that was seen into an archive, NAME.zip, that can be sent: no names, no addresses.",
        ),
    ] = None,
) -> int:
    """Check a robot before it moves, then with a small motion whether its models fit; code 1 if a check failed."""
    console = make_console()
    if report is not None and report.suffix != ".zip":
        raise ConfigError(f"{report}: a report is an archive and ends in .zip")
    check_outputs(json_file, report)
    make_backend(uri)  # a wrong one is refused before a person is asked
    asks = not (yes or no_motion)
    if asks and not sys.stdin.isatty():
        raise ConfigError(
            "there is no terminal to ask on before the robot moves: give --yes, or --no-motion"
        )
    with make_progress(console) as progress:
        bar = progress.add_task("looking", total=1.0)
        examination = examine(
            uri,
            models=models,
            on_progress=lambda fraction: progress.update(bar, completed=fraction),
        )
    print_checks(console, examination.results)
    left_out = ""
    if no_motion:
        left_out = "left out by --no-motion"
    elif not examination.passed:
        left_out = "not moved: a check failed"
    elif asks and not _confirmed():
        left_out = "not moved: the question was answered with no"
    if left_out or examination.models is None:
        motion_test = MotionTest(results=(unknown("motion", left_out),), fits=())
    else:
        motion_test = _try(console, uri, examination.models)
    print_checks(console, motion_test.results)
    _print_fits(console, motion_test.fits)
    passed = examination.passed and motion_test.passed
    save_json(json_file, _as_json(uri, examination, motion_test), console)
    if report is not None:
        write_bundle(report, uri, examination, motion_test)
        console.print(f"report: {report}; look through its report.json before you send it")
    return 0 if passed else 1


def _confirmed() -> bool:
    seconds = load_doctor_settings().motion + RESPONSE_TIME
    return typer.confirm(
        f"Next, for {seconds:.0f} s: arms go a little aside where they are near the body, then arms and head move by a "
        "few degrees. Is the robot on level floor, with clear space around it, its hands empty, no person touching it, "
        "and a hand at the emergency stop?"
    )


def _try(console: Console, uri: str, models: ModelSet) -> MotionTest:
    pepper = make_pepper(uri, models, load_robot())
    with StopKey(pepper.emergency_stop) as key:
        if key.listening:
            console.print(key.HELP)
        with make_progress(console) as progress:
            bar = progress.add_task("moving arms and head by a few degrees", total=1.0)
            return try_motion(
                pepper,
                models,
                on_progress=lambda fraction: progress.update(bar, completed=fraction),
            )


_STYLE = {
    CheckStatus.OK: "green",
    CheckStatus.WARNING: "yellow",
    CheckStatus.FAILED: "bold red",
    CheckStatus.UNKNOWN: "dim",
}


def print_checks(console: Console, results: Sequence[CheckResult]) -> None:
    """One line a check, and below those that are not well what to do."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for width in (14, 15, None):
        table.add_column(min_width=width, overflow="fold")
    for result in results:
        table.add_row(result.status.value, result.name, result.found, style=_STYLE[result.status])
        if result.remedy:
            table.add_row("", "", f"-> {result.remedy}")
    console.print(table, soft_wrap=False)


def _print_fits(console: Console, fits: Sequence[JointFit]) -> None:
    """Print the fits of the joints, if one is not as it should be."""
    if all(fit.verdict is Verdict.FITS for fit in fits):
        return
    table = Table(title="residual of each joint, over its threshold", title_justify="left")
    for name in ("joint", "verdict", "follows", "error rms", "rms", "peak", "peak, adapted"):
        table.add_column(name, justify="left" if name in ("joint", "verdict") else "right")
    for fit in fits:
        figures = (f"{v:.2f}" for v in (fit.rms, fit.peak, fit.today))
        table.add_row(
            fit.joint,
            fit.verdict.value,
            f"{fit.follows:.0%}",
            f"{math.degrees(fit.error):.2f} deg",
            *figures,
        )
    console.print(table)


def _as_json(uri: str, examination: Examination, motion_test: MotionTest) -> dict[str, Any]:
    return {
        "backend": without_secrets(uri),
        "identity": examination.info.identity,
        "passed": examination.passed and motion_test.passed,
        "results": [result.as_json() for result in (*examination.results, *motion_test.results)],
        "joints": [fit.as_json() for fit in motion_test.fits],
    }
