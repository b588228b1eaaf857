"""Random goals, drawn before the robot moves, and the postures that steps lead to."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import Experiment, load_experiment
from pepper_driver.config.steps import BaseMotion, Holds, RandomStep, Setpoints, Sweeps
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.experiments.segments import Segment, goal_posture
from pepper_driver.identification import sweeps_of
from support.examples import examples
from support.experiments import CYCLE, ROBOT, make_experiment
from support.pushes import PUSHED_ARMS

FREE = replace(PUSHED_ARMS, contacts=())
IDENTIFY = load_experiment("identify", ROBOT).with_goals(
    joints=("LShoulderRoll", "RElbowRoll"), ranges={}
)
SWEEPS = sweeps_of(IDENTIFY)


def setpoints_of(experiment: Experiment) -> Setpoints:
    step = experiment.random_step
    assert step is not None
    assert isinstance(step.goals, Setpoints)
    return step.goals


GOALS = setpoints_of(FREE)


def drawn(experiment: Experiment, seed: int = 0) -> list[Segment]:
    return plan_experiment(experiment, ROBOT, MockBackend(ROBOT), seed=seed).segments


def planned(*steps: dict[str, Any], **more: Any) -> list[Segment]:
    return drawn(make_experiment(*steps, **more))


def test_it_begins_in_the_posture_with_the_stiffness() -> None:
    first = drawn(FREE.with_goals(settle=1.2, posture="StandZero"))[0]
    assert first.is_settling
    assert first.ticks == 100
    assert first.stiffness == FREE.stiffness
    np.testing.assert_array_equal(first.posture, ROBOT.posture("StandZero"))


@examples(30)
@given(
    seed=st.integers(0, 2**32), fraction=st.floats(0, 1), also=st.floats(0, 1), n=st.integers(1, 6)
)
def test_setpoints_lie_in_their_fraction_of_the_range(
    seed: int, fraction: float, also: float, n: int
) -> None:
    goals = drawn(FREE.with_goals(range=fraction, secondary_range=also, count=n), seed)[1:]
    assert len(goals) == n
    for segment in goals:
        assert not segment.is_settling
        assert segment.is_random
        assert segment.step.duration is None
        assert segment.ticks == round(GOALS.period / CYCLE)
        assert list(segment.step.joints) == [*GOALS.joints, *GOALS.secondary_joints]
        for name, angle in segment.step.joints.items():
            limits = ROBOT.joints[ROBOT.joint_index(name)]
            part = fraction if name in GOALS.joints else also
            half = (limits.upper - limits.lower) / 2
            assert abs(angle - (limits.lower + limits.upper) / 2) <= part * half + 1e-12


def test_goals_differ_and_follow_the_seed() -> None:
    first, again, other = ([segment.step for segment in drawn(FREE, seed)] for seed in (1, 1, 2))
    assert first == again
    assert [step.joints for step in first[1:]] != [step.joints for step in other[1:]]
    assert len({step.joints["RElbowRoll"] for step in first[1:]}) == 6
    assert [segment.step for segment in drawn(FREE.with_goals(count=3), 1)] == first[:4]
    assert [s.step for s in drawn(replace(FREE, seed=1))] != first, "the caller's seed goes before"
    plan = plan_experiment(replace(FREE, seed=1), ROBOT, MockBackend(ROBOT))
    assert [segment.step for segment in plan.segments] == first


def test_holds_have_a_way_and_a_stay() -> None:
    goals = Holds(joints=("HeadYaw",), range=0.5, move=2.4, hold=1.2, count=5)
    _, *segments = drawn(replace(FREE, steps=(RandomStep(holds=goals),)))
    assert [(s.ticks, s.step.duration) for s in segments] == [(300, 2.4)] * 5


@pytest.mark.parametrize("seed", range(5))
def test_sweeps_play_one_sequence_twice_with_other_neighbours(seed: int) -> None:
    settling, *sequence = drawn(IDENTIFY, seed)
    half = 2 * SWEEPS.sweeps + SWEEPS.setpoints
    second_joint = next(i for i, segment in enumerate(sequence) if segment.is_settling)
    assert second_joint == 2 * half
    assert settling.step.posture == SWEEPS.posture
    neighbours = ("LShoulderPitch", "LElbowYaw")
    assert tuple(settling.step.joints) == neighbours
    once, again = sequence[:half], sequence[half : 2 * half]
    limits = ROBOT.joints[ROBOT.joint_index("LShoulderRoll")]
    span = limits.upper - limits.lower
    for number, (a, b) in enumerate(zip(once, again, strict=True)):
        assert a.step.joints["LShoulderRoll"] == b.step.joints["LShoulderRoll"]
        assert a.ticks == b.ticks
        assert SWEEPS.dwell[0] <= a.ticks * CYCLE + 0.006
        assert a.ticks * CYCLE - 0.006 <= SWEEPS.dwell[1]
        assert list(a.step.joints) == ["LShoulderRoll"]
        assert len(b.step.joints) == (3 if number == 0 else 1)
        if number < 2 * SWEEPS.sweeps:
            near = limits.lower if number % 2 == 0 else limits.upper
            assert abs(a.step.joints["LShoulderRoll"] - near) <= SWEEPS.max_offset * span
    for name in neighbours:
        assert again[0].step.joints[name] != settling.step.joints[name]
        other = ROBOT.joints[ROBOT.joint_index(name)]
        reach = SWEEPS.neighbour_range * (other.upper - other.lower) / 2
        assert abs(again[0].step.joints[name] - (other.upper + other.lower) / 2) <= reach


def test_sweeps_may_have_ranges_of_their_own() -> None:
    """A fraction of the distance from the first posture to either limit."""
    assert isinstance(SWEEPS, Sweeps)
    segments = drawn(IDENTIFY.with_goals(joints=("HipRoll",), ranges={"HipRoll": 0.25}))
    limits, start = ROBOT.joints[ROBOT.joint_index("HipRoll")], ROBOT.posture("Stand")
    start_angle = start[ROBOT.joint_index("HipRoll")]
    lower = start_angle - 0.25 * (start_angle - limits.lower)
    upper = start_angle + 0.25 * (limits.upper - start_angle)
    angles = [s.step.joints["HipRoll"] for s in segments if not s.is_settling]
    assert min(angles) >= lower
    assert max(angles) <= upper
    assert max(angles) - min(angles) > 0.5 * (upper - lower)


def test_single_joints_may_have_a_range_of_their_own() -> None:
    goals = drawn(FREE.with_goals(range=1.0, ranges={"LShoulderRoll": 0.01}, count=40))[1:]
    for name, least, most in (("LShoulderRoll", 0.0, 0.01), ("RElbowRoll", 0.8, 1.0)):
        limits = ROBOT.joints[ROBOT.joint_index(name)]
        middle, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
        farthest = max(abs(segment.step.joints[name] - middle) for segment in goals) / half
        assert least <= farthest <= most


BASE = BaseMotion(linear=0.2, angular=0.5, share=0.6)


def test_the_base_moves_with_its_fraction_of_the_goals() -> None:
    specs = [segment.step.base_velocity for segment in drawn(FREE.with_goals(base=BASE, count=300))]
    twists = np.array([[spec.vx, spec.vy, spec.wz] for spec in specs if spec is not None])
    assert len(twists) == 300
    moving = twists.any(axis=1)
    assert 0.5 < moving.mean() < 0.7
    speed, turn = np.hypot(twists[moving, 0], twists[moving, 1]), twists[moving, 2]
    assert speed.max() <= 0.2
    assert speed.max() > 0.18
    assert np.abs(turn).max() <= 0.5
    assert turn.min() < -0.4
    assert len({(vx > 0, vy > 0) for vx, vy, _ in twists[moving]}) == 4
    assert all(segment.step.base_velocity is None for segment in drawn(FREE))


def test_a_base_that_moves_does_not_change_the_goals_before() -> None:
    with_base = drawn(FREE.with_goals(base=BASE))
    assert with_base[1].step.joints == drawn(FREE)[1].step.joints


# -- postures and times -----------------------------------------------------------------------------------------------


def test_each_step_begins_when_the_one_before_is_over_at_the_latest() -> None:
    first, wait, second = planned(
        {"posture": "StandZero", "duration": 1.2},
        {"wait": {"timeout": 2.4}},
        {
            "joints": {"HeadYaw": 0.3},
            "until": "reached",
            "timeout": 3.6,
            "hold": 0.6,
            "stiffness": 2.0,
        },
    )
    assert [segment.start for segment in (first, wait, second)] == pytest.approx([0.0, 1.2, 3.6])
    assert [segment.ticks for segment in (first, wait, second)] == [100, 200, 350]
    assert [segment.is_timed for segment in (first, wait, second)] == [True, True, False]
    assert [segment.stiffness for segment in (first, wait, second)] == [5.0, 5.0, 2.0]
    np.testing.assert_array_equal(first.posture, ROBOT.posture("StandZero"))
    expected = ROBOT.posture("StandZero")
    expected[ROBOT.joint_index("HeadYaw")] = 0.3
    np.testing.assert_array_equal(second.posture, expected)
    np.testing.assert_array_equal(second.origin, first.posture)


def test_joints_of_which_nothing_was_said_are_not_known() -> None:
    (segment,) = planned({"joints": {"HeadYaw": 0.3}, "hands": {"LHand": 0.5}, "hold": 1.0})
    known = np.flatnonzero(np.isfinite(segment.posture))
    assert [ROBOT.joint_names[index] for index in known] == ["HeadYaw", "LHand"]


def test_a_joint_moves_until_its_spring_has_come_to_rest() -> None:
    """Six time constants of the posture task after its spline, joint by joint."""
    _, turn, later = planned(
        {"posture": "Stand", "hold": 1.2},
        {"joints": {"HeadYaw": 0.3}, "duration": 0.6},
        {"hold": 6.0},
        stiffness=4.0,
    )
    over = 0.6 + 6.0 / 2.0
    assert turn.moves("HeadYaw", over - 0.02, ROBOT)
    assert not turn.moves("HeadYaw", over + 0.02, ROBOT)
    assert later.moves("HeadYaw", over - 0.6 - 0.02, ROBOT)
    assert not later.moves("HeadYaw", over - 0.6 + 0.02, ROBOT)
    assert not turn.moves("LElbowRoll", 0.1, ROBOT)
    assert turn.moves(None, 0.1, ROBOT)


def test_a_step_names_joints_of_its_posture_again() -> None:
    before = ROBOT.posture("Stand")
    (segment,) = planned(
        {"posture": "StandZero", "joints": {"HeadYaw": 0.3}, "hands": {"LHand": 0.9}, "hold": 1.0}
    )
    posture = goal_posture(segment.step, before, ROBOT)
    expected = ROBOT.posture("StandZero")
    expected[[ROBOT.joint_index("HeadYaw"), ROBOT.joint_index("LHand")]] = 0.3, 0.9
    np.testing.assert_array_equal(posture, expected)
    np.testing.assert_array_equal(before, ROBOT.posture("Stand"))
