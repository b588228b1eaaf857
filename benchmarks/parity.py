"""Plays the same example or experiment in several worlds, and compares the results.

The worlds: sim, the unpaced simulation; paced, the simulation in real time, with the loop thread; stand-in, the same
simulated robot over the stand-in NAOqi and real qi. Each file of examples/ and examples/experiments/ that runs on a
real robot is played as it stands: only robot and pace are forced (parity_side.py).

Compared with the first world are results of the facade's calls; pushes and steps; contacts by limb and order, with
onsets that count from the push or step before, by the robot's clock; reflexes, touch sensors, faults and cues in their
order; calls of callbacks. In each world every callback must have been called once for each of its events in the log.
The limb of a contact is the one it was last reported on. A table says what differs
by nature.

Nothing else should keep the machine busy. Run: python benchmarks/parity.py. Exit code 0: same, 1: different, 2: wrong
input.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console
from rich.table import Table

from pepper_driver.config import MissingExtraError, PepperError, suggestion
from pepper_driver.config.files import check_writable, write_json

Played = Mapping[str, Any]
"""Result of a program in one world, as parity_side.py writes it."""

ROOT = Path(__file__).resolve().parents[1]
SIDE = Path(__file__).resolve().with_name("parity_side.py")
SIMULATED_ONLY = {"drag_the_arm.py"}
"""Programs that need what only a simulated robot has: a hand that leads it."""
PROGRAMS = {
    path.name: path
    for pattern in ("examples/*.py", "examples/experiments/*.yaml")
    for path in sorted(ROOT.glob(pattern))
    if path.name not in SIMULATED_ONLY
}
WORLDS = ("sim", "paced", "stand-in")
MAX_ONSET_DIFFERENCE = 0.1  # [s]
MAX_MISSED = 10  # ticks of a run over the stand-in that still counts
MAX_AGE = 0.1  # [s] of its samples
EVENTS = ("reflexes", "sensors", "faults", "cues")
MAX_TIME = 300.0  # [s] of a program in one world

BY_NATURE = {  # in sim, paced and over the stand-in
    "time passes": (
        "inside `run` and `step` only",
        "all the time, in the loop thread",
        "all the time, in the loop thread",
    ),
    "ticks": (
        "those of `run`, `play` and `step`, none missed",
        "also those between calls; a busy machine misses some, and calls then last longer",
        "as paced",
    ),
    "two runs give": ("the same bits", "the same contacts", "the same contacts"),
    "a new start finds": ("a new robot", "a new robot", "the robot as it was left"),
    "time of the first tick": (
        "1 s, after the ramp of the stiffness",
        "as sim",
        "2 to 5 s, after waking up",
    ),
    "age of samples": ("0", "0", "0, or 1 to 2 cycles on a busy machine"),
    "a push begins": (
        "with the next cycle",
        "with the next cycle",
        "with the next cycle once the stand-in has the order: a few ms",
    ),
    "callbacks": (
        "have caught up when `run` returns",
        "may still be at work when `run` returns",
        "as paced",
    ),
    "an emergency stop acts": (
        "in the next `run` or `step`",
        "in the next tick",
        "in the next tick",
    ),
    "speech and lights of cues": ("a line of logging", "a line of logging", "by the robot"),
    "ground truth in the log": ("yes", "yes", "no"),
    "plant, world and seed": ("of the URI", "of the URI", "of the robot, given at its start"),
    "noise decides": (
        "last digits, links within a limb, updates and ends of contacts, rebounds",
        "as sim",
        "as sim",
    ),
}
"""What may differ."""


# -- comparison -------------------------------------------------------------------------------------------------------


def compare(results: Sequence[Played]) -> list[str]:
    """Return all differences between the first world and the others, and what is wrong in each by itself."""
    found = [f"{played['world']}: {text}" for played in results for text in own_faults(played)]
    for played in results[1:]:
        found += [f"{played['world']}: {text}" for text in differences(results[0], played)]
    return found


def own_faults(played: Played) -> list[str]:
    """Return how the program failed, and which callbacks were not called once for each event."""
    found = [f"ended with {played['error']}"] if played["error"] else []
    for callback in played["callbacks"]:
        found += [f"{callback['name']} was not called for {key}" for key in callback["missing"]]
        found += [
            f"{callback['name']} was called once more for {key}" for key in callback["surplus"]
        ]
    return found


def differences(first: Played, other: Played) -> list[str]:
    """Return where two worlds differ, beyond what differs by nature."""
    found = unequal("the calls of the facade ended with", first["outcomes"], other["outcomes"])
    found += unequal("number of runs", len(first["runs"]), len(other["runs"]))
    for number, (run, runs) in enumerate(zip(first["runs"], other["runs"], strict=False)):
        where = f"run {number}: "
        for what in ("marks", *EVENTS):
            found += unequal(where + what, run[what], runs[what])
        found += [where + text for text in contact_differences(run["contacts"], runs["contacts"])]
    return found + unequal("calls of callbacks", called(first), called(other))


def contact_differences(first: Sequence[Played], other: Sequence[Played]) -> list[str]:
    """Return where the contacts of two runs differ in limb, order or onset."""
    found = unequal("limbs of contacts", limbs(first), limbs(other))
    if found:
        return found
    for number, (contact, its) in enumerate(zip(first, other, strict=True)):
        found += unequal(f"push or step before contact {number}", contact["mark"], its["mark"])
        if abs(its["onset"] - contact["onset"]) > MAX_ONSET_DIFFERENCE:
            found.append(
                f"contact {number} on {contact['limb']} begins {its['onset']:.3f} s after its push or step, not"
                f" {contact['onset']:.3f} s"
            )
    return found


def unequal(what: str, expected: object, found: object) -> list[str]:
    """Return a text where two values are not equal."""
    return [] if found == expected else [f"{what}: {found}, not {expected}"]


def limbs(contacts: Sequence[Played]) -> list[str]:
    """Return the limbs of contacts in their order."""
    return [contact["limb"] for contact in contacts]


def called(played: Played) -> list[tuple[str, int]]:
    """Return the callbacks and their calls, those for ticks and updates of contacts left out."""
    return [(callback["name"], callback["once"]) for callback in played["callbacks"]]


def overload(played: Played) -> str:
    """Return how far the machine fell behind; empty where it kept up."""
    missed = sum(run["missed"] for run in played["runs"])
    age = max((run["max_age"] for run in played["runs"]), default=0.0)
    if missed <= MAX_MISSED and age <= MAX_AGE and "SlowLinkError" not in played["error"]:
        return ""
    return f"{played['world']}: the machine was too slow: {missed} ticks missed, samples up to {age:.2f} s old"


# -- worlds -----------------------------------------------------------------------------------------------------------


def play(program: Path, world: str) -> Played:
    """Play a program in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "played.json"
        job = json.dumps({"program": str(program), "world": world, "out": str(out)})
        error = ""
        try:
            done = subprocess.run(
                [sys.executable, str(SIDE), job],
                capture_output=True,
                text=True,
                timeout=MAX_TIME,
                check=False,
            )
            error = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        except subprocess.TimeoutExpired:
            error = f"more than {MAX_TIME:g} s"
        if not out.exists():
            return {"world": world, "error": error, "runs": [], "callbacks": [], "outcomes": []}
        result: Played = json.loads(out.read_text(encoding="utf-8"))
        return result


