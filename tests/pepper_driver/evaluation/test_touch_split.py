"""Robots of a split: judged once, kept, and the same whoever works; looks at the test split, with their line."""

import shutil
import subprocess
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import pepper_driver.evaluation.touch.split as split
from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.config.population import HeldOutDrawError
from pepper_driver.config.touch_suites import load_touch_suites
from pepper_driver.config.workers import run_jobs
from pepper_driver.evaluation.touch.commit import CommitError
from pepper_driver.evaluation.touch.ledger import LedgerError, code_hash, read_ledger
from pepper_driver.evaluation.touch.look import LEDGER, records_of_look, take_look
from pepper_driver.evaluation.touch.observers import ModelFiles, make
from pepper_driver.evaluation.touch.records import RecordError, RobotRecord, load_robot_record
from pepper_driver.evaluation.touch.split import Judging, judge
from pepper_driver.evaluation.touch.takes import TakeSpec, perform
from support.touch_robots import FAILS, identified, own_models, two_takes

SUITES = load_touch_suites(load_robot())


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(split, "identify_population", identified)
    monkeypatch.setattr(Judging, "specs", two_takes)


@pytest.fixture
def judging(tmp_path: Path) -> Judging:
    return Judging(
        suites=SUITES,
        free=40.0,
        observers=("fusion", "momentum"),
        folder=tmp_path / "work",
        records=tmp_path / "records",
    )


def test_a_robot_is_touched_and_left_alone_and_its_record_kept(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    (record,) = judge(judging, [0], workers=1)
    assert (record.robot, record.draw, record.law) == ("random 0", 0, "nominal")
    assert record.fit == {"LElbowRoll": 80.0}
    touched, free = record.takes
    assert (touched.suite, len(touched.touches)) == ("touch", 2)
    assert (free.suite, free.touches) == ("free", ())
    for take in record.takes:
        assert list(take.hearings) == ["fusion", "momentum"]
        assert not any(hearing.failure for hearing in take.hearings.values())
    assert load_robot_record(judging.records / "random-0.json.gz") == record
    # A second call takes what is there.
    monkeypatch.setattr(split, "identify_population", None)
    monkeypatch.setattr(split, "perform", None)
    assert judge(judging, [0], workers=1) == (record,)


def test_an_interrupted_night_goes_on_with_the_takes_that_it_has(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    performed: list[str] = []

    def interrupted(spec: TakeSpec, models: Path | None, **more: Any) -> Any:
        if performed:
            raise KeyboardInterrupt
        performed.append(spec.name)
        return perform(spec, models, **more)

    monkeypatch.setattr(split, "perform", interrupted)
    with pytest.raises(KeyboardInterrupt):
        judge(judging, [0], workers=1)
    kept = performed[:]

    def counted(spec: TakeSpec, models: Path | None, **more: Any) -> Any:
        performed.append(spec.name)
        return perform(spec, models, **more)

    monkeypatch.setattr(split, "perform", counted)
    (record,) = judge(judging, [0], workers=1)
    assert len(kept) == 1
    assert sorted(performed) == ["free-gesturing-0", "touch-gesturing-0"]
    assert len(record.takes) == 2


def test_progress_is_of_all_robots_that_are_left(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(split, "PART", 1)
    judge(judging, [0], workers=1)
    seen: list[tuple[float, float]] = []
    judge(
        judging, [0, FAILS, 2], workers=1, progress=lambda _, done, all_: seen.append((done, all_))
    )
    # Of two robots: the identification, and two takes.
    done, totals = zip(*seen, strict=True)
    assert len(done) == 6
    assert len(set(totals)) == 1
    assert list(done) == sorted(done)
    assert done[-1] == pytest.approx(totals[0])
    # By the robot's time: an identification takes as long as many takes.
    assert done[0] > 10.0 * (done[1] - done[0])


def test_another_observer_is_judged_anew(judging: Judging) -> None:
    judge(judging, [0], workers=1)
    other = replace(judging, observers=("fusion",))
    (record,) = judge(other, [0], workers=1)
    assert list(record.takes[0].hearings) == ["fusion"]


def test_a_damaged_record_is_made_again(judging: Judging) -> None:
    (record,) = judge(judging, [0], workers=1)
    path = judging.records / "random-0.json.gz"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(RecordError):
        load_robot_record(path)
    assert judge(judging, [0], workers=1) == (record,)


def test_a_robot_whose_owner_failed_stays_with_its_touches(judging: Judging) -> None:
    (record,) = judge(judging, [FAILS], workers=1)
    assert record.failure == "it broke"
    assert record.law == "integral"
    touched, _ = record.takes
    assert len(touched.touches) == 2
    assert touched.hearings == {}


def test_an_observer_that_fails_says_so_and_the_others_are_judged(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "momentum":
            raise ValueError("no way")
        return make(name, *args, **kwargs)

    monkeypatch.setattr(split, "make", broken)
    (record,) = judge(judging, [0], workers=1)
    assert record.takes[0].hearings["momentum"].failure == "ValueError: no way"
    assert record.takes[0].hearings["fusion"].failure == ""


def test_a_robot_for_tests_is_refused(judging: Judging) -> None:
    with pytest.raises(HeldOutDrawError):
        judge(judging, [100], workers=1)


# -- looks ------------------------------------------------------------------------------------------------------------


def git(root: Path, *arguments: str) -> str:
    settings = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
    done = subprocess.run(
        ["git", *settings, *arguments], cwd=root, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    if shutil.which("git") is None:
        pytest.skip("no git here")
    root = tmp_path / "repository"
    root.mkdir()
    git(root, "init", "-q")
    (root / "code.py").write_text("pass\n")
    git(root, "add", "-A")
    git(root, "commit", "-qm", "first")
    return root


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
def test_code_that_changes_while_robots_are_judged_is_seen(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes = iter(["of the begin", "of the begin", "of later"])  # key, versions of the part
    monkeypatch.setattr(split, "code_hash", lambda: next(hashes))
    with pytest.raises(split.ChangedError, match="have changed"):
        judge(judging, [0], workers=1)


def test_a_take_that_fails_in_any_way_costs_no_other(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: object) -> None:
        raise RuntimeError("of no kind that is known")

    monkeypatch.setattr("pepper_driver.evaluation.touch.takes._Stage.perform", broken)
    (record,) = judge(judging, [0], workers=1)
    assert [take.failure for take in record.takes] == ["RuntimeError: of no kind that is known"] * 2


def test_more_workers_make_the_same_records(judging: Judging, tmp_path: Path) -> None:
    models = ModelFiles(
        fusion=own_models("fusion"), affine=own_models("affine"), cart=own_models("cart")
    )
    jobs = [
        partial(split.take_and_hear, spec, models, judging.observers)
        for spec in two_takes(judging, 0)
    ]
    assert list(run_jobs(jobs, workers=1)) == list(run_jobs(jobs, workers=2))


@pytest.fixture
def two_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at two robots for development: those for tests are not looked at to test the code."""
    chosen = replace(load_evaluation_baselines(), chosen_on="robots of a test")
    monkeypatch.setattr(
        "pepper_driver.evaluation.touch.look.load_evaluation_baselines", lambda: chosen
    )
    monkeypatch.setattr("pepper_driver.evaluation.touch.ledger.ROBOTS", 2)
    monkeypatch.setattr("pepper_driver.evaluation.touch.ledger.FIRST_DRAW", 40)


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
    assert line.figures.hours is not None
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
