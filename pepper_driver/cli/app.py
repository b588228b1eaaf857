"""The command ``pepper``: its sub-commands, and how their errors are shown."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.metadata import version
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

HELP_OPTIONS: dict[str, Any] = {"help_option_names": ["-h", "--help"]}


@dataclass(frozen=True, kw_only=True)
class CommandEntry:
    """Description of a command before it is imported.

    Attributes:
        place: Module of this package, and the function or group in it.
        summary: The first line of its help.
        example: A call of it.
        docs: The page about it, in ``docs``.
    """

    place: str
    summary: str
    example: str
    docs: str

    @property
    def epilog(self) -> str:
        """The end of its help."""
        return f"Example: {self.example}\n\nMore: docs/{self.docs}"


COMMANDS = {
    "demo": CommandEntry(
        place="demo:demo",
        summary="Move a simulated Pepper's arms, push them, and print each contact as it is detected.",
        example="pepper demo --seed 3 --out runs/third",
        docs="demo.md",
    ),
    "view": CommandEntry(
        place="view:view",
        summary="Show a robot or a log in the browser; pull and tap a simulated one with the mouse.",
        example="pepper view",
        docs="view.md",
    ),
    "doctor": CommandEntry(
        place="doctor:doctor",
        summary="Check a robot before it moves, then with a small motion whether its models fit.",
        example="pepper doctor naoqi://pepper.local --no-motion",
        docs="doctor.md",
    ),
    "run": CommandEntry(
        place="run:run_command",
        summary="Play an experiment or a motion, by name or written in YAML.",
        example="pepper run examples/experiments/retract.yaml --log run.mcap",
        docs="experiments.md",
    ),
    "move": CommandEntry(
        place="run:run_command",
        summary="The same as run.",
        example="pepper move wave --dry-run",
        docs="experiments.md",
    ),
    "identify": CommandEntry(
        place="identify:identify",
        summary="Drive joints in free motion, fit an expected-error model to each, write the model file.",
        example="pepper identify --out mine.json --backend 'mujoco://?plant=mine.yaml'",
        docs="observer.md",
    ),
    "first-hour": CommandEntry(
        place="first_hour:first_hour",
        summary="Check, measure, identify and touch a new robot, and pack what can be sent; resumable.",
        example="pepper first-hour --backend naoqi://pepper.local --out my_pepper --weight 0.5",
        docs="first_robot.md",
    ),
    "record": CommandEntry(
        place="record:record",
        summary="Record a run with labels of touches: on a real robot too.",
        example="pepper record --out touches.mcap --label head --seconds 30",
        docs="recording.md",
    ),
    "list": CommandEntry(
        place="list:list_command",
        summary="List motions, experiments, plants, suites, reflexes, limbs and the like that can be named.",
        example="pepper list plants",
        docs="experiments.md",
    ),
    "examples": CommandEntry(
        place="examples:examples_command",
        summary="List the example programs, experiments and plug-ins, or copy them into a folder.",
        example="pepper examples my_examples",
        docs="plugins.md",
    ),
    "replay": CommandEntry(
        place="replay:replay_command",
        summary="Run observer and reflexes on a recording, and compare with what was decided then.",
        example="pepper replay run.mcap --observer momentum",
        docs="replay.md",
    ),
    "evaluate": CommandEntry(
        place="evaluate:evaluate_command",
        summary="Score the contacts of observers, on seeded simulated runs or labelled recordings.",
        example="pepper evaluate --suite paper --quick",
        docs="judge.md",
    ),
    "bench": CommandEntry(
        place="bench:bench",
        summary="Time ticks, the simulation compared with bare physics, start-up and throughput.",
        example="pepper bench --tick --seconds 10",
        docs="bench.md",
    ),
    "calibrate": CommandEntry(
        place="calibrate:calibrate",
        summary="Fit the simulated robot to recordings of real ones, or check how near it comes.",
        example="pepper calibrate --check --plant integral",
        docs="plant.md",
    ),
    "plot": CommandEntry(
        place="log:plot",
        summary="Draw a log: trajectories, tracking errors, residuals, contacts and reflexes.",
        example="pepper plot run.mcap --joint LShoulderRoll --from 4 --to 6",
        docs="log.md",
    ),
    "render": CommandEntry(
        place="render:render",
        summary="Make a film or a picture of a log: the robot, and next to it the contacts of its joints.",
        example="pepper render run.mcap --out run.mp4 --from 4 --to 10 --view left",
        docs="render.md",
    ),
    "serve": CommandEntry(
        place="serve:serve",
        summary="Offer a simulated Pepper over NAOqi's protocol, in real time, until Ctrl-C.",
        example="pepper serve --plant integral --port 9559",
        docs="stand_in.md",
    ),
    "log": CommandEntry(
        place="log:app",
        summary="Say what a log holds, export it, or repair it.",
        example="pepper log info run.mcap",
        docs="log.md",
    ),
}
"""In the order of the help. Each is imported when it is called: all of them take a second."""


class CommandGroup(TyperGroup):
    """Commands; a wrong name is refused as that of an option is."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 typer's own click
        """Return name, command and its arguments."""
        if args[0] not in self.commands:
            raise typer.TyperException(_unknown("command", args[0], self.commands))
        return super().resolve_command(ctx, args)


