"""Figures of hand-made episodes, against what one counts by hand."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from pepper_driver.evaluation.episode_score import EpisodeScore, score_episode, watch
from pepper_driver.evaluation.episodes import Episode
from pepper_driver.evaluation.metrics import (
    Metrics,
    fraction_interval,
    summarise,
    upper_bound,
    with_gap_closed,
)
from pepper_driver.observer import Contact
from support.evaluation import (
    CYCLE,
    INDEX,
    JOINT,
    JOINTS,
    ROBOT,
    STIFFNESS,
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


def figures(episode: Episode, contacts: Sequence[Contact] = (), **script: Any) -> Metrics:
    return summarise([scored(episode, contacts, **script)], ROBOT)


def test_recall_by_size_and_what_is_apart() -> None:
    pushes = [
        push(1.0, 1.0),
        push(3.0, 1.2),
        push(5.0, 1.5),
        push(7.0, 2.5),
        push(9.0, 3.0),
        push(11.0, 8.0),
        push(13.0, 0.1),
        push(15.0, 6.0, saturated=True),
        push(17.0, 6.0, joint="LHand"),
        push(19.0, float("nan")),
    ]
    felt = [contact(n, p.onset + 0.1) for n, p in enumerate(pushes) if n not in (1, 4, 6)]
    result = figures(make_episode(pushes, seconds=22.0), felt)
    assert result.recall == {"1-1.5": 0.5, "1.5-2": 1.0, "2-3": 1.0, "3-": 0.5}
    assert result.recall_overall == pytest.approx(5 / 7)
    assert (result.recall_axis, result.recall_saturated, result.recall_hands) == (0.0, 1.0, 1.0)
    assert result.recall_count == {
        "1-1.5": 2,
        "1.5-2": 1,
        "2-3": 1,
        "3-": 2,
        "overall": 7,
        "saturated": 1,
        "axis": 1,
        "trunk": 0,
        "hands": 1,
    }
    assert (result.counts.fp, result.counts.fn, result.counts.tp) == (0, 3, 7)


def test_delay_counts_from_the_force_and_from_one_degree() -> None:
    pushes = [push(1.0), push(4.0), push(7.0, 2.9)]
    result = figures(make_episode(pushes), [contact(1, 1.12), contact(2, 4.24), contact(3, 7.9)])
    assert result.delay_ms is not None
    assert result.delay_ms.median == pytest.approx(180.0)
    assert result.delay_ms.p90 == pytest.approx(120.0 + 0.9 * 120.0)
    assert result.delay_ms.from_1deg is not None
    passes = np.arcsin(0.25) / np.pi  # 1 of 4 degrees, half a sine of a second
    assert result.delay_ms.from_1deg.median == pytest.approx(180.0 - 1e3 * passes, abs=1e3 * CYCLE)


def test_direction_is_that_of_the_joint_it_names() -> None:
    pushes = [push(1.0), push(4.0), push(7.0), push(10.0)]
    episode = make_episode(pushes, seconds=13.0)
    elbow = ROBOT.joint_index("LElbowRoll")
    episode.contact_torque[:, elbow] = -episode.contact_torque[:, INDEX]
    contacts = [
        contact(1, 1.1),
        contact(2, 4.1, direction=-1),
        contact(3, 7.1, joint="LElbowRoll", direction=-1),
        contact(4, 10.1, joint="LElbowYaw"),  # which nothing turns
    ]
    assert figures(episode, contacts).direction == pytest.approx(2 / 3)


def test_isolation_follows_the_updates() -> None:
    def moved(number: int, begin: float, after: float, joint: str | None) -> Contact:
        event = contact(number, begin, phase="update", joint=joint)
        return replace(event, time=begin + after)

    pushes = [push(t) for t in (1.0, 3.0, 5.0, 7.0)]
    contacts = [
        contact(1, 1.1),
        contact(2, 3.1, joint="LElbowRoll"),
        moved(2, 3.1, 0.06, JOINT),  # the first tick that is 50 ms late
        contact(3, 5.1, joint="LElbowRoll"),
        moved(3, 5.1, 0.1, JOINT),
        contact(4, 7.1),
        moved(4, 7.1, 0.5, "LElbowRoll"),
    ]
    assert figures(make_episode(pushes), contacts).isolation == {"0": 0.5, "50": 0.75, "150": 1.0}
    small = make_episode([push(1.0, 1.9)])
    assert figures(small, contacts[:1]).isolation == {"0": None, "50": None, "150": None}


def test_the_trunk_is_isolated_as_the_trunk() -> None:
    episode = make_episode(
        [push(1.0, joint=None, link="torso"), push(4.0, joint=None, link="torso")]
    )
    contacts = [contact(1, 1.1, joint=None), contact(2, 4.1, joint="HipRoll")]
    result = figures(episode, contacts)
    assert result.isolation["0"] == 1.0
    assert (result.recall["3-"], result.recall_trunk) == (None, 1.0)
    assert result.direction is None


def test_swinging_back_and_being_touched() -> None:
    pushes = [push(1.0), push(5.0)]
    contacts = [
        contact(1, 1.1),
        contact(2, 2.2, kind="rebound"),
        contact(3, 2.6),
        contact(4, 5.1, kind="rebound"),
        contact(5, 5.3),
        contact(6, 6.05),  # so soon after the release it would be felt, but the push was already
    ]
    rebound = figures(make_episode(pushes), contacts).rebound
    assert rebound is not None
    assert (rebound.swings, rebound.touches) == (3, 3)
    assert rebound.recall == pytest.approx(1 / 3)
    assert rebound.mislabelled == pytest.approx(1 / 3)


def test_a_late_contact_that_is_felt_is_no_swing() -> None:
    assert figures(make_episode([push(1.0)]), [contact(1, 2.1)]).rebound is None


def test_torque_within_pushes() -> None:
    episode = make_episode([push(1.0), push(4.0, 6.0, saturated=True)])
    off = np.radians(0.5) * STIFFNESS
    result = figures(episode, torque=episode.contact_torque + off).torque
    assert result is not None
    assert result.rmse_over_k_deg == pytest.approx(0.5)
    truth = np.degrees(episode.contact_torque[:, INDEX] / STIFFNESS)
    inside = truth[(episode.recording.time >= 1.0) & (episode.recording.time <= 2.0)]
    assert result.r2 == pytest.approx(1.0 - 0.25 / inside.var())
    assert result.estimated == 1.0
    half = episode.contact_torque.copy()
    half[: len(half) // 8] = np.nan  # until 1.5 s
    partly = figures(episode, torque=half).torque
    assert partly is not None
    assert partly.rmse_over_k_deg == 0.0
    assert partly.estimated == pytest.approx(0.5, abs=0.02)
    assert figures(episode).torque is None


@pytest.mark.parametrize(
    ("count", "hours", "bound"), [(0, 3.0, 0.99858), (0, 1.0, 2.9957), (2, 1.0, 6.2958)]
)
def test_poisson_bound(count: int, hours: float, bound: float) -> None:
    assert upper_bound(count, hours) == pytest.approx(bound, abs=1e-4)


@pytest.mark.parametrize(
    ("detected", "count"), [(0, 1), (0, 60), (1, 2), (93, 94), (247, 301), (7, 7)]
)
def test_interval_of_a_fraction(detected: int, count: int) -> None:
    expected = binomtest(detected, count).proportion_ci(0.95, method="exact")
    low, high = fraction_interval(detected, count)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-9)
    assert 0.0 <= low <= detected / count <= high <= 1.0


def test_free_motion_and_pushes_are_counted_apart() -> None:
    scores = [
        scored(make_episode(seconds=12.0), [contact(1, 3.0), contact(2, 9.0)]),
        scored(make_episode(seconds=24.0)),
        scored(make_episode([push(1.0)]), [contact(1, 1.1), contact(2, 5.0)]),
    ]
    result = summarise(scores, ROBOT)
    assert result.free_motion is not None
    assert result.with_pushes is not None
    assert result.free_motion.hours == pytest.approx(36.0 / 3600.0)
    assert (result.free_motion.fp, result.with_pushes.fp) == (2, 1)
    assert result.free_motion.fp_per_hour_upper95 == pytest.approx(629.58, abs=0.01)


def test_table1_by_experiment() -> None:
    scores = [
        scored(
            make_episode([push(1.0), push(4.0)], suite="paper", experiment="LSRoll"),
            [contact(1, 1.1)],
        ),
        scored(make_episode([push(1.0)], suite="paper", experiment="LSRoll"), [contact(1, 1.1)]),
        scored(make_episode([push(1.0)], suite="paper", experiment="RERoll"), [contact(1, 8.0)]),
        scored(make_episode([push(1.0)], suite="collision"), [contact(1, 8.0)]),
    ]
    table = {name: (c.fp, c.fn, c.tp) for name, c in summarise(scores, ROBOT).table1.items()}
    assert table == {"LSRoll": (0, 1, 2), "RERoll": (1, 1, 0), "total": (1, 2, 2)}


def test_fit_by_joint_and_speed_and_the_gap() -> None:
    n = round(12.0 / CYCLE)
    error = 0.05 * np.sin(np.arange(n) * 0.1)

    def score(share: float, stiffness: float) -> EpisodeScore:
        episode = make_episode(suite="fit", experiment=JOINT, task_stiffness=stiffness, error=error)
        expected = np.zeros((n, JOINTS))
        expected[:, INDEX] = error.mean() + share * (error - error.mean())
        return scored(episode, expected=expected)

    def result(*shares: float) -> Metrics:
        return summarise([score(s, k) for s, k in zip(shares, (2.0, 5.0, 9.0), strict=True)], ROBOT)

    fit = result(0.7, 0.8, 0.6).fit
    assert list(fit) == [JOINT]
    assert fit[JOINT].estimation == pytest.approx(75.0)
    assert fit[JOINT].test == pytest.approx(60.0)
    ours, affine, oracle = (result(0.5, 0.5, share) for share in (0.85, 0.7, 0.9))
    assert with_gap_closed(ours, affine, oracle).fit_gap_closed == {JOINT: pytest.approx(0.75)}
    assert with_gap_closed(ours, None, oracle).fit_gap_closed == {}
    assert with_gap_closed(ours, oracle, affine).fit_gap_closed == {}


def test_thresholds_leave_out_pushes_hands_and_blind_joints() -> None:
    threshold = np.full(JOINTS, np.radians(2.0))
    threshold[ROBOT.joint_index("LHand")] = 1.0
    threshold[ROBOT.joint_index("HeadYaw")] = np.nan
    episode = make_episode([push(1.0)])
    by_tick = np.tile(threshold, (len(episode.recording), 1))
    by_tick[(episode.recording.time >= 1.0) & (episode.recording.time <= 2.8)] *= 10.0
    result = figures(episode, threshold=by_tick)
    assert result.threshold_deg is not None
    assert result.threshold_deg.p05 == result.threshold_deg.p95 == pytest.approx(2.0)
    assert "LHand" not in result.threshold_nm
    assert "HeadYaw" not in result.threshold_nm
    assert result.threshold_nm[JOINT] == pytest.approx(np.radians(2.0) * STIFFNESS)
    assert (result.coverage.joints, result.coverage.fraction) == (JOINTS - 1, 1.0)


def test_an_observer_that_sees_nothing_has_no_figures() -> None:
    result = figures(make_episode(), threshold=np.nan)
    assert result.threshold_deg is None
    assert result.threshold_nm == {}
    assert (result.coverage.joints, result.coverage.fraction) == (0, None)
