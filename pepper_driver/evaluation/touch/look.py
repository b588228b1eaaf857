"""A look at the test split: from a clean commit, with a line in the ledger from its begin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pepper_driver
from pepper_driver.config import ConfigError
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.config.population import allow_test_draws
from pepper_driver.config.workers import Workers
from pepper_driver.evaluation.touch.commit import check_clean, check_resumed
from pepper_driver.evaluation.touch.ledger import (
    LedgerError,
    Look,
    begin_look,
    check_whole,
    code_hash,
    complete_look,
    constants_hash,
    look_folder,
    read_ledger,
    update_look,
)
from pepper_driver.evaluation.touch.records import RobotRecord, load_robot_record
from pepper_driver.evaluation.touch.split import Judging, Progress, judge
from pepper_driver.evaluation.touch.summary import main_results

NOTHING = "nothing yet"
"""Begin of ``chosen_on`` in ``evaluation_baselines.yaml`` before the factors are chosen."""

LEDGER = Path("docs/results/ledger.csv")
"""In the repository."""


def repository_or_none() -> Path | None:
    """Return the folder of the repository that this package is run from; None where it is installed without one."""
    root = Path(pepper_driver.__file__).resolve().parents[1]
    return root if (root / "pyproject.toml").is_file() else None


def repository() -> Path:
    """Return the folder of the repository that this package is run from.

    Raises:
        ConfigError: It is installed without one.
    """
    root = repository_or_none()
    if root is None:
        raise ConfigError(
            "the test split is judged from a checkout of the repository: install the package with 'pip install -e .'"
        )
    return root


def take_look(
    judging: Judging,
    *,
    root: Path,
    note: str = "",
    give_up: bool = False,
    workers: Workers = -1,
    begun: Callable[[Look], None] | None = None,
    progress: Progress | None = None,
) -> tuple[Look, tuple[RobotRecord, ...]]:
    """Look at the test split, or resume a look that was interrupted.

    Args:
        judging: Rules; its ``records`` are put next to the ledger.
        root: Folder of the repository.
        note: Reason for the look.
        give_up: True to give up an unfinished look, and its draws.
        workers: As of :func:`judge`.
        begun: Called with the line of the ledger before anything is simulated.
        progress: As of :func:`judge`.

    Returns:
        The line of the ledger, and the robots.

    Raises:
        ConfigError: The factors of the baselines are not chosen yet.
        CommitError: The commit is not clean, or does not come from that of the unfinished look.
        LedgerError: The ledger is damaged, or does not allow this look.
        PepperError: As of :func:`judge`.
    """
    ledger = root / LEDGER
    check_chosen()
    own = (ledger, *(look_folder(ledger, n) for n in range(1, len(read_ledger(ledger)) + 2)))
    # Locks lie next to the files that they lock.
    allowed = [*own, *(path.with_name(f".{path.name}.lock") for path in own)]
    commit = check_clean(root, allowed)
    check_whole(root, ledger)
    look = begin_look(
        ledger,
        commit=commit,
        code=code_hash(),
        constants=constants_hash(),
        suites=judging.suites.digest,
        note=note,
        give_up=give_up,
    )
    check_resumed(root, look.commit)
    if begun is not None:
        begun(look)
    done: set[int | None] = set()

    def kept(record: RobotRecord) -> None:
        done.add(record.draw)
        update_look(ledger, look.look, robots_done=len(done))

    with allow_test_draws():
        records = judge(
            replace(judging, records=look_folder(ledger, look.look)),
            look.numbers,
            workers=workers,
            progress=progress,
            kept=kept,
        )
    return complete_look(ledger, look.look, main_results(records)), records


def check_chosen() -> None:
    """Refuse a look before the factors of the baselines were chosen.

    Raises:
        ConfigError: They are still to be chosen.
    """
    if load_evaluation_baselines().chosen_on.startswith(NOTHING):
        raise ConfigError(
            "evaluation_baselines.yaml: the factors of the baselines are not chosen yet, and are to be before the test "
            "split is looked at: 'python benchmarks/match_baselines.py'"
        )


def last_look(root: Path) -> tuple[Look, tuple[RobotRecord, ...]]:
    """Return the last look, complete or not, with the robots that it has kept.

    Raises:
        LedgerError: There was none, or the ledger is damaged.
        RecordError: A record is damaged.
    """
    ledger = read_ledger(root / LEDGER)
    if not ledger:
        raise LedgerError(f"{root / LEDGER}: there was no look at the test split yet")
    return ledger[-1], records_of_look(root, ledger[-1])


def records_of_look(root: Path, look: Look) -> tuple[RobotRecord, ...]:
    """Return the robots that a look has kept, in the order of their draws."""
    folder = look_folder(root / LEDGER, look.look)
    records = (load_robot_record(path) for path in folder.glob("*.json.gz"))
    return tuple(sorted(records, key=lambda record: record.draw or 0))