class _Commands(CommandGroup):
    """Commands that are imported once they are called; help and errors know them before."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 typer's own click
        name, _, rest = super().resolve_command(ctx, args)
        return name, load_command(name or ""), rest


app = typer.Typer(
    name="pepper",
    cls=_Commands,
    help="Touch detection for the Pepper humanoid: where, when and how hard it is touched.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=HELP_OPTIONS,
)
for _name, _entry in COMMANDS.items():
    app.command(_name, help=_entry.summary)(lambda: None)


@app.callback(invoke_without_command=True)
def _top(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)
    ] = False,
) -> None:
    if show_version:
        print(f"pepper-driver {version('pepper-driver')}")
        raise typer.Exit()


@cache
def load_command(name: str) -> Any:  # noqa: ANN401 typer's own click
    """Import a command, and return it as typer runs it."""
    entry = COMMANDS[name]
    module, _, attribute = entry.place.partition(":")
    part = getattr(import_module(f"pepper_driver.cli.{module}"), attribute)
    if not isinstance(part, typer.Typer):
        alone = typer.Typer(add_completion=False)
        alone.command(name, epilog=entry.epilog, context_settings=HELP_OPTIONS)(part)
        part = alone
    return _without_types(get_command(part))


def _without_types(command: Any) -> Any:  # noqa: ANN401 typer's own click
    """Have the help show no type behind flags and arguments, where typer shows ``<bool>`` and ``<list[Path]>``."""
    for part in (command, *getattr(command, "commands", {}).values()):
        for parameter in part.get_params(typer.Context(part, **HELP_OPTIONS)):
            if getattr(parameter, "is_bool_flag", False):
                parameter.metavar = ""
            elif parameter.param_type_name == "argument":
                parameter.display_type_rich = lambda ctx: ""
    return command


def load_called(arguments: Sequence[str]) -> bool:
    """Import the command that is called; return False where none is: for help, version, and a wrong name."""
    name = next((argument for argument in arguments if not argument.startswith("-")), "")
    if name not in COMMANDS:
        return False
    load_command(name)
    return True


def run(arguments: Sequence[str]) -> int:
    """Run one command; returns its exit code, and says in one line on stderr what went wrong, never by a traceback.

    - 0: well.
    - 1: it began and failed: a check, a wait, a replay that differs, an error while the robot was active.
    - 2: it did not begin: a wrong input, or a robot that cannot be reached or is not ready.
    - 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP; the line has the path of the log, if any.
    """
    try:
        _refuse_empty(arguments)
        command = _without_types(get_command(app))
        # Called by itself, it would make a bare 130 of every interrupt.
        with command.make_context("pepper", list(arguments)) as context:
            code = command.invoke(context)
    except typer.Exit as error:  # help and version
        return error.exit_code
    except typer.TyperException as error:
        if message := _describe(error):  # none when the help was shown
            _say(message)
        return 2
    except _pepper_error() as error:
        _say(str(error))
        return 1 if error.while_active else 2
    except (KeyboardInterrupt, OSError, SystemExit, typer.Abort) as error:
        interrupt = _interrupt(error)
        if interrupt is None and not isinstance(error, typer.Abort):  # a question without an answer
            raise
        return end_by(interrupt or KeyboardInterrupt())
    return code if isinstance(code, int) else 0


def end_by(interrupt: KeyboardInterrupt) -> int:
    """Say in one line what ended a command; returns its exit code."""
    from pepper_driver.config.signals import describe_interrupt, exit_code

    _say(describe_interrupt(interrupt))
    return exit_code(interrupt)


def _pepper_error() -> type[Any]:
    """Return the root of the project's errors, imported only where there is an error to compare with."""
    from pepper_driver.config import PepperError

    return PepperError


