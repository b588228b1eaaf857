"""Takes of the judge: what people do to the robot, what acts on it, and what states the robot is in."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.config import UnknownNameError, load_robot
from pepper_driver.config.population import HeldOutDrawError
from pepper_driver.config.touch_suites import EVEN, Act, PlannedAct, TouchSuites, load_touch_suites
from pepper_driver.controller import RobotModel
from pepper_driver.controller.support_polygon import SupportPolygon
from pepper_driver.evaluation.touch.people import ACTS, Person
from pepper_driver.evaluation.touch.states import LOWERED_STIFFNESS, STANDING, STATES
from pepper_driver.evaluation.touch.takes import (
    HELD_BEFORE,
    OTHER_DAY,
    Performance,
    TakeSpec,
    perform,
    plan_takes,
)

ROBOT = load_robot()
SUITES = load_touch_suites(ROBOT)


def spec(
    *acts: PlannedAct, state: str = "standing", number: int = 0, seconds: float = 0.0
) -> TakeSpec:
    """Make a take of robot 0, one with stiff boards."""
    return TakeSpec(
        suite="touch" if acts else "free",
        population="random",
        draw=0,
        day=OTHER_DAY if number % 2 else None,
        state=state,
        number=number,
        seed=(7, number),
        acts=acts,
        seconds=seconds,
    )


def act_of(name: str, place: str | None = None) -> PlannedAct:
    """Return the first touch of a row, at a place."""
    return next(
        act
        for state in SUITES.all_states
        for draw in (0, 2)
        for act in SUITES.acts(state, draw)
        if act.row.name == name and place in (None, act.place)
    )


def even(place: str, force: float) -> PlannedAct:
    return replace(act_of(EVEN, place), force=force)


@pytest.fixture(scope="module")
def pepper() -> Iterator[Pepper]:
    with Pepper("mujoco", observer=None) as robot:
        robot.run(0.1)
        yield robot


def person(pepper: Pepper, suites: TouchSuites = SUITES) -> Person:
    return Person(pepper, suites, np.random.default_rng(1), lambda: 0)


# -- people -----------------------------------------------------------------------------------------------------------


def test_directions_are_even_over_the_outer_half_space_without_the_axis(pepper: Pepper) -> None:
    someone, act = person(pepper), even("forearm", 5.0)
    point = SUITES.places["forearm"].points[2]  # outward along y, the axis is x
    drawn = np.array([someone.direction(point, act) for _ in range(4000)])
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0)
    assert (drawn @ point.outward < 0.0).all()
    near = math.cos(math.radians(SUITES.along_axis))
    assert np.abs(drawn[:, 0]).max() <= near
    # Even on a sphere: each coordinate is evenly distributed. Here x is, between the two cones.
    assert np.mean(np.abs(drawn[:, 0]) < near / 2) == pytest.approx(0.5, abs=0.03)
    assert np.mean(drawn[:, 2]) == pytest.approx(0.0, abs=0.03)


def test_directions_along_the_axis_are_within_their_cone(pepper: Pepper) -> None:
    someone, act = person(pepper), act_of("along the axis", "hand")
    point = SUITES.places["hand"].points[0]
    drawn = np.array([someone.direction(point, act) for _ in range(1000)])
    near = math.cos(math.radians(SUITES.along_axis))
    assert (np.abs(drawn[:, 0]) > near).all()
    assert np.mean(drawn[:, 0] > 0.0) == pytest.approx(0.5, abs=0.06)
    # Even within the cone: the cosine is evenly distributed.
    assert np.mean(np.abs(drawn[:, 0])) == pytest.approx((1.0 + near) / 2, abs=0.005)


def test_a_force_that_would_tip_the_robot_is_lowered_to_the_bound(pepper: Pepper) -> None:
    someone = person(pepper)
    point = SUITES.places["head"].points[0]
    forward = np.array([-1.0, 0.0, 0.0])
    someone.push(even("head", 200.0), point, direction=forward, world=True)
    sent = pepper.backend._simulation.contacts.pushes._pending[-1]  # type: ignore[attr-defined]
    posture = np.asarray(pepper.position)
    pose = RobotModel(ROBOT).link_pose("Head", posture)
    where = pose[:3, :3] @ point.xyz + pose[:3, 3]
    ratio = SupportPolygon.from_robot(ROBOT).tipping_ratio(posture, where, sent.force)
    assert ratio == pytest.approx(SUITES.max_tipping, rel=1e-6)
    assert 5.0 < np.linalg.norm(sent.force) < 60.0
    pepper.run(1.5)


# -- what acted -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pushed() -> Performance:
    return perform(spec(even("forearm", 8.0), even("head", 3.0)), None)


def test_a_push_acts_as_it_was_asked_for(pushed: Performance) -> None:
    first, second = pushed.take.touches
    assert (first.place, first.asked, second.place) == ("forearm", 8.0, "head")
    assert first.force == pytest.approx(8.0, rel=1e-3)
    assert second.force == pytest.approx(3.0, rel=1e-3)
    assert first.rise == 0.1
    assert first.release - first.onset == pytest.approx(1.0, abs=2 * ROBOT.cycle)
    assert first.onset - pushed.take.start == pytest.approx(SUITES.lead, abs=3 * ROBOT.cycle)
    pause = second.onset - first.release
    assert SUITES.pause[0] - 0.05 < pause < SUITES.pause[1] + 0.05
    assert not first.moving
    assert pushed.take.failure == ""


def test_torques_and_the_friction_bound_are_those_of_the_jacobian(pushed: Performance) -> None:
    touch, recording = pushed.take.touches[0], pushed.recording
    assert recording is not None
    row = int(np.searchsorted(recording.time, touch.onset + 0.5))
    truth = pushed.true_torque[row]
    joints = [ROBOT.joint_index(name) for name in ROBOT.limbs[touch.limb]]
    for joint, name in zip(joints, ROBOT.limbs[touch.limb], strict=True):
        assert touch.torque[name] == pytest.approx(truth[joint], abs=0.05)
    with Pepper("mujoco://?plant=random&draw=0", observer=None) as robot:
        friction = robot.backend.plant.friction
    lever = np.abs(truth[joints]) / 8.0
    expected = (2.0 * friction[joints] / np.maximum(lever, 1e-9)).min()
    assert touch.friction_bound == pytest.approx(expected, rel=0.05)


def test_a_take_is_the_same_each_time(pushed: Performance) -> None:
    again = perform(spec(even("forearm", 8.0), even("head", 3.0)), None)
    assert again.take == pushed.take
    assert again.recording is not None
    assert pushed.recording is not None
    np.testing.assert_array_equal(again.recording.position, pushed.recording.position)


def test_a_touch_since_before_the_start_lasts_when_the_first_tick_comes() -> None:
    act = act_of("since before the start")
    take = perform(spec(act), None).take
    (touch,) = take.touches
    assert touch.standing_start
    assert touch.onset <= take.start
    assert touch.release - take.start == pytest.approx(act.row.duration - HELD_BEFORE, abs=0.05)


@pytest.mark.parametrize("kind", [act for act in get_args(Act) if act not in ("push", "before")])
def test_each_kind_of_touch_touches_the_robot(kind: Act) -> None:
    row = next(row for row in SUITES.rows if row.act == kind)
    act = act_of(row.name)
    states = SUITES.states if row.states == "all" else row.states
    state = next((s for s in states if s not in STANDING), states[0])
    take = perform(spec(act, state=state), None).take
    assert take.failure == ""
    counts = {"taps": 3, "hug": 3, "pair": 2, "both": 2, "table": 4}
    assert len(take.touches) == counts.get(kind, 1)
    for touch in take.touches:
        assert touch.row == row.name
        assert touch.force is not None
        assert touch.force > 0.5
        assert touch.release > touch.onset
    limbs = {touch.limb for touch in take.touches}
    assert len(limbs) == {"hug": 3, "both": 2, "table": 2}.get(kind, 1)


def test_every_act_of_the_suites_is_known() -> None:
    assert set(ACTS) == set(get_args(Act))


# -- states -----------------------------------------------------------------------------------------------------------


def span(done: Performance, after: float = 0.0) -> dict[str, float]:
    """Return the way that each joint was sent over, from ``after`` [s] on."""
    assert done.recording is not None
    rows = done.recording.time >= done.recording.time[0] + after
    ways = np.ptp(done.recording.sent_position[rows], axis=0)
    return dict(zip(ROBOT.joint_names, ways.tolist(), strict=True))


@pytest.mark.parametrize("state", ["standing", "after-motion", "reflexes", "lowered"])
def test_a_robot_that_stands_is_sent_nowhere(state: str) -> None:
    after = STATES[state].lead + 1.0
    done = perform(spec(state=state, seconds=6.0), None)
    assert max(span(done, after).values()) < 0.01
    if state == "after-motion":
        assert max(span(done).values()) > 0.3
    else:
        assert max(span(done).values()) < 0.01


@pytest.mark.parametrize(
    ("state", "joint", "low", "high"),
    [
        ("attentive", "LShoulderPitch", 0.01, 0.2),
        ("breathing", "LShoulderPitch", 0.04, 0.1),
        ("breathing", "HipPitch", 0.01, 0.05),
        ("gesturing", "RElbowRoll", 0.2, 1.3),
        ("whole-body", "HeadYaw", 0.2, 4.0),
        ("cartesian", "LElbowRoll", 0.05, 2.0),
    ],
)
def test_states_move_the_robot(state: str, joint: str, low: float, high: float) -> None:
    assert low < span(perform(spec(state=state, seconds=8.0), None))[joint] < high


def test_a_robot_that_drives_turns_its_wheels() -> None:
    done = perform(spec(state="driving", seconds=8.0), None)
    assert done.recording is not None
    assert np.abs(done.recording.sent_wheel_speed).max() > 0.5


def test_lowered_motors_are_less_stiff() -> None:
    done = perform(spec(state="lowered", seconds=4.0), None)
    assert done.recording is not None
    last = dict(zip(ROBOT.joint_names, done.recording.stiffness[-1].tolist(), strict=True))
    assert last["LElbowRoll"] == last["HeadYaw"] == pytest.approx(LOWERED_STIFFNESS)
    assert last["KneePitch"] == 1.0


# -- plan -------------------------------------------------------------------------------------------------------------


def test_a_robot_has_all_touches_and_half_its_free_time_standing() -> None:
    takes = plan_takes(SUITES, 3, 5400.0)
    for state in SUITES.all_states:
        made = [act for take in takes if take.state == state for act in take.acts]
        assert sorted(map(str, made)) == sorted(map(str, SUITES.acts(state, 3)))
    free = [take for take in takes if take.suite == "free"]
    standing = sum(take.seconds for take in free if take.state in STANDING)
    assert standing == pytest.approx(2700.0)
    assert sum(take.seconds for take in free) == pytest.approx(5400.0)
    assert sum(take.seconds for take in free if take.day is None) == pytest.approx(2700.0)
    assert max(len(take.acts) for take in takes) <= SUITES.touches_per_take
    assert len({take.name for take in takes}) == len(takes)
    assert len({take.noise for take in takes}) == len(takes)
    for take in takes:
        assert all(act.row.act != "before" for act in take.acts[1:])


def test_a_robot_for_tests_is_refused() -> None:
    (take, *_) = plan_takes(SUITES, 100, 0.0)
    with pytest.raises(HeldOutDrawError):
        perform(take, None)


def test_a_take_in_which_the_robot_is_stopped_each_time_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pepper_driver.evaluation.touch.takes.TIPPED", 1e-9)
    act = even("forearm", 8.0)
    done = perform(spec(act), None)
    assert done.recording is None
    assert done.take.failure.startswith("it tipped by")
    assert done.take.redrawn == 2
    assert len(done.take.reasons) == 3
    assert done.take.planned == ((EVEN, "forearm", 8.0),)


def test_a_state_that_does_not_exist_is_named() -> None:
    free = replace(SUITES.free, standing=("standign",))
    with pytest.raises(UnknownNameError, match=r"standign.*did you mean standing"):
        plan_takes(replace(SUITES, free=free), 0, 10.0)
