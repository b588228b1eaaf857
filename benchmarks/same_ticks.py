"""Compares the ticks of two commits bit for bit: a refactoring must not change them.

Plays motion and pushes on every shipped plant, unpaced, with an older commit and with this work tree, and compares all
columns of the log's /tick. Some runs have reflexes or another observer, or play shipped motions. Every run uses a copy
of the models of `nominal` or `integral` with the identity of its plant. Columns are compared by name and value, not by
file format. NaN equals NaN, whatever its bits; 0.0 and -0.0 differ. The tables RENAMED, ADDED and REMOVED list what a
change of names does on purpose.

Where a change rounds differently, a robot that is pushed amplifies it in the end to a count of an encoder. With
--close, runs pass whose measured joint angles agree within 0.1 deg rms over the run, and in which the same contacts
begin on the same limbs within two ticks; what differs is listed all the same. Some runs amplify the last bit so much
that nothing can be said of their end: a reflex begins a tick later, and the rest is another motion. So the older side
plays a run that is not close three times more, with forces that differ by some 1e-14 of them. A run is "chaotic", and
passes, where this parts the older side from itself no later than the newer side parts from it: by 1 deg of a joint, or
a contact that begins on one side only.

A run over the stand-in NAOqi never repeats. --record-stand-in stores the inputs of the observer in one such run, in
real time, and compares the outputs of the observers of both sides; --stand-in uses a file stored before.

Run: python benchmarks/same_ticks.py --commit HEAD~5. Exit code 0: same (or close), 1: different,
2: wrong input.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn
from zipfile import BadZipFile

import numpy as np
import yaml
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

Columns = Mapping[str, NDArray[Any]]

RENAMED: dict[str, str] = {}
"""New name to old: columns of /tick, fields of observations and of the ticks that observers get, by path."""
ADDED: frozenset[str] = frozenset()
"""Columns and fields that only the newer side has, on purpose."""
REMOVED: frozenset[str] = frozenset()
"""Columns and fields that only the older side has, on purpose."""

ROOT = Path(__file__).resolve().parents[1]
SIDE = Path(__file__).resolve().with_name("same_ticks_side.py")
PLANTS = ROOT / "config" / "plants"
SIDES = ("older", "newer")
NUDGES = (1e-14, -1e-14, 3e-14)
"""Relative changes of all forces: some last bits."""
CONTACT = "contact."
"""Prefix of the columns of contacts, which have a row for each event."""
SEED = 3  # of sensor noise, and of motion and pushes
DRAWS = {"random": 2}
MODELS = {"fusion": "fusion", "momentum": "fusion", "paper": "affine"}  # by observer
MORE_RUNS: dict[str, tuple[dict[str, Any], ...]] = {  # by plant, in addition to the plain one
    "nominal": (
        {"reflexes": ("Hold",)},
        {"reflexes": ("Comply",)},
        {"observer": "paper"},
        {"motions": True},
    ),
    "integral": (
        {"reflexes": ("Hold", "Comply")},
        {"observer": "momentum"},
        {"motions": True, "reflexes": ("Hold",)},
    ),
}
MAX_SECONDS = 600.0
CLOSE_DEG = 0.1
CLOSE_TICKS = 2
PARTED_DEG = 1.0
CYCLE = 0.012  # [s]
WIDTH = 160  # columns of the table
MAX_SHOWN = 4  # differing columns of a run in the table; all are in the JSON file


class SideError(Exception):
    """One side could not be run; the message is the last line of its errors."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run that both sides do: play, record a run over the stand-in, or observe recorded inputs."""

    do: str = "play"
    plant: str = "nominal"
    board: str = "nominal"  # whose models are used
    draw: int = 0
    observer: str = "fusion"
    reflexes: tuple[str, ...] = ()
    motions: bool = False  # shipped ones, in place of a motion of `seconds`
    seconds: float = 0.0
    nudge: float = 0.0  # of forces, relative
    inputs: str = ""

    @property
    def name(self) -> str:
        if self.inputs:
            return f"stand-in, {self.observer}"
        parts = [f"{self.plant} {self.draw}" if self.plant in DRAWS else self.plant]
        parts += [self.observer] * (self.observer != "fusion") + ["motions"] * self.motions
        return ", ".join([*parts, *self.reflexes])

    @property
    def uri(self) -> str:
        draw = f"&draw={self.draw}" if self.plant in DRAWS else ""
        return f"mujoco://?plant={self.plant}&seed={SEED}{draw}"


