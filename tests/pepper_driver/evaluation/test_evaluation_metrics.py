"""Results of hand-made episodes, against what one counts by hand."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from pepper_driver.evaluation.episode_score import EpisodeScore, score_episode, watch
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.evaluation.metrics import Metrics, summarise, with_gap_closed
from pepper_driver.observer import Contact
from support.evaluation import (
    CYCLE,
    INDEX,
    JOINT,
    JOINTS,
    ROBOT,
    Script,
    contact,
    make_episode,
    push,
)


def scored(episode: Episode, contacts: Sequence[Contact] = (), **script: Any) -> EpisodeScore:
    joint = episode.experiment if episode.experiment in ROBOT.joint_names else None
    return score_episode(
        episode, watch(Script(contacts, **script), episode.recording, joint), ROBOT
    )


def test_an_episode_is_counted() -> None:
    pushes = [push(1.0), push(4.0), push(7.0, joint=None, link="torso")]
    contacts = [
        contact(1, 1.1),
        contact(2, 2.3),  # the joint swings back
        contact(3, 4.1, joint="HeadYaw"),  # another limb
        contact(4, 7.1, joint="HipRoll"),
        contact(5, 10.0),
    ]
    score = scored(make_episode(pushes), contacts)
    assert (score.false, score.missed, score.detected) == (2, 1, 2)
    assert score.fit == {}


def test_table1_by_experiment() -> None:
    scores = [
        scored(
            make_episode([push(1.0), push(4.0)], suite="paper", experiment="LSRoll"),
            [contact(1, 1.1)],
        ),
        scored(make_episode([push(1.0)], suite="paper", experiment="LSRoll"), [contact(1, 1.1)]),
        scored(make_episode([push(1.0)], suite="paper", experiment="RERoll"), [contact(1, 8.0)]),
        scored(make_episode([push(1.0)], suite="fit"), [contact(1, 8.0)]),
    ]
    table = {name: (c.fp, c.fn, c.tp) for name, c in summarise(scores).table1.items()}
    assert table == {"LSRoll": (0, 1, 2), "RERoll": (1, 1, 0), "total": (1, 2, 2)}


def test_fit_by_joint_and_speed_and_the_gap() -> None:
    n = round(12.0 / CYCLE)
    error = 0.05 * np.sin(np.arange(n) * 0.1)

    def score(fraction: float, stiffness: float) -> EpisodeScore:
        episode = make_episode(suite="fit", experiment=JOINT, task_stiffness=stiffness, error=error)
        expected = np.zeros((n, JOINTS))
        expected[:, INDEX] = error.mean() + fraction * (error - error.mean())
        return scored(episode, expected=expected)

    def result(*fractions: float) -> Metrics:
        return summarise([score(s, k) for s, k in zip(fractions, (2.0, 5.0, 9.0), strict=True)])

    fit = result(0.7, 0.8, 0.6).fit
    assert list(fit) == [JOINT]
    assert fit[JOINT].estimation == pytest.approx(75.0)
    assert fit[JOINT].test == pytest.approx(60.0)
    ours, affine, oracle = (result(0.5, 0.5, fraction) for fraction in (0.85, 0.7, 0.9))
    assert with_gap_closed(ours, affine, oracle).fit_gap_closed == {JOINT: pytest.approx(0.75)}
    assert with_gap_closed(ours, None, oracle).fit_gap_closed == {}
    assert with_gap_closed(ours, oracle, affine).fit_gap_closed == {}
