"""Choice of the factors in ``config/evaluation_baselines.yaml``: baselines at the false contacts of our own observer.

Robots of the development split are left alone, standing and moving, as `pepper evaluate --split development` does. The
factor of a baseline with a constant threshold is the smallest of its FACTORS with which it has no more false contacts
(begins and moves) than `fusion` on the same ticks; the largest where none is enough. They are chosen before a
look at the test split. Takes that are over are kept: the same command goes on after Ctrl-C.
Run: python benchmarks/match_baselines.py --draws 0-7
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pepper_driver import PepperError
from pepper_driver.cli.console import make_progress
from pepper_driver.cli.evaluate_split import DEFAULT_FOLDER
from pepper_driver.config import load_robot
from pepper_driver.config.evaluation_baselines import STATIC_BASELINES
from pepper_driver.config.population import parse_draws
from pepper_driver.config.touch_suites import load_touch_suites
from pepper_driver.evaluation.touch.observers import FUSION
from pepper_driver.evaluation.touch.split import Judging, judge
from pepper_driver.evaluation.touch.summary import summarise_touch
from pepper_driver.evaluation.touch.summary_data import TouchSummary

FACTORS = {
    "momentum": (1.0, 4.0, 4.3, 4.6, 5.0, 5.5, 6.0, 7.0),
    "paper-affine": (1.0, 7.5, 7.7, 8.0, 8.5, 9.0, 10.0, 12.0),
    "paper-cart": (1.0, 7.5, 8.0, 8.5, 9.0, 10.0, 12.0),
    "error": (1.0, 8.0, 8.5, 9.0, 10.0),
}
"""1, and a fine grid where coarser ones came down to the false contacts of ours."""


def false_contacts(summary: TouchSummary, observer: str) -> int:
    """Return the false begins and moves of an observer on all robots."""
    found = summary.observer(observer)
    false = None if found is None else found.false_contacts()
    if false is None:
        raise PepperError(f"{observer} was judged on no robot")
    return false.events


def main() -> int:
    """Judge, and print the counts and the factors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--draws", default="0-7", help="robots of the development split")
    parser.add_argument("--workers", type=int, default=-1)
    parser.add_argument(
        "--folder", type=Path, default=DEFAULT_FOLDER, help="keeps models and takes"
    )
    options = parser.parse_args()
    robot, console = load_robot(), Console()
    suites = load_touch_suites(robot)
    grid = {name: [f"{name}@{f:g}" for f in FACTORS[name]] for name in STATIC_BASELINES}
    observers = (FUSION, *(name for names in grid.values() for name in names))
    judging = Judging(
        suites=suites,
        free=suites.splits["development"].free,
        observers=observers,
        folder=options.folder,
        records=options.folder / "matching",
        touch=False,
        keep_recordings=True,
    )
    with make_progress(console) as progress:
        bar = progress.add_task("judging", total=None)
        records = judge(
            judging,
            parse_draws(options.draws),
            workers=options.workers,
            progress=lambda what, done, total: progress.update(bar, completed=done, total=total),
        )
    summary = summarise_touch(records, observers, robot, suites=suites, by_state=())
    ours = false_contacts(summary, FUSION)
    hours = sum(take.seconds for record in records for take in record.takes) / 3600.0
    table = Table(title=f"false contacts in {hours:.2f} h without touch; {FUSION}: {ours}")
    for name in ("baseline", "by factor", "chosen"):
        table.add_column(name)
    for name, names in grid.items():
        counts = dict(
            zip(FACTORS[name], (false_contacts(summary, one) for one in names), strict=True)
        )
        chosen = next((f for f, count in counts.items() if count <= ours), max(counts))
        text = ", ".join(f"{factor:g}: {count}" for factor, count in counts.items())
        table.add_row(name, text, f"{chosen:g}")
    console.print(table)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except PepperError as error:
        sys.exit(f"match_baselines: {error}")