@dataclass(frozen=True, kw_only=True)
class Difference:
    """First place at which a column differs."""

    column: str
    row: int
    element: int
    older: str
    newer: str


@dataclass(kw_only=True)
class Comparison:
    """Result of one run. ``one_sided`` are the columns that only one side has, unless that is expected."""

    name: str
    rows: tuple[int, int] = (0, 0)
    columns: int = 0
    differences: list[Difference] = field(default_factory=list)
    one_sided: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    failed: bool = False
    angle_deg: float = 0.0  # largest rms difference of a joint
    contacts: tuple[int, int] = (0, 0)
    alone: list[str] = field(default_factory=list)  # contacts that begin on one side only
    parted: float | None = None  # when both sides were no longer alike [s]
    parted_nudged: list[float | None] = field(default_factory=list)  # the older one from itself

    @property
    def close(self) -> bool:
        if self.same:
            return True
        alike = self.angle_deg <= CLOSE_DEG and not self.alone
        return alike and self.rows[0] == self.rows[1] > 0 and not self.failed

    @property
    def chaotic(self) -> bool:
        earliest = min((time for time in self.parted_nudged if time is not None), default=None)
        if self.parted is None or earliest is None or self.failed:
            return False
        return self.parted >= earliest - (CLOSE_TICKS + 0.5) * CYCLE

    @property
    def same(self) -> bool:
        equal = self.rows[0] == self.rows[1] > 0 and not self.differences
        return equal and not self.one_sided and not self.failed


# -- comparison -------------------------------------------------------------------------------------------------------


def compare(name: str, older: Columns, newer: Columns) -> Comparison:
    """Compare the columns of both sides; of the differences, the first in time comes first."""
    newer = {RENAMED.get(column, column): values for column, values in newer.items()}
    added = {RENAMED.get(column, column) for column in ADDED}
    common = [column for column in older if column in newer]
    found = (first_difference(column, older[column], newer[column]) for column in common)
    older_only = sorted(older.keys() - newer.keys() - REMOVED)
    newer_only = sorted(newer.keys() - older.keys() - added)
    rows = [
        max((len(v) for name, v in side.items() if not name.startswith(CONTACT)), default=0)
        for side in (older, newer)
    ]
    angle, contacts, alone, parted = closeness(older, newer)
    return Comparison(
        parted=parted,
        angle_deg=angle,
        contacts=contacts,
        alone=alone,
        name=name,
        rows=(rows[0], rows[1]),
        columns=len(common),
        differences=sorted((d for d in found if d is not None), key=lambda d: d.row),
        one_sided=[
            *(f"{column}: older side only" for column in older_only),
            *(f"{column}: newer side only" for column in newer_only),
        ],
    )


def closeness(
    older: Columns, newer: Columns
) -> tuple[float, tuple[int, int], list[str], float | None]:
    """Return how alike both sides are.

    Returns:
        Largest rms difference of a joint [deg], contacts of each side, those that have no partner, and the time from
        which both sides are no longer alike [s].
    """
    angles = [side.get("position", np.zeros((0, 1))) for side in (older, newer)]
    count = min(map(len, angles))
    difference = np.degrees(angles[0][:count] - angles[1][:count])
    rms = float(np.sqrt(np.mean(difference**2, axis=0)).max()) if count else 0.0
    begins = [contact_begins(side) for side in (older, newer)]
    alone: list[str] = []
    parted = [
        float(older["time"][row]) for row in np.flatnonzero((abs(difference) > PARTED_DEG).any(1))
    ][:1]
    for name, some, others in zip(SIDES, begins, reversed(begins), strict=True):
        left = list(others)
        for limb, time in some:
            reach = (CLOSE_TICKS + 0.5) * CYCLE
            partners = [
                other for other in left if other[0] == limb and abs(other[1] - time) < reach
            ]
            if partners:
                left.remove(min(partners, key=lambda other: abs(other[1] - time)))
            else:
                alone.append(f"{name}: contact on {limb} at {time:.3f} s")
                parted.append(time)
    return rms, (len(begins[0]), len(begins[1])), alone, min(parted, default=None)


def contact_begins(columns: Columns) -> list[tuple[str, float]]:
    """Limb and time [s] of each contact that begins."""
    phase, limb, time = (columns.get(CONTACT + key, []) for key in ("phase", "limb", "time"))
    return [
        (str(limb[row]), float(time[row])) for row in range(len(phase)) if phase[row] == "begin"
    ]