def _refuse_empty(arguments: Sequence[str]) -> None:
    """Refuse ``--out ""``: an empty path means the current folder, which no user intends."""
    for before, argument in pairwise(["", *arguments]):
        option = f"option '{before}'" if before.startswith("--") else "an argument"
        if argument.startswith("--") and argument.endswith("="):
            option, argument = f"option '{argument[:-1]}'", ""
        if not argument.strip():
            raise typer.BadParameter("must not be empty", param_hint=option)


def _describe(error: typer.TyperException) -> str:
    """Return a wrong option in one line: which, what it must be, what it was."""
    if hasattr(error, "possibilities"):  # typer does not export its error of an unknown option
        unknown: Any = error
        return _unknown("option", unknown.option_name, _options_of(unknown.ctx))
    if not isinstance(error, typer.BadParameter) or not error.message:
        return error.format_message()
    parameter = error.param
    if parameter is None:
        return f"{error.param_hint}: {error.message}"
    from pydantic import ValidationError

    hint = f"{parameter.param_type_name} {parameter.get_error_hint()}"
    if not isinstance(error.__cause__, ValidationError):
        return f"{hint}: {error.message}"
    problem = error.__cause__.errors()[0]
    choices = parameter.type_descriptor.choices
    meant = "".join(f" ({text})" for text in _nearest(str(problem["input"]), choices or ()))
    return f"{hint}: {_required(problem, choices)}, got {problem['input']!r}{meant}"


def _unknown(kind: str, name: str, choices: Iterable[str]) -> str:
    """Return that there is no such command or option."""
    return f"unknown {kind} '{name}' ({'; '.join([*_nearest(name, choices), '--help lists all'])})"


def _options_of(context: Any) -> list[str]:  # noqa: ANN401 typer's own click
    """Return the options of the command of a context."""
    return [
        option
        for parameter in context.command.get_params(context)
        for option in (*parameter.opts, *parameter.secondary_opts)
        if option.startswith("--")
    ]


def _required(problem: ErrorDetails, choices: Sequence[str] | None) -> str:
    """Return what an option must be."""
    from pepper_driver.config.mistakes import requirement

    if choices:
        return f"must be {', '.join(choices[:-1])} or {choices[-1]}"
    with suppress(TypeError, ValueError):
        if not math.isfinite(float(problem["input"])):
            return "must be a finite number"
    return requirement(problem)


def _nearest(name: str, choices: Iterable[str]) -> list[str]:
    """Return a question for the choice that was meant most likely, if any."""
    return [f"did you mean {close}?" for close in get_close_matches(name, list(choices), n=1)]


def _interrupt(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt that ended a command, also if its clean-up failed: the terminal was closed, for example."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error


def _say(text: str) -> None:
    with suppress(OSError):  # the reader has ended
        print(f"pepper: {' '.join(text.split())}", file=sys.stderr, flush=True)
