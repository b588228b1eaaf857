"""The command ``pepper``: its sub-commands, and how their errors are shown."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated

import typer
from typer.main import get_command

from pepper_driver.backends.signals import describe_interrupt, exit_code
from pepper_driver.cli.bench import bench
from pepper_driver.cli.calibrate import calibrate
from pepper_driver.cli.demo import demo
from pepper_driver.cli.doctor import doctor
from pepper_driver.cli.evaluate import evaluate_command
from pepper_driver.cli.identify import identify
from pepper_driver.cli.log import app as log_app
from pepper_driver.cli.move import move
from pepper_driver.cli.plot import plot
from pepper_driver.cli.record import record
from pepper_driver.cli.replay import replay_command
from pepper_driver.cli.run import run_command
from pepper_driver.cli.serve import serve
from pepper_driver.config import PepperError

app = typer.Typer(
    name="pepper",
    help="Lets a Pepper humanoid feel where, when and how hard it is touched.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(demo)
app.command()(doctor)
app.command()(move)
app.command("run")(run_command)
app.command()(identify)
app.command()(record)
app.command("replay")(replay_command)
app.command("evaluate")(evaluate_command)
app.command()(bench)
app.command()(calibrate)
app.command()(plot)
app.command()(serve)
app.add_typer(log_app, name="log")


@app.callback(invoke_without_command=True)
def _top(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)
    ] = False,
) -> None:
    if show_version:
        print(f"pepper-driver {version('pepper-driver')}")
        raise typer.Exit()


def run(arguments: Sequence[str]) -> int:
    """Run one command; returns its exit code. A wrong input is one line on stderr and code 2, never a traceback.

    So is what ends it: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP; the line has the path of the log, if any.
    """
    try:
        command = get_command(app)  # called by itself, it would make a bare 130 of every interrupt
        with command.make_context("pepper", list(arguments)) as context:
            code = command.invoke(context)
    except typer.Exit as error:  # help and version
        return error.exit_code
    except typer.TyperException as error:
        if message := error.format_message():  # none when the help was shown
            _say(message)
        return 2
    except PepperError as error:
        _say(str(error))
        return 2
    except (KeyboardInterrupt, OSError, SystemExit, typer.Abort) as error:
        interrupt = _interrupt(error)
        if interrupt is None and not isinstance(error, typer.Abort):  # a question without an answer
            raise
        return end_by(interrupt or KeyboardInterrupt())
    return code if isinstance(code, int) else 0


def end_by(interrupt: KeyboardInterrupt) -> int:
    """Say in one line what ended a command; returns its exit code."""
    _say(describe_interrupt(interrupt))
    return exit_code(interrupt)


def _interrupt(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt that ended a command, whatever failed on the way out: the terminal is gone, for example."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error


def _say(text: str) -> None:
    with suppress(OSError):  # nobody reads it
        print(f"pepper: {' '.join(text.split())}", file=sys.stderr, flush=True)