def first_difference(column: str, older: NDArray[Any], newer: NDArray[Any]) -> Difference | None:
    """Find the first place at which two columns differ; None where they are the same."""
    count = min(len(older), len(newer))
    one, other = (widened(values[:count]) for values in (older, newer))
    forms = [f"{values.shape[1:]}{' text' * (values.dtype.kind == 'U')}" for values in (one, other)]
    if forms[0] != forms[1]:
        return Difference(column=column, row=0, element=0, older=forms[0], newer=forms[1])
    differs = one != other
    if one.dtype.kind == other.dtype.kind == "f":
        differs |= np.signbit(one) != np.signbit(other)
        differs &= ~(np.isnan(one) & np.isnan(other))
    places = np.argwhere(differs.reshape(count, -1) if count else [])
    if len(places):
        row, element = map(int, places[0])
    elif len(older) != len(newer):
        row, element = count, 0
    else:
        return None
    texts = [
        repr(values[row].ravel()[element].item()) if row < len(values) else "ended"
        for values in (older, newer)
    ]
    return Difference(column=column, row=row, element=element, older=texts[0], newer=texts[1])


def widened(values: NDArray[Any]) -> NDArray[Any]:
    """Convert numbers to 64 bits: how wide a file format stores them does not count."""
    kinds = {"f": np.float64, "b": np.int64, "i": np.int64, "u": np.int64}
    return values.astype(kinds.get(values.dtype.kind, values.dtype))


# -- both sides -------------------------------------------------------------------------------------------------------


