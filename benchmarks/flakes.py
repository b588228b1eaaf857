"""Flaky tests: the tests run again and again, alone and next to busy processes; every failure is reported.

Results are kept in a file, run by run: an interrupted hunt continues where it was, for the commit that is checked out.
Run: python benchmarks/flakes.py, or make flakes
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pepper_driver.config.files import write_text

ROOT = Path(__file__).resolve().parents[1]
FAILURE = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
PASSED = 0
FAILED = 1
"""Exit codes of pytest."""


@dataclass(frozen=True)
class Round:
    """One kind of run.

    Attributes:
        name: Its name.
        runs: How often it is repeated.
        busy: Number of processes that keep the processors busy meanwhile.
        arguments: Of pytest.
    """

    name: str
    runs: int
    busy: int
    arguments: tuple[str, ...]


def rounds(workers: int, scale: float) -> tuple[Round, ...]:
    """Return the rounds; ``scale`` multiplies their numbers of runs."""
    suite = ("-n", str(workers), "--dist", "worksteal", "-m", "not whole and not realtime")
    real = ("-m", "realtime and not whole")
    kinds = (
        Round("suite alone", 10, 0, suite),
        Round("suite, six busy processes", 5, 6, suite),
        Round("realtime alone", 40, 0, real),
        Round("realtime, six busy processes", 40, 6, real),
    )
    return tuple(
        Round(kind.name, max(1, round(scale * kind.runs)), kind.busy, kind.arguments)
        for kind in kinds
    )


@dataclass(frozen=True)
class Result:
    """A run of the tests.

    Attributes:
        commit: That was checked out.
        round: Name of its round.
        seconds: That it took.
        failures: Tests that failed.
    """

    commit: str
    round: str
    seconds: float
    failures: tuple[str, ...]


def commit() -> str:
    """Return the commit that is checked out, with ``+`` where files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=ROOT, check=True, capture_output=True, text=True
        ).stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no")
    return git("rev-parse", "--short", "HEAD") + ("+" if changed else "")


@contextmanager
def busy(number: int) -> Iterator[None]:
    """Keep the processors busy by so many processes."""
    command = [sys.executable, "-c", "while True: pass"]
    processes = [subprocess.Popen(command) for _ in range(number)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def run(kind: Round, tests: list[str], log: Path) -> Result:
    """Run the tests once.

    Raises:
        SystemExit: They could not be run.
    """
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", *kind.arguments, *tests]
    begin = time.monotonic()
    with busy(kind.busy):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    failures = tuple(sorted(set(FAILURE.findall(done.stdout))))
    if done.returncode not in (PASSED, FAILED) or (done.returncode == FAILED and not failures):
        raise SystemExit(f"pytest ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    if failures:
        with log.open("a") as file:
            file.write(f"== {kind.name} ==\n{done.stdout}\n")
    return Result(commit(), kind.name, time.monotonic() - begin, failures)


def load(path: Path) -> list[Result]:
    """Return the results of a file; none where there is no file."""
    if not path.exists():
        return []
    return [
        Result(**{**entry, "failures": tuple(entry["failures"])})
        for entry in json.loads(path.read_text())
    ]


def main() -> int:
    """Hunt; return 1 if a test failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tests", nargs="*", help="files or tests, by default all")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "flakes.json")
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of runs")
    parser.add_argument("--rounds", nargs="*", help="names of rounds, by default all")
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    console, log, here = Console(), given.out.with_suffix(".log"), commit()
    results = load(given.out)
    table = Table("round", "runs", "with failures", "median [s]")
    failures: list[str] = []
    for kind in rounds(given.workers, given.scale):
        if given.rounds and kind.name not in given.rounds:
            continue
        mine = [result for result in results if (result.commit, result.round) == (here, kind.name)]
        while len(mine) < kind.runs:
            result = run(kind, given.tests, log)
            console.print(
                f"{kind.name}: run {len(mine) + 1} of {kind.runs}, {result.seconds:.0f} s, "
                f"{len(result.failures)} failed"
            )
            mine.append(result)
            results.append(result)
            write_text(given.out, json.dumps([asdict(each) for each in results], indent=1))
        names = sorted({name for result in mine for name in result.failures})
        seconds = sorted(result.seconds for result in mine)[len(mine) // 2]
        wrong = sum(bool(result.failures) for result in mine)
        table.add_row(kind.name, str(len(mine)), str(wrong), f"{seconds:.0f}")
        failures += [f"{kind.name}: {name}" for name in names]
    console.print(table)
    for failure in failures:
        print(failure)
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
