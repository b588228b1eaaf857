"""Robots of a split: judged once, kept, and the same on any number of workers."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import pepper_driver.evaluation.touch.split as split
from pepper_driver.config.population import HeldOutDrawError
from pepper_driver.config.workers import run_jobs
from pepper_driver.evaluation.touch.observers import ModelFiles, make
from pepper_driver.evaluation.touch.records import RecordError, load_robot_record
from pepper_driver.evaluation.touch.split import Judging, judge
from pepper_driver.evaluation.touch.takes import TakeSpec, perform
from pepper_driver.identification import IdentifiedRobot
from pepper_driver.identification.measurements.program import held_weight
from support.touch_robots import FAILS, identified, own_models, short_judging, two_takes


@pytest.fixture
def judging(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Judging:
    return short_judging(tmp_path, monkeypatch)


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
        assert not any(observed.failure for observed in take.hearings.values())
    assert load_robot_record(judging.records / "random-0.json.gz") == record
    # A second call takes what is there.
    monkeypatch.setattr(split, "identify_population", None)
    monkeypatch.setattr(split, "perform", None)
    assert judge(judging, [0], workers=1) == (record,)


def test_robots_are_identified_with_a_weight(
    judging: Judging, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights: list[object] = []

    def weighed(*arguments: Any, **options: Any) -> tuple[IdentifiedRobot, ...]:
        weights.append(options["weight"])
        return identified(*arguments, **options)

    monkeypatch.setattr(split, "identify_population", weighed)
    judge(judging, [0], workers=1)
    assert weights == [held_weight(0.5, "left")]


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


def test_another_observer_is_judged_again(judging: Judging) -> None:
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
        partial(split.perform_and_observe, spec, models, judging.observers)
        for spec in two_takes(judging, 0)
    ]
    assert list(run_jobs(jobs, workers=1)) == list(run_jobs(jobs, workers=2))