def run_side(run: Run, tree: Path, out: Path) -> dict[str, Any]:
    """Have one tree do a run; its columns are then in ``out``.

    Raises:
        SideError: It failed.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    models = str(find_models(tree, f"{run.board}-{MODELS[run.observer]}.json"))
    places = {"tree": str(tree), "out": str(out), "models": models}
    job = {**asdict(run), **places, "uri": run.uri, "seed": SEED, "renamed": RENAMED}
    path = os.pathsep.join(filter(None, (str(tree), os.environ.get("PYTHONPATH"))))
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # the other cores have runs too
    result = subprocess.run(
        [sys.executable, "-P", str(SIDE), json.dumps(job)],
        cwd=out.parent,
        env={**os.environ, **threads, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode != 0:
        lines = result.stderr.split("\n") if result.stderr.strip() else ["no message"]
        raise SideError([line for line in lines if line.strip()][-1])
    outcome: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return outcome


def find_models(tree: Path, name: str) -> Path:
    """Find shipped models in a tree, in whatever folder."""
    listed = git("ls-files", "--cached", "--others", "--exclude-standard", f"*{name}", tree=tree)
    for path in listed.splitlines():
        if (tree / path).is_file():
            return tree / path
    raise SideError(f"there is no {name} in {tree}")


def compare_runs(
    runs: Sequence[Run], trees: Sequence[Path], folder: Path, at_a_time: int, *, nudge: bool
) -> list[Comparison]:
    """Have both trees do all runs, several at a time, and compare.

    Args:
        runs: What to do.
        trees: The older and the newer one.
        folder: For the columns.
        at_a_time: Number of processes.
        nudge: Whether runs that are not close are repeated with other last bits.
    """
    with ThreadPoolExecutor(at_a_time) as pool:
        pending = []
        for run in runs:
            places = [folder / run.name.replace(" ", "_") / side / "columns.npz" for side in SIDES]
            sides = zip(trees, places, strict=True)
            jobs = [pool.submit(run_side, run, tree, out) for tree, out in sides]
            pending.append((run, jobs, places))
        try:
            comparisons = [compare_run(run.name, jobs, places) for run, jobs, places in pending]
            if nudge:
                for comparison, (run, _, places) in zip(comparisons, pending, strict=True):
                    if not (comparison.close or comparison.failed or run.inputs):
                        comparison.parted_nudged = part_nudged(run, trees[0], places[0], pool)
            return comparisons
        except BaseException:  # after Ctrl-C no further run begins
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def compare_run(
    name: str, jobs: Sequence[Future[dict[str, Any]]], places: Sequence[Path]
) -> Comparison:
    """Compare both sides of a run, once they are done."""
    columns: list[Columns] = []
    remarks: list[str] = []
    for side, job, out in zip(SIDES, jobs, places, strict=True):
        try:
            remarks += [f"{side}: {key} {value}" for key, value in job.result().items() if value]
        except SideError as error:
            remarks.append(f"{side}: {error}")
            continue
        columns.append(load_columns(out))
    failed = len(columns) < len(SIDES)
    comparison = Comparison(name=name) if failed else compare(name, *columns)
    comparison.failed, comparison.remarks = failed, remarks
    for out in (
        places if comparison.close else places[1:]
    ):  # of the older side, what may be needed again stays
        out.unlink(missing_ok=True)
    return comparison


def part_nudged(run: Run, tree: Path, place: Path, pool: ThreadPoolExecutor) -> list[float | None]:
    """Repeat a run of the older side with other last bits; return when each parts from the columns in ``place`` [s]."""
    places = [
        place.parent.with_name(f"nudged_{number}") / place.name for number in range(len(NUDGES))
    ]
    jobs = [
        pool.submit(run_side, replace(run, nudge=nudge), tree, out)
        for nudge, out in zip(NUDGES, places, strict=True)
    ]
    for job in jobs:
        job.result()
    older = load_columns(place)
    return [closeness(older, load_columns(out))[-1] for out in places]


def load_columns(file: Path) -> Columns:
    """Read the columns of a side."""
    with np.load(file, allow_pickle=False) as columns:
        return dict(columns)


def record(file: Path, seconds: float, tree: Path, folder: Path) -> None:
    """Store the inputs of the observer in a run over the stand-in NAOqi.

    Raises:
        SideError: The run failed, or ended early.
    """
    out = folder / "record" / "inputs.npz"
    outcome = run_side(Run(do="record", seconds=seconds), tree, out)
    if outcome["ended"]:
        raise SideError(f"the run over the stand-in ended early: {outcome['ended']}")
    shutil.move(out, file)


# -- trees and plants -------------------------------------------------------------------------------------------------


def git(*arguments: str, tree: Path = ROOT) -> str:
    """Run git and return its output, empty where it fails."""
    try:
        result = subprocess.run(
            ["git", "-C", str(tree), *arguments], capture_output=True, text=True, check=False
        )
    except OSError:
        return ""
    return result.stdout.strip() if result.returncode == 0 else ""


@contextmanager
def checked_out(commit: str, folder: Path) -> Iterator[Path]:
    """Check a commit out to a new folder, and remove it at the end.

    Raises:
        SideError: git refuses.
    """
    git("worktree", "add", "--detach", str(folder), commit)
    if not folder.is_dir():
        raise SideError(f"'git worktree add' cannot check out {commit} to {folder}")
    try:
        yield folder
    finally:
        git("worktree", "remove", "--force", str(folder))


def shipped_plants() -> dict[str, str]:
    """Names of the plants of this work tree, each with the one of ``nominal`` and ``integral`` that it extends.

    Of a plant that takes several in turn, the first.
    """
    boards = {}
    for path in sorted(PLANTS.glob("*.yaml")):
        board = path.stem
        while board not in ("nominal", "integral"):
            parent = yaml.safe_load((PLANTS / f"{board}.yaml").read_text()).get(
                "extends", "nominal"
            )
            board = parent[0] if isinstance(parent, list) else parent
        boards[path.stem] = board
    return boards


def runs_on(plants: Sequence[str], boards: Mapping[str, str], seconds: float) -> list[Run]:
    """Runs on these plants."""
    return [
        Run(plant=plant, board=boards[plant], draw=draw, seconds=seconds, **more)
        for plant in plants
        for draw in range(DRAWS.get(plant, 1))
        for more in ({}, *MORE_RUNS.get(plant, ()))
    ]


# -- command line -----------------------------------------------------------------------------------------------------


class Parser(argparse.ArgumentParser):
    """Reports a wrong input in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"same_ticks.py: {message}", file=sys.stderr)
        sys.exit(2)


