"""Looks at the test split: each with its line in the ledger, on a commit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import pepper_driver.evaluation.touch.split as split
from pepper_driver.config import ConfigError
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.evaluation.touch.commit import CommitError
from pepper_driver.evaluation.touch.ledger import LedgerError, code_hash, read_ledger
from pepper_driver.evaluation.touch.look import LEDGER, records_of_look, take_look
from pepper_driver.evaluation.touch.records import RobotRecord
from pepper_driver.evaluation.touch.split import Judging
from pepper_driver.evaluation.touch.takes import TakeSpec, perform
from support.repositories import git, make_repository
from support.touch_robots import short_judging


@pytest.fixture
def judging(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Judging:
    return short_judging(tmp_path, monkeypatch)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return make_repository(tmp_path / "repository")


@pytest.fixture
def two_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at two robots for development: those for tests are not looked at to test the code."""
    chosen = replace(load_evaluation_baselines(), chosen_on="robots of a test")
    monkeypatch.setattr(
        "pepper_driver.evaluation.touch.look.load_evaluation_baselines", lambda: chosen
    )
    monkeypatch.setattr("pepper_driver.evaluation.touch.ledger.ROBOTS", 2)
    monkeypatch.setattr("pepper_driver.evaluation.touch.ledger.FIRST_DRAW", 40)


def look(judging: Judging, root: Path, **options: Any) -> tuple[Any, tuple[RobotRecord, ...]]:
    return take_look(judging, root=root, workers=1, **options)


def test_a_look_waits_for_the_factors_of_the_baselines(
    judging: Judging, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undecided = replace(load_evaluation_baselines(), chosen_on="nothing yet")
    monkeypatch.setattr(
        "pepper_driver.evaluation.touch.look.load_evaluation_baselines", lambda: undecided
    )
    with pytest.raises(ConfigError, match="not chosen yet"):
        look(judging, root)
    assert not (root / LEDGER).exists()


@pytest.mark.usefixtures("two_robots")
def test_a_look_has_its_line_from_its_begin_and_is_completed(judging: Judging, root: Path) -> None:
    lines: list[str] = []
    line, records = look(
        judging, root, note="first", begun=lambda _: lines.append((root / LEDGER).read_text())
    )
    assert "begun" in lines[0]
    assert [record.draw for record in records] == [40, 41]
    assert (line.state, line.draws, line.robots_done, line.note) == (
        "complete",
        "40-41",
        2,
        "first",
    )
    assert line.commit == git(root, "rev-parse", "HEAD")
    assert line.results.hours is not None
    assert records_of_look(root, line) == records
    with pytest.raises(LedgerError, match="already looked at"):
        look(judging, root)


@pytest.mark.usefixtures("two_robots")
def test_an_interrupted_look_is_resumed_on_its_line_and_commit(
    judging: Judging, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(split, "PART", 1)

    def interrupted(spec: TakeSpec, models: Path | None, **more: Any) -> Any:
        if spec.draw == 41:
            raise KeyboardInterrupt
        return perform(spec, models, **more)

    monkeypatch.setattr(split, "perform", interrupted)
    with pytest.raises(KeyboardInterrupt):
        look(judging, root)
    (begun,) = read_ledger(root / LEDGER)
    assert (begun.state, begun.robots_done) == ("begun", 1)
    # What the look has kept may be committed meanwhile, and nothing else.
    git(root, "add", "-A")
    git(root, "commit", "-qm", "ledger")
    monkeypatch.setattr(split, "perform", perform)
    (root / "code.py").write_text("changed\n")
    with pytest.raises(CommitError, match=r"code\.py"):
        look(judging, root)
    # Files that no record depends on may have changed, once they are committed.
    git(root, "commit", "-qam", "changed")
    monkeypatch.setattr("pepper_driver.evaluation.touch.look.code_hash", lambda: "0123456789ab")
    with pytest.raises(LedgerError, match="have changed since"):
        look(judging, root)
    monkeypatch.setattr("pepper_driver.evaluation.touch.look.code_hash", code_hash)
    line, records = look(judging, root)
    assert (line.look, line.state, line.commit) == (1, "complete", begun.commit)
    assert line.begun == begun.begun
    assert len(records) == 2
    assert len(read_ledger(root / LEDGER)) == 1
