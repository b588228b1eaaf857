"""The motion of a scenario, before anybody moves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pepper_driver.config import Scenario, load_robot, load_scenario
from pepper_driver.config.scenario_motion import BaseMotion, Holds, Script, Setpoints, Step, Sweeps
from pepper_driver.timeline import Leg, legs

ROBOT = load_robot()
DEMO = load_scenario("demo", ROBOT)
IDENTIFY = load_scenario("identify", ROBOT)
assert isinstance(IDENTIFY.motion, Sweeps)
IDENTIFY = replace(
    IDENTIFY,
    posture=None,
    motion=replace(IDENTIFY.motion, joints=("LShoulderRoll", "RElbowRoll"), ranges={}),
)
FREE = replace(DEMO, contacts=())


def drawn(scenario: Scenario, seed: int = 0, count: int | None = None) -> list[Leg]:
    return list(legs(scenario, ROBOT, np.random.default_rng(seed), count=count))


def test_it_begins_in_the_posture_with_the_stiffness() -> None:
    first = drawn(replace(FREE, settle=1.2, posture="Crouch"))[0]
    assert first.settling
    assert first.ticks == 100
    assert first.stiffness == DEMO.stiffness
    np.testing.assert_array_equal(list(first.joints.values()), ROBOT.posture("Crouch"))
    assert tuple(first.joints) == ROBOT.joint_names


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), share=st.floats(0, 1), also=st.floats(0, 1), n=st.integers(1, 6))
def test_setpoints_lie_in_their_share_of_the_range(
    seed: int, share: float, also: float, n: int
) -> None:
    motion = DEMO.motion
    assert isinstance(motion, Setpoints)
    scenario = replace(FREE, motion=replace(motion, range=share, also_range=also, count=n))
    goals = drawn(scenario, seed)[1:]
    assert len(goals) == n
    for leg in goals:
        assert not leg.settling
        assert leg.move == 0
        assert leg.ticks == round(motion.period / ROBOT.cycle)
        assert list(leg.joints) == [*motion.joints, *motion.also_move]
        for name, angle in leg.joints.items():
            limits = ROBOT.joints[ROBOT.joint_index(name)]
            part = share if name in motion.joints else also
            half = (limits.upper - limits.lower) / 2
            assert abs(angle - (limits.lower + limits.upper) / 2) <= part * half + 1e-12


def test_goals_differ_and_follow_the_seed() -> None:
    first, again, other = drawn(FREE, 1), drawn(FREE, 1), drawn(FREE, 2)
    assert first == again
    assert [leg.joints for leg in first[1:]] != [leg.joints for leg in other[1:]]
    assert len({leg.joints["RElbowRoll"] for leg in first[1:]}) == 6
    assert drawn(FREE, 1, count=3) == first[:4]


def test_holds_have_a_way_and_a_stay() -> None:
    motion = Holds(kind="holds", joints=("HeadYaw",), range=0.5, move=2.4, hold=1.2, count=5)
    _, *goals = drawn(replace(FREE, motion=motion))
    assert [(leg.ticks, leg.move) for leg in goals] == [(300, 200)] * 5


def test_a_script_holds_each_step_until_the_next() -> None:
    steps = (
        Step(time=1.2, joints={"HeadYaw": 0.3}),
        Step(time=3.6, posture="Crouch", stiffness=2.0),
    )
    motion = Script(kind="script", steps=steps, length=6.0)
    settling, wait, first, second = drawn(replace(FREE, motion=motion))
    assert [leg.ticks for leg in (settling, wait, first, second)] == [0, 100, 200, 200]
    assert (wait.joints, first.joints) == ({}, {"HeadYaw": 0.3})
    assert (first.stiffness, second.stiffness) == (None, 2.0)
    np.testing.assert_array_equal(list(second.joints.values()), ROBOT.posture("Crouch"))


@pytest.mark.parametrize("seed", range(5))
def test_sweeps_play_one_sequence_twice_with_other_neighbours(seed: int) -> None:
    settling, *sequence = drawn(IDENTIFY, seed)
    motion = IDENTIFY.motion
    assert isinstance(motion, Sweeps)
    half = 2 * motion.sweeps + motion.setpoints
    second_joint = next(i for i, leg in enumerate(sequence) if leg.settling)
    assert second_joint == 2 * half
    assert "LShoulderRoll" not in settling.joints
    neighbours = ("LShoulderPitch", "LElbowYaw")
    assert tuple(settling.joints) == neighbours
    once, again = sequence[:half], sequence[half : 2 * half]
    limits = ROBOT.joints[ROBOT.joint_index("LShoulderRoll")]
    span = limits.upper - limits.lower
    for number, (a, b) in enumerate(zip(once, again, strict=True)):
        assert a.joints["LShoulderRoll"] == b.joints["LShoulderRoll"]
        assert a.ticks == b.ticks
        assert motion.dwell[0] <= a.ticks * ROBOT.cycle + 0.006
        assert a.ticks * ROBOT.cycle - 0.006 <= motion.dwell[1]
        assert list(a.joints) == ["LShoulderRoll"]
        assert len(b.joints) == (3 if number == 0 else 1)
        if number < 2 * motion.sweeps:
            near = limits.lower if number % 2 == 0 else limits.upper
            assert abs(a.joints["LShoulderRoll"] - near) <= motion.largest_offset * span
    for name in neighbours:
        assert again[0].joints[name] != settling.joints[name]
        other = ROBOT.joints[ROBOT.joint_index(name)]
        reach = motion.neighbour_range * (other.upper - other.lower) / 2
        assert abs(again[0].joints[name] - (other.upper + other.lower) / 2) <= reach


def test_single_joints_may_have_a_range_of_their_own() -> None:
    motion = DEMO.motion
    assert isinstance(motion, Setpoints)
    small = replace(motion, range=1.0, ranges={"LShoulderRoll": 0.01}, count=40)
    goals = drawn(replace(FREE, motion=small))[1:]
    for name, least, most in (("LShoulderRoll", 0.0, 0.01), ("RElbowRoll", 0.8, 1.0)):
        limits = ROBOT.joints[ROBOT.joint_index(name)]
        middle, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
        farthest = max(abs(leg.joints[name] - middle) for leg in goals) / half
        assert least <= farthest <= most


def test_the_base_moves_with_its_share_of_the_goals() -> None:
    motion = DEMO.motion
    assert isinstance(motion, Setpoints)
    base = BaseMotion(linear=0.2, angular=0.5, share=0.6)
    legs = drawn(replace(FREE, motion=replace(motion, base=base, count=300)))[1:]
    twists = np.array([leg.twist for leg in legs])
    moving = twists.any(axis=1)
    assert 0.5 < moving.mean() < 0.7
    speed, turn = np.hypot(twists[moving, 0], twists[moving, 1]), twists[moving, 2]
    assert speed.max() <= 0.2
    assert speed.max() > 0.18
    assert np.abs(turn).max() <= 0.5
    assert turn.min() < -0.4
    assert len({(vx > 0, vy > 0) for vx, vy, _ in twists[moving]}) == 4
    assert all(leg.twist is None for leg in drawn(FREE))


def test_a_base_that_moves_does_not_change_the_goals_before() -> None:
    motion = DEMO.motion
    assert isinstance(motion, Setpoints)
    base = BaseMotion(linear=0.2, angular=0.5, share=0.6)
    with_base = drawn(replace(FREE, motion=replace(motion, base=base)))
    assert with_base[1].joints == drawn(FREE)[1].joints