def arguments() -> tuple[argparse.Namespace, list[Run]]:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commit", required=True, metavar="REV", help="the older side")
    parser.add_argument("--to", metavar="REV", help="the newer side (default: this work tree)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each run (default: 60)")
    parser.add_argument("--plants", metavar="A,B", help="default: all; none: only the stand-in")
    parser.add_argument("--record-stand-in", type=Path, metavar="FILE.npz", help="and compare")
    parser.add_argument("--stand-in", type=Path, metavar="FILE.npz", help="recorded before")
    parser.add_argument("--close", action="store_true", help="angles and contacts decide")
    cores = len(os.sched_getaffinity(0))
    parser.add_argument("--jobs", type=int, default=cores, help="at a time (default: all cores)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the result to FILE")
    given = parser.parse_args()
    if not 0.1 <= given.seconds <= MAX_SECONDS:
        parser.error(f"--seconds must be 0.1 to {MAX_SECONDS:g}, got {given.seconds:g}")
    if given.jobs < 1:
        parser.error(f"--jobs must be at least 1, got {given.jobs}")
    for option in ("commit", "to"):
        name = getattr(given, option)
        if name is not None:
            commit = git(
                "rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}"
            )
            if not commit:
                parser.error(f"--{option}: git knows no commit '{name}' in {ROOT}")
            setattr(given, option, commit)
    boards = shipped_plants()
    plants = list(boards) if given.plants is None else given.plants.split(",")
    plants = [] if plants == ["none"] else plants
    for plant in plants:
        if plant not in boards:
            parser.error(f"--plants: there is no plant '{plant}', only {', '.join(boards)}")
    runs = runs_on(plants, boards, given.seconds)
    if given.record_stand_in is not None and given.stand_in is not None:
        parser.error("--stand-in uses a run recorded before: leave out --record-stand-in")
    stand_in = given.stand_in or given.record_stand_in
    if stand_in is not None:
        inputs = str(stand_in.resolve())
        runs += [Run(do="observe", observer=observer, inputs=inputs) for observer in MODELS]
    if not runs:
        parser.error("nothing to compare: give plants, --stand-in or --record-stand-in")
    for file in (given.record_stand_in, given.json):
        if file is not None and (file.is_dir() or not file.resolve().parent.is_dir()):
            parser.error(f"{file} cannot be written: it is a folder, or in none that exists")
    if given.stand_in is not None:
        try:
            with np.load(given.stand_in, allow_pickle=False) as file:
                file["measurement.time"]
        except OSError as error:
            parser.error(f"{given.stand_in} cannot be read ({error.strerror})")
        except (EOFError, ValueError, LookupError, TypeError, BadZipFile):
            parser.error(f"{given.stand_in} is not a file of --record-stand-in")
    return given, runs


def verdict(run: Comparison) -> str:
    """Name the result of a run."""
    if run.failed:
        return "FAILED"
    results = {"same": run.same, "close": run.close, "chaotic": run.chaotic}
    return next((name for name, holds in results.items() if holds), "DIFFERENT")


def partings(run: Comparison) -> list[str]:
    """Report when both sides part, and when the older one from itself."""
    if not run.parted_nudged:
        return []
    parted, *nudged = (
        "not" if time is None else f"at {time:.2f} s" for time in (run.parted, *run.parted_nudged)
    )
    return [f"parts {parted}; older side from itself, with other last bits: {', '.join(nudged)}"]


def as_table(comparisons: Sequence[Comparison]) -> Table:
    """Make a table of all runs."""
    first = "first difference (row, element): older, newer"
    table = Table("run", "ticks", "columns", "deg rms", "contacts", "result", first)
    for run in comparisons:
        lines = [
            f"{d.column} ({d.row}, {d.element}): {d.older}, {d.newer}" for d in run.differences
        ]
        if len(lines) > MAX_SHOWN:
            lines[MAX_SHOWN:] = [f"and {len(lines) - MAX_SHOWN} more columns"]
        older, newer = run.rows
        table.add_row(
            run.name,
            str(older) if older == newer else f"{older} / {newer}",
            str(run.columns),
            f"{run.angle_deg:.4f}",
            f"{run.contacts[0]} / {run.contacts[1]}",
            verdict(run),
            "\n".join([*lines, *run.one_sided, *run.alone, *partings(run), *run.remarks]),
        )
    return table


def main() -> int:
    """Command line: 0 same, 1 different, 2 wrong input."""
    given, runs = arguments()
    try:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="same_ticks_")))
            trees = [
                stack.enter_context(checked_out(commit, folder / side)) if commit else ROOT
                for side, commit in zip(SIDES, (given.commit, given.to), strict=True)
            ]
            if given.record_stand_in is not None:  # alone: it runs in real time
                record(given.record_stand_in, given.seconds, trees[1], folder)
            comparisons = compare_runs(runs, trees, folder, given.jobs, nudge=given.close)
    except SideError as error:
        print(f"same_ticks.py: {error}", file=sys.stderr)
        return 2
    Console(width=WIDTH, highlight=False).print(as_table(comparisons))
    same = all(run.close or run.chaotic if given.close else run.same for run in comparisons)
    if given.json is not None:
        document = {
            "older": given.commit,
            "newer": given.to or "work tree",
            "seconds": given.seconds,
            "same": same,
            "runs": [
                {**asdict(run), "same": run.same, "result": verdict(run)} for run in comparisons
            ],
        }
        given.json.write_text(json.dumps(document, indent=1) + "\n")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
