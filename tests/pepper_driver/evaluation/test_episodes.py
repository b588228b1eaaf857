"""An episode is what really happened, can be had again, and is never one of a robot that fell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import make_backend
from pepper_driver.config import load_robot
from pepper_driver.config.contact_specs import PushSpec
from pepper_driver.config.evaluation import SuiteRun, load_evaluation
from pepper_driver.config.steps import Step
from pepper_driver.evaluation.episodes import (
    REDRAWN,
    Episode,
    EpisodeError,
    StoppedEpisodeError,
    episode_uri,
    perform,
)
from support.evaluation import at_once
from support.once import made_once

ROBOT = load_robot()
EVALUATION = load_evaluation(ROBOT)
LSROLL = EVALUATION.runs("paper")[1]
RUN = replace(LSROLL, experiment=at_once(LSROLL.experiment))
NOISE = {"LSRoll": 1018737313, "RERoll": 2304797149, "RSRoll": 909507401}
"""Seeds of the noise on boards with an integral part."""


@pytest.fixture(scope="module")
def episode() -> Episode:
    return perform(RUN)


@pytest.fixture
def cache(request: pytest.FixtureRequest) -> Path:
    """With the episode of RUN."""
    return made_once(request, "episodes", lambda folder: perform(RUN, folder))


def pushed_over() -> SuiteRun:
    """A push at the shoulders that no robot on wheels stands, asked for as one that it does."""
    push = PushSpec(
        kind="push",
        joint="HipPitch",
        link="torso",
        xyz=(0.0, 0.0, 0.2),
        force=(28.0, 0.0, 0.0),
        start=0.5,
        duration=2.4,
    )
    steps = (Step(posture="Stand", hold=3.0),)
    experiment = replace(RUN.experiment, steps=steps, contacts=(push,), max_tipping=1.0)
    return replace(RUN, experiment=experiment, plant="nominal")


def pushed_too_hard() -> SuiteRun:
    """The same push, of which it is known beforehand."""
    run = pushed_over()
    return replace(run, experiment=replace(run.experiment, max_tipping=0.5))


def same(one: Episode, other: Episode) -> bool:
    return (
        one.pushes == other.pushes
        and one.seed == other.seed
        and np.array_equal(one.contact_torque, other.contact_torque)
        and np.array_equal(one.recording.position, other.recording.position)
    )


def test_a_episode_says_what_really_acted(episode: Episode) -> None:
    assert (episode.suite, episode.experiment) == ("paper", "LSRoll")
    assert episode.plant == "swaying-integral"
    assert episode.task_stiffness == 8.0
    shape = episode.recording.position.shape
    assert shape == (550, 17)
    assert episode.contact_torque.shape == shape
    assert len(episode.pushes) == 2
    time, index = episode.recording.time, ROBOT.joint_index("LShoulderRoll")
    stiffness = make_backend(episode_uri(RUN), ROBOT).plant.stiffness[index]
    for push in episode.pushes:
        during = (time >= push.onset) & (time <= push.release)
        peak = np.abs(episode.contact_torque[during, index]).max()
        assert push.torque == pytest.approx(peak)
        assert push.degrees == pytest.approx(np.degrees(peak / stiffness))
        assert push.degrees == pytest.approx(np.clip(push.degrees, 2.3, 12.5))
        sign = np.sign(
            episode.contact_torque[during, index][
                np.argmax(np.abs(episode.contact_torque[during, index]))
            ]
        )
        assert push.direction == sign
    quiet = np.ones(len(time), dtype=bool)
    for push in episode.pushes:
        quiet &= (time < push.onset) | (time > push.release + ROBOT.cycle)
    assert not episode.contact_torque[quiet].any()


def test_one_run_one_episode(episode: Episode) -> None:
    assert same(episode, perform(RUN))
    other = perform(replace(RUN, seed=(*RUN.seed[:-1], RUN.seed[-1] + 1)))
    assert other.seed != episode.seed
    assert not same(episode, other)


def test_a_episode_comes_back_from_the_cache(
    episode: Episode, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pepper_driver.evaluation.episodes._performed", None)
    (folder,) = cache.iterdir()
    written = (folder / "recording.npz").stat().st_mtime_ns
    again = perform(RUN, cache)
    assert (folder / "recording.npz").stat().st_mtime_ns == written
    assert same(episode, again)
    assert (again.identity, again.plant, again.task_stiffness) == (
        episode.identity,
        episode.plant,
        8.0,
    )


@pytest.mark.parametrize("name", ["recording.npz", "truth.npz", "episode.json"])
def test_a_damaged_episode_is_performed_again(episode: Episode, cache: Path, name: str) -> None:
    (folder,) = cache.iterdir()
    (folder / name).write_bytes(b"{}")
    with pytest.raises(EpisodeError, match=r"no episode \(.+; delete the folder"):
        Episode.load(folder, ROBOT)
    assert same(episode, perform(RUN, cache))
    assert same(episode, Episode.load(folder, ROBOT))


def test_what_makes_a_episode_different_has_a_place_of_its_own(
    episode: Episode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pepper_driver.evaluation.episodes._performed", lambda *_: episode)
    runs = [
        RUN,
        LSROLL,
        replace(RUN, plant="swaying"),
        replace(RUN, entry="RSRoll"),
        replace(RUN, seed=(*RUN.seed[:-1], RUN.seed[-1] + 1)),
        replace(RUN, experiment=replace(RUN.experiment, stiffness=3.0)),
    ]
    for run in runs:
        perform(run, tmp_path)
    assert len(list(tmp_path.iterdir())) == len(runs)
    perform(replace(RUN, experiment=replace(RUN.experiment, source="elsewhere")), tmp_path)
    assert len(list(tmp_path.iterdir())) == len(runs)


def test_each_run_and_plant_has_noise_of_its_own() -> None:
    assert episode_uri(RUN).startswith("mujoco://?plant=swaying-integral&seed=")
    runs = [RUN, replace(RUN, plant="swaying"), replace(RUN, seed=(*RUN.seed[:-1], 1))]
    assert len({episode_uri(run).split("seed=")[1] for run in runs}) == len(runs)


def test_the_noise_of_the_frozen_suites_is_what_it_was() -> None:
    """Results were quoted of it."""
    uris = {run.entry: episode_uri(run) for run in EVALUATION.runs("paper")[1::2]}
    assert uris == {
        name: f"mujoco://?plant=swaying-integral&seed={seed}" for name, seed in NOISE.items()
    }


def test_a_robot_that_falls_gives_no_episode() -> None:
    with pytest.raises(EpisodeError, match=r"paper, LSRoll on nominal .*: it tipped by \d+ deg"):
        perform(pushed_over())


def test_a_run_in_which_the_robot_fell_is_drawn_again(
    episode: Episode, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawn: list[int] = []

    def falls_twice(run: SuiteRun, _: object) -> Episode:
        drawn.append(run.seed[-1])
        if len(drawn) <= falls:
            raise StoppedEpisodeError("it tipped by 12 deg")
        return episode

    monkeypatch.setattr("pepper_driver.evaluation.episodes._performed", falls_twice)
    falls, number = 2, RUN.seed[-1]
    assert perform(RUN, tmp_path) is episode
    assert drawn == [number, number + REDRAWN, number + 2 * REDRAWN]
    falls = 9
    with pytest.raises(EpisodeError, match="tipped"):
        perform(replace(RUN, plant="cold"), tmp_path)
    assert len(drawn) == 6


def test_a_push_that_does_not_fit_gives_no_episode() -> None:
    with pytest.raises(EpisodeError, match="of what tips the robot over; at most 50%"):
        perform(pushed_too_hard())


def test_no_truth_is_in_the_recording(episode: Episode) -> None:
    for name in ("contact_torque", "pushes"):
        assert not hasattr(episode.recording, name)
    assert not hasattr(next(episode.recording.ticks()), "truth")
