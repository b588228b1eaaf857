"""The command ``pepper``: its sub-commands, and how their errors are shown."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated

import typer

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
    """Run one command; returns its exit code. A wrong input is one line on stderr and code 2, never a traceback."""
    try:
        code = app(list(arguments), standalone_mode=False)
    except typer.TyperException as error:
        if message := error.format_message():  # none when the help was shown
            print(f"pepper: {message}", file=sys.stderr)
        return 2
    except PepperError as error:
        print(f"pepper: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    if code == 130:
        print("pepper: interrupted", file=sys.stderr)
    return code if isinstance(code, int) else 0
