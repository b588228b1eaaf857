"""A take is what really happened, can be had again, and is never one of a robot that fell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.config import load_robot
from pepper_driver.config.contact_specs import PushSpec
from pepper_driver.config.evaluation import Run, load_evaluation
from pepper_driver.config.steps import Step
from pepper_driver.evaluation.takes import (
    REDRAWN,
    FailedTake,
    StoppedTakeError,
    Take,
    TakeError,
    perform,
    take_uri,
    takes,
)

ROBOT = load_robot()
EVALUATION = load_evaluation(ROBOT)
LSROLL = EVALUATION.runs("paper")[1]
# Pushed from the first goal on, for the tests' sake.
AT_ONCE = tuple(replace(c, after=0.0) for c in LSROLL.experiment.contacts)  # type: ignore[arg-type]
RUN = replace(LSROLL, goals=1, experiment=replace(LSROLL.experiment, contacts=AT_ONCE))
FREE = replace(EVALUATION.runs("free")[3], goals=1)


@pytest.fixture(scope="module")
def take() -> Take:
    return perform(RUN)


def pushed_over() -> Run:
    """A push at the shoulders that no robot on wheels stands, asked for as one that it does."""
    push = PushSpec(
        kind="push",
        joint="HipPitch",
        link="torso",
        xyz=(0.0, 0.0, 0.2),
        force=(28.0, 0.0, 0.0),
        start=2.5,
        duration=2.4,
    )
    steps = (Step(posture="Stand", hold=5.0),)
    experiment = replace(RUN.experiment, steps=steps, contacts=(push,), max_tipping=1.0)
    return replace(RUN, experiment=experiment, goals=None, plant="nominal")


def same(one: Take, other: Take) -> bool:
    return (
        one.pushes == other.pushes
        and one.seed == other.seed
        and all(
            np.array_equal(getattr(one, name), getattr(other, name))
            for name in ("contact_torque", "saturated", "stiffness_constant")
        )
        and np.array_equal(one.recording.position, other.recording.position)
    )


def test_a_take_says_what_really_acted(take: Take) -> None:
    assert (take.suite, take.experiment) == ("paper", "LSRoll")
    assert (take.plant, take.draw) == ("swaying-integral", None)
    assert take.task_stiffness == 8.0
    shape = take.recording.position.shape
    assert shape == (550, 17)
    assert take.contact_torque.shape == take.saturated.shape == shape
    assert len(take.pushes) == 2
    time, index = take.recording.time, ROBOT.joint_index("LShoulderRoll")
    for push in take.pushes:
        during = (time >= push.onset) & (time <= push.release)
        peak = np.abs(take.contact_torque[during, index]).max()
        assert push.torque == pytest.approx(peak)
        assert push.degrees == pytest.approx(np.degrees(peak / take.stiffness_constant[index]))
        assert push.degrees == pytest.approx(np.clip(push.degrees, 2.3, 12.5))
        sign = np.sign(
            take.contact_torque[during, index][
                np.argmax(np.abs(take.contact_torque[during, index]))
            ]
        )
        assert push.direction == sign
    quiet = np.ones(len(time), dtype=bool)
    for push in take.pushes:
        quiet &= (time < push.onset) | (time > push.release + ROBOT.cycle)
    assert not take.contact_torque[quiet].any()


def test_one_run_one_take(take: Take) -> None:
    assert same(take, perform(RUN))
    other = perform(replace(RUN, seed=(*RUN.seed[:-1], RUN.seed[-1] + 1)))
    assert other.seed != take.seed
    assert not same(take, other)


def test_a_take_comes_back_from_the_cache(take: Take, tmp_path: Path) -> None:
    first = perform(RUN, tmp_path)
    (folder,) = tmp_path.iterdir()
    written = (folder / "recording.npz").stat().st_mtime_ns
    again = perform(RUN, tmp_path)
    assert (folder / "recording.npz").stat().st_mtime_ns == written
    assert same(first, again)
    assert same(take, again)
    assert (again.identity, again.plant, again.task_stiffness) == (take.identity, take.plant, 8.0)


@pytest.mark.parametrize("name", ["recording.npz", "truth.npz", "take.json"])
def test_a_damaged_take_is_performed_again(take: Take, tmp_path: Path, name: str) -> None:
    perform(RUN, tmp_path)
    (folder,) = tmp_path.iterdir()
    (folder / name).write_bytes(b"{}")
    with pytest.raises(TakeError, match=r"no take \(.+; delete the folder"):
        Take.load(folder, ROBOT)
    assert same(take, perform(RUN, tmp_path))
    assert same(take, Take.load(folder, ROBOT))


def test_what_makes_a_take_different_has_a_place_of_its_own(tmp_path: Path) -> None:
    runs = [
        FREE,
        replace(FREE, draw=5),
        replace(FREE, goals=2),
        replace(FREE, experiment=replace(FREE.experiment, stiffness=3.0)),
    ]
    for run in runs:
        perform(run, tmp_path)
    assert len(list(tmp_path.iterdir())) == len(runs)
    perform(replace(FREE, experiment=replace(FREE.experiment, source="elsewhere")), tmp_path)
    assert len(list(tmp_path.iterdir())) == len(runs)


def test_plants_and_draws_are_in_the_uri() -> None:
    assert take_uri(FREE).startswith("mujoco://?plant=drift&seed=")
    assert take_uri(FREE).endswith(f"&draw={FREE.draw}")
    assert "draw" not in take_uri(RUN)
    noises = {take_uri(replace(FREE, draw=k)).split("seed=")[1].split("&")[0] for k in range(5)}
    assert len(noises) == 5


def test_a_robot_that_falls_gives_no_take() -> None:
    with pytest.raises(TakeError, match=r"paper, LSRoll on nominal .*: it tipped by \d+ deg"):
        perform(pushed_over())


def test_a_run_in_which_the_robot_fell_is_drawn_anew(
    take: Take, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawn: list[int] = []

    def falls_twice(run: Run, _: object) -> Take:
        drawn.append(run.seed[-1])
        if len(drawn) <= falls:
            raise StoppedTakeError("it tipped by 12 deg")
        return take

    monkeypatch.setattr("pepper_driver.evaluation.takes._performed", falls_twice)
    falls, number = 2, RUN.seed[-1]
    assert perform(RUN, tmp_path) is take
    assert drawn == [number, number + REDRAWN, number + 2 * REDRAWN]
    falls = 9
    with pytest.raises(TakeError, match="tipped"):
        perform(replace(RUN, plant="cold"), tmp_path)
    assert len(drawn) == 6


def test_a_push_that_does_not_fit_gives_no_take() -> None:
    run = pushed_over()
    run = replace(run, experiment=replace(run.experiment, max_tipping=0.5))
    with pytest.raises(TakeError, match="of what tips the robot over; at most 50%"):
        perform(run)


@pytest.mark.parametrize("workers", [1, 2])
def test_takes_come_in_their_order_whoever_performs_them(
    take: Take, tmp_path: Path, workers: int
) -> None:
    told: list[tuple[int, int]] = []
    runs = [pushed_over(), RUN, FREE]
    failed, pushed, free = takes(
        runs, workers=workers, cache=tmp_path, progress=lambda *done: told.append(done)
    )
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert isinstance(failed, FailedTake)
    assert failed.run == runs[0]
    assert "tipped" in failed.reason
    assert isinstance(pushed, Take)
    assert same(pushed, take)
    assert isinstance(free, Take)
    assert free.pushes == ()
    assert free.draw == FREE.draw
    assert not free.contact_torque.any()


def test_no_truth_is_in_the_recording(take: Take) -> None:
    for name in ("contact_torque", "saturated", "pushes", "stiffness_constant"):
        assert not hasattr(take.recording, name)
    assert not hasattr(next(take.recording.ticks()), "truth")