# -- output -----------------------------------------------------------------------------------------------------------


def shown(compared: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return the table of all programs: a row for each run in each world."""
    table = Table("program", "world", *CELLS, "calls of callbacks")
    for name, result in compared.items():
        for played in result["worlds"]:
            calls = str(sum(callback["calls"] for callback in played["callbacks"]))
            for number, run in enumerate(played["runs"]):
                first = number == 0
                cells = [cell(run) for cell in CELLS.values()]
                table.add_row(name, played["world"], *cells, calls if first else "")
                name = ""
        table.add_section()
    return table


CELLS: dict[str, Callable[[Any], str]] = {
    "contacts, onset [ms]": lambda run: ", ".join(
        f"{contact['limb']} {1e3 * contact['onset']:.0f}" for contact in run["contacts"]
    ),
    "reflexes": lambda run: counted([r for r in run["reflexes"] if r.endswith("begin")]),
    "sensors, faults, cues": lambda run: str(sum(len(run[w]) for w in EVENTS[1:]) or ""),
    "ticks / missed": lambda run: f"{run['ticks']} / {run['missed']}",
    "first tick at [s]": lambda run: f"{run['begin']:.2f}",
    "oldest sample [ms]": lambda run: f"{1e3 * run['max_age']:.0f}",
    "truth": lambda run: "yes" if run["truth"] else "no",
}
"""Columns of a run."""


def counted(begins: Sequence[str]) -> str:
    """Return the names of reflexes that began, each with how often it did."""
    return ", ".join(f"{name.split()[0]} x {n}" for name, n in Counter(begins).items())


def by_nature() -> Table:
    """Return the table of what may differ."""
    table = Table("what differs by nature", *WORLDS, show_lines=True)
    for what, cells in BY_NATURE.items():
        table.add_row(what, *cells)
    return table


# -- command line -----------------------------------------------------------------------------------------------------


class Parser(argparse.ArgumentParser):
    """Argument parser that reports what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"parity.py: {message}", file=sys.stderr)
        sys.exit(2)


def arguments() -> argparse.Namespace:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--only",
        action="append",
        metavar="NAME",
        help="an example or experiment, such as feel_a_push.py; may be repeated (default: all)",
    )
    parser.add_argument(
        "--worlds",
        default=",".join(WORLDS),
        help="two or more, the first is what others are compared with (default: sim,paced,stand-in)",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to FILE")
    given = parser.parse_args()
    given.worlds = given.worlds.split(",")
    for kind, names, known in (
        ("example or experiment", given.only or (), PROGRAMS),
        ("world", given.worlds, WORLDS),
    ):
        for name in names:
            if name not in known:
                parser.error(f"unknown {kind} '{name}'{suggestion(name, known)}")
    if len(set(given.worlds)) != len(given.worlds) or len(given.worlds) < 2:
        parser.error("--worlds takes two different ones or more, such as sim,paced")
    if "stand-in" in given.worlds and find_spec("qi") is None:
        parser.error(str(MissingExtraError("the world stand-in", "naoqi")))
    if given.json is not None:
        try:
            check_writable(given.json)
        except PepperError as error:
            parser.error(str(error))
    return given


def main() -> int:
    """Command line: 0 same, 1 different, 2 wrong input."""
    given = arguments()
    console = Console(soft_wrap=True, highlight=False, markup=False)  # units stand in brackets
    compared = {}
    for name in dict.fromkeys(given.only or PROGRAMS):
        results = [play(PROGRAMS[name], world) for world in given.worlds]
        found = compare(results)
        remarks = [*found, *filter(None, map(overload, results))] if found else []
        console.print("\n  ".join([f"{name}: {'DIFFERENT' if found else 'same'}", *remarks]))
        compared[name] = {"same": not found, "differences": found, "worlds": results}
    console.print(shown(compared), by_nature(), sep="\n")
    same = all(result["same"] for result in compared.values())
    if given.json is not None:
        write_json(given.json, {"simulated": True, "same": same, "programs": compared})
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
