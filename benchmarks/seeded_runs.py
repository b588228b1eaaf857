"""Shared parts of benchmarks of many seeded runs: results that outlast Ctrl-C, fractions with intervals, errors."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from rich.console import Console
from scipy.stats import binomtest, chi2

from pepper_driver.config.files import OutputError, check_writable, write_json
from pepper_driver.config.workers import run_jobs

FILE_WIDTH = 240  # columns
MAX_RUNS = 1000

Result = dict[str, Any]


def seeds(root: int, count: int, *place: int) -> list[int]:
    """Return independent seeds of a root."""
    sequence = np.random.SeedSequence([root, *place])
    return [int(seed) for seed in sequence.generate_state(count, np.uint64)]


def perform(
    runs: dict[str, Callable[[], Result]], path: Path | None, jobs: int, console: Console
) -> dict[str, Result]:
    """Return the results of all runs; those in the file are not repeated, and each one is written as it ends."""
    done: dict[str, Result] = {}
    if path is not None:
        if path.is_file():
            done = read_results(path)
        check_writable(path)
    missing = {name: run for name, run in runs.items() if name not in done}
    named = (partial(_named, name, run) for name, run in missing.items())
    for count, (name, result) in enumerate(run_jobs(named, workers=jobs, ordered=False), 1):
        done[name] = result
        console.print(f"{count} of {len(missing)}: {name}", highlight=False)
        if path is not None:
            write_json(path, {"simulated": True, "runs": done})
    return {name: done[name] for name in runs}


def read_results(path: Path) -> dict[str, Result]:
    """Return the results in a file.

    Raises:
        OutputError: It is no file of this program.
    """
    try:
        runs = json.loads(path.read_text(encoding="utf-8"))["runs"]
        return {str(name): dict(result) for name, result in runs.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(
            f"{path}: holds no results of this benchmark; give another file"
        ) from error


def _named(name: str, run: Callable[[], Result]) -> tuple[str, Result]:
    return name, run()


def fraction_text(count: int, of: int) -> str:
    """Return a human-readable fraction with its 95 % interval (Clopper-Pearson)."""
    if not of:
        return "-"
    low, high = binomtest(count, of).proportion_ci(0.95, method="exact")
    return f"{count} of {of} [{low:.2f}-{high:.2f}]"


def rate_bound(count: int, hours: float) -> float:
    """Return what a rate is below with 95 %, given so many events in these hours (Poisson) [1/h]."""
    return float(chi2.ppf(0.95, 2 * count + 2) / 2.0 / hours)


class Parser(argparse.ArgumentParser):
    """Options of such a benchmark; errors of one line."""

    def add_run_options(self, *, roots: dict[str, int], runs: int, runs_help: str) -> None:
        """Add those that all have."""
        self.add_argument("--seeds", choices=tuple(roots), default="development")
        self.add_argument("--runs", type=int, default=runs, help=runs_help)
        self.add_argument("--jobs", type=int, default=1, help="processes; -1 for one per core")
        self.add_argument(
            "--json", type=Path, help="results, and where a run that was broken off goes on"
        )

    def check_run_options(self, given: argparse.Namespace) -> None:
        """Refuse numbers that make no sense."""
        if not 1 <= given.runs <= MAX_RUNS:
            self.error(f"--runs must be 1 to {MAX_RUNS}, got {given.runs}")
        if given.jobs < 1 and given.jobs != -1:
            self.error(f"--jobs must be 1 or more, or -1, got {given.jobs}")

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")
