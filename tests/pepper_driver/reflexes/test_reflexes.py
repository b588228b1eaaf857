"""Reflexes one by one and together: who acts, on what, for how long, and that nothing is left behind."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import Pepper
from pepper_driver.config import UnknownNameError
from pepper_driver.controller import BaseVelocityTask
from pepper_driver.reflexes import (
    Assist,
    Comply,
    FollowHand,
    Hold,
    Ignore,
    Reflex,
    ReflexError,
    Retract,
    Soften,
    StopBase,
)
from pepper_driver.reflexes.reflex import kind_of
from support import ROOT
from support.examples import examples
from support.reflexes import ARM, ROBOT, ROLL, STD, Stage, touch

PUSH = {"LShoulderRoll": 2.0}
ALL: list[type[Reflex]] = [Assist, Comply, FollowHand, Hold, Retract, Soften, StopBase]


EXTREMES: dict[str, tuple[Any, ...]] = {
    "gain": (0.0, 0.005, 0.01, 1.0),
    "damping": (0.05, 12.0),
    "max_torque": (0.1, 100.0),
    "torque": (0.1, 50.0),
    "base_damping": (1.0, 1e4),
    "base_deadband": (0.0, 100.0),
    "speed": (0.01, 1.0),
    "distance": (0.01, 1.5),
    "stiffness": (0.0, 1.0),
    "follow_with": ("arm", "base"),
    "max_duration": (0.0, 3600.0),
    "release_delay": (0.0, 3600.0),
    "then": ("resume", "stay"),
    "inertia": (0.1, 1.0),  # less allows less damping
    "half_gain_stiffness": (1.0, 200.0),
    "torque_deadband_stds": (0.0, 10.0),
    "coast_damping": (1.0, 120.0),
    "adaptation_rate": (0.1, 20.0),
    "min_torque_ratio": (0.0, 1.0),
    "stop_torque_ratio": (0.0, 1.0),
    "smoothing_time": (0.02, 5.0),
}
"""Of every argument of a reflex."""


@examples(120)
@given(st.sampled_from(ALL), st.data())
def test_whatever_arguments_are_taken_nothing_is_raised_inside_a_tick(
    kind: type[Reflex], data: st.DataObject
) -> None:
    own = [field.name for field in fields(kind) if field.init and field.name in EXTREMES]
    reflex = kind(**{name: data.draw(st.sampled_from(EXTREMES[name]), name) for name in own})
    stage = Stage(reflex)
    stage.step(touch(), torque=PUSH)
    stage.run(0.15, torque=PUSH)
    stage.step(touch(phase="end"))
    stage.run(0.15)
    assert np.isfinite(stage.controller.position).all()


def test_more_damping_than_a_cycle_allows_and_a_reflex_given_twice_are_refused() -> None:
    with pytest.raises(ReflexError, match=r"damping is a number from 0\.05 to 12"):
        Comply(damping=12.1)
    with pytest.raises(ReflexError, match=r"damping is a number from 0\.05 to 2\.4"):
        Comply(damping=2.5, inertia=0.02)
    hold = Hold()
    with pytest.raises(ReflexError, match="'hold' is given twice"):
        Stage(hold, StopBase(), hold)


# -- life -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ALL)
def test_it_acts_from_begin_to_a_pause_after_the_end_and_leaves_nothing_behind(
    kind: type[Reflex],
) -> None:
    stage = Stage(reflex := kind(release_delay=0.3))
    stage.run(0.1)
    assert not reflex.active
    stage.step(touch(), torque=PUSH)
    assert reflex.active
    stage.run(0.5, torque=PUSH)
    stage.step(touch(phase="end"))
    stage.run(0.25)
    assert reflex.active
    stage.run(0.1)
    assert not reflex.active
    assert set(stage.controller.tasks) == stage.own_tasks
    assert not stage.arbiter.holds
    assert (stage.arbiter.stiffness == 1.0).all()
    begin, end = stage.events
    assert (begin.reflex, begin.phase, begin.contact_id) == (kind_of(kind), "begin", 1)
    assert (end.reflex, end.phase) == (kind_of(kind), "end")
    assert end.time - begin.time == pytest.approx(0.85, abs=0.05)


@pytest.mark.parametrize("kind", ALL)
def test_it_ends_when_it_has_acted_long_enough_and_waits_for_another_contact(
    kind: type[Reflex],
) -> None:
    stage = Stage(reflex := kind(max_duration=0.5))
    stage.step(touch(1), torque=PUSH)
    stage.run(0.6, torque=PUSH)
    stage.step(touch(1, "update"), torque=PUSH)
    assert not reflex.active
    stage.step(touch(2), torque=PUSH)
    assert reflex.active


@pytest.mark.parametrize("kind", ALL)
def test_a_rebound_neither_begins_nor_prolongs_it(kind: type[Reflex]) -> None:
    stage = Stage(reflex := kind(release_delay=0.2))
    stage.step(touch(1, kind="rebound"), torque=PUSH)
    assert not reflex.active
    stage.step(touch(2), torque=PUSH)
    stage.step(touch(2, "end"))
    stage.step(touch(3, kind="rebound"))
    stage.run(0.25)
    assert not reflex.active


def test_several_contacts_are_one_reaction() -> None:
    stage = Stage(reflex := StopBase(release_delay=0.0))
    stage.step(touch(1))
    stage.step(touch(2, link="RForeArm", joint="RElbowRoll"))
    stage.step(touch(1, "end"))
    stage.run(0.1)
    assert reflex.active
    stage.step(touch(2, "end"))
    stage.run(0.02)
    assert not reflex.active
    assert [event.phase for event in stage.events] == ["begin", "end"]


@pytest.mark.parametrize(
    ("choice", "acts"),
    [
        ({"link": "LBicep"}, True),
        ({"link": "RBicep"}, False),
        ({"joint": "LShoulderRoll"}, True),
        ({"joint": "LElbowRoll"}, False),
        ({"kind": "contact"}, True),
        ({"kind": "collision"}, False),
        ({"min_intensity_deg": 2.0}, True),
        ({"min_intensity_deg": 4.0}, False),
    ],
)
def test_it_is_for_the_chosen_contacts(choice: dict[str, Any], acts: bool) -> None:
    stage = Stage(reflex := StopBase(**choice))
    stage.step(touch())
    assert reflex.active == acts


def test_a_contact_that_grows_into_a_collision_begins_what_is_for_collisions() -> None:
    stage = Stage(reflex := StopBase(kind="collision"))
    stage.step(touch())
    assert not reflex.active
    stage.step(touch(phase="update", kind="collision"))
    assert reflex.active


# -- comply ---------------------------------------------------------------------------------------------------------


def yielding(gain: float, seconds: float = 1.0, **changes: Any) -> float:
    """By how much the pushed joint gives way [rad]."""
    stage = Stage(Comply(gain=gain, **changes))
    before = stage.step(touch(), torque=PUSH)[ROLL]
    return float(stage.run(seconds, torque=PUSH)[-1, ROLL] - before)


def test_a_stiff_one_stands_still_and_a_free_one_goes_on() -> None:
    assert yielding(0.0) == pytest.approx(0.0, abs=1e-3)
    beyond = PUSH["LShoulderRoll"] - 2 * STD
    # At the free end the speed is torque / damping; at first the joint must be brought to it.
    assert yielding(1.0, 0.5, damping=4.0) == pytest.approx(0.5 * beyond / 4.0, rel=0.15)


def test_between_them_it_is_a_spring() -> None:
    beyond = PUSH["LShoulderRoll"] - 2 * STD
    for gain in (0.3, 0.5, 0.7):
        stiffness = 40.0 * (1 - gain) / gain
        assert yielding(gain, 3.0) == pytest.approx(beyond / stiffness, rel=0.1)


def test_what_may_be_noise_moves_nothing() -> None:
    stage = Stage(Comply())
    before = stage.step(touch(), torque={"LShoulderRoll": 1.9 * STD})
    after = stage.run(1.0, torque={"LShoulderRoll": 1.9 * STD})[-1]
    np.testing.assert_allclose(after, before, atol=1e-3)


def test_it_follows_the_torque_its_way_and_only_its_limb() -> None:
    stage = Stage(Comply())
    before = stage.step(touch(direction=-1), torque={"LShoulderRoll": 0.0, "LElbowYaw": -1.0})
    after = stage.run(0.5, torque={"LElbowYaw": -1.0, "RShoulderRoll": 3.0})[-1]
    moved = after - before
    assert moved[ROBOT.joint_index("LElbowYaw")] < -0.05
    others = [k for k in range(17) if k not in ARM]
    np.testing.assert_allclose(moved[others], 0.0, atol=2e-3)


@pytest.mark.parametrize("then", ["resume", "stay"])
def test_afterwards_joints_go_back_or_stay(then: Any) -> None:
    stage = Stage(Comply(then=then, release_delay=0.1))
    home = stage.step(touch(), torque=PUSH)[ROLL]
    led = stage.run(0.5, torque=PUSH)[-1, ROLL]
    assert led > home + 0.2
    target = stage.arbiter.target[ROLL]
    stage.step(touch(phase="end"))
    trail = [stage.step()[ROLL] for _ in range(300)]
    if then == "stay":
        assert trail[-1] == pytest.approx(stage.arbiter.target[ROLL], abs=1e-3)
        assert trail[-1] > led - 0.02
    else:
        assert stage.arbiter.target[ROLL] == target
        assert trail[-1] == pytest.approx(home, abs=2e-3)
        # It turns round once.
        speed = np.diff(trail)
        turns = np.flatnonzero(np.diff(np.sign(speed[np.abs(speed) > 1e-6])))
        assert len(turns) <= 1


@pytest.mark.parametrize("kind", [Comply, Retract])
def test_a_contact_that_turns_out_to_be_on_a_limb_moves_it(kind: type[Reflex]) -> None:
    stage = Stage(kind())
    before = stage.step(touch(joint=None, link="torso"), torque=PUSH)[ROLL]
    stage.run(0.1, torque=PUSH)
    stage.step(touch(phase="update"), torque=PUSH)
    assert stage.run(0.5, torque=PUSH)[-1, ROLL] > before + 0.1


def test_contact_on_the_trunk_moves_no_limb() -> None:
    for reflex in (Comply(), Retract(), FollowHand()):
        stage = Stage(reflex)
        before = stage.step(touch(joint=None, link="torso"))
        np.testing.assert_allclose(stage.run(0.5)[-1], before, atol=1e-6)


def test_assist_helps_who_pushes_hard_more_than_who_pushes_lightly() -> None:
    ways = {}
    for torque in (1.0, 4.0):
        for kind in (Comply, Assist):
            stage = Stage(kind(damping=8.0))
            external = {"LShoulderRoll": torque}
            before = stage.step(touch(), torque=external)[ROLL]
            ways[kind, torque] = stage.run(0.6, torque=external)[-1, ROLL] - before
    assert ways[Assist, 4.0] > 1.5 * ways[Comply, 4.0]
    assert ways[Assist, 1.0] < 0.8 * ways[Comply, 1.0]


# -- the others -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1, -1])
def test_retract_goes_the_way_the_torque_pushes_and_stops_when_it_ends(sign: int) -> None:
    stage = Stage(Retract(speed=0.5))
    external = {"LShoulderRoll": 2.0 * sign}
    before = stage.step(touch(direction=sign), torque=external)[ROLL]
    away = sign * (stage.run(0.4, torque=external)[:, ROLL] - before)
    assert 0.05 < away[-1] < 0.25
    assert (np.diff(away) > -1e-6).all()
    rest = sign * (stage.run(1.0)[:, ROLL] - before)
    assert rest[-1] < away[-1] + 0.06
    assert abs(np.diff(rest)[-1]) < 1e-4


def test_retract_goes_no_further_than_it_may() -> None:
    stage = Stage(Retract(distance=0.2, speed=1.0))
    before = stage.step(touch(), torque=PUSH)[ROLL]
    assert stage.run(2.0, torque=PUSH)[-1, ROLL] - before == pytest.approx(0.2, abs=0.01)


def test_soften_lowers_the_motors_of_the_limb() -> None:
    stage = Stage(Soften(stiffness=0.4))
    stage.step(touch())
    stiffness = stage.arbiter.stiffness
    assert (stiffness[ARM] == 0.4).all()
    assert (np.delete(stiffness, ARM) == 1.0).all()


def test_stop_base_brakes_a_base_that_the_user_drives() -> None:
    stage = Stage(StopBase(release_delay=0.5))
    task = BaseVelocityTask()
    task.target = [0.2, 0.0, 0.1]
    stage.controller.add(task)
    stage.controller.remove(stage.controller.base_velocity)
    stage.run(2.0)
    assert stage.controller.model.v[0] > 0.15
    stage.step(touch())
    stage.run(1.5)
    assert np.abs(stage.controller.model.v[:3]).max() < 0.005
    stage.step(touch(phase="end"))
    stage.run(3.0)
    assert stage.controller.model.v[0] > 0.15


def test_the_base_follows_the_pull_at_a_hand() -> None:
    stage = Stage(FollowHand(follow_with="base"))
    model, posture = stage.controller.model, stage.controller.position
    jacobian = model.point_jacobian("l_wrist", np.zeros(3), posture)
    torque = jacobian.T @ np.array([12.0, 0.0, 0.0])
    external = {ROBOT.joint_names[k]: float(torque[k]) for k in ARM[:5]}
    before = stage.step(touch(), torque=external)
    after = stage.run(1.0, torque=external)[-1]
    x, y, _ = stage.controller.base_pose
    assert x > 0.03
    assert abs(y) < 0.5 * x
    np.testing.assert_allclose(after, before, atol=0.02)


# -- together -------------------------------------------------------------------------------------------------------


def test_joints_go_to_the_highest_priority_and_to_the_next_when_it_lets_go() -> None:
    stage = Stage(
        low := Hold(release_delay=3.0, priority=1),
        high := Comply(release_delay=0.0, priority=2, link="LBicep"),
    )
    stage.step(touch(), torque=PUSH)
    stage.run(0.3, torque=PUSH)
    assert low.active
    assert high.active
    assert not stage.arbiter.holds
    stage.step(touch(phase="end"))
    led = stage.run(0.1)[-1, ROLL]
    assert not high.active
    assert stage.arbiter.holds
    assert stage.run(1.0)[-1, ROLL] == pytest.approx(led, abs=0.05)


def test_reflexes_on_different_parts_act_together() -> None:
    stage = Stage(Comply(), StopBase(), Soften(link="RForeArm"))
    stage.step(touch(), torque=PUSH)
    assert [event.reflex for event in stage.events] == ["stop_base", "comply"]
    stage.step(touch(2, joint="RElbowRoll", link="RForeArm"), torque=PUSH)
    assert stage.events[-1].reflex == "soften"


def test_what_is_ignored_reaches_only_higher_priorities() -> None:
    above, below = StopBase(priority=200), Hold()
    stage = Stage(below, Ignore(link="LBicep"), above)
    stage.step(touch())
    assert above.active
    assert not below.active
    stage.step(touch(2, link="RForeArm", joint="RElbowRoll"))
    assert below.active


def test_a_contact_that_turns_out_to_be_ignored_is_over_for_those_below() -> None:
    stage = Stage(below := Hold(release_delay=0.2), Ignore(kind="collision"))
    stage.step(touch())
    stage.run(0.1)
    assert below.active
    stage.step(touch(phase="update", kind="collision"))
    stage.run(0.3)
    assert not below.active
    stage.step(touch(phase="end", kind="collision"))
    assert not below.active


def test_joints_that_were_never_given_are_not_left() -> None:
    """Retract has the arm; what Comply would have left stays the user's, and so does a limb that was only softened."""
    stage = Stage(
        Retract(release_delay=2.0),
        Comply(then="stay", release_delay=0.0),
        Soften(then="stay", release_delay=0.0),
    )
    stage.step(touch(), torque=PUSH)
    stage.run(0.3, torque=PUSH)
    target = stage.arbiter.target
    stage.step(touch(phase="end"))
    for _ in range(300):
        stage.step()
        np.testing.assert_array_equal(stage.arbiter.target, target)


def test_a_base_is_not_led_by_an_arm_that_another_reflex_has() -> None:
    stage = Stage(Retract(), FollowHand(follow_with="base"))
    stage.step(touch(), torque={"LShoulderPitch": -4.0, "LShoulderRoll": 4.0})
    stage.run(1.0, torque={"LShoulderPitch": -4.0, "LShoulderRoll": 4.0})
    assert np.abs(stage.controller.base_pose).max() < 1e-3


def test_reflexes_of_one_kind_have_names_of_their_own() -> None:
    """Also when they are prepared again, and where a name that was given ends in a number."""
    reflexes = Hold(), Hold(name="hold 1"), Hold(), Hold(name="mine"), Comply()
    for _ in range(2):
        stage = Stage(*reflexes)
        names = [(reflex.full_name, reflex.number) for reflex in stage.reflexes]
        assert names == [("comply", 1), ("hold 2", 2), ("hold 1", 1), ("hold 3", 3), ("mine", 1)]
        assert [reflex.name for reflex in reflexes] == ["hold", "hold 1", "hold", "mine", "comply"]


def test_the_page_has_the_defaults_of_every_reflex() -> None:
    page = (ROOT / "docs" / "reflexes.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \|.*\| (\d+) \| `(\w+)` \|$", page, re.MULTILINE)
    kinds = (Ignore, StopBase, Retract, Comply, Assist, FollowHand, Hold, Soften)
    defaults = [(kind.__name__, str(kind().priority), kind().then) for kind in kinds]
    assert rows == defaults


def test_events_say_which_reflex_has_the_joints() -> None:
    """Two claim one arm: the log says at any time which of them has it."""
    arm = tuple(name for name in ROBOT.limbs["left_arm"] if name not in ROBOT.hands.joints)
    stage = Stage(Retract(kind="collision"), FollowHand(), Retract(limb="head", kind="collision"))
    stage.step(touch(1))
    stage.step(touch(1, phase="update", kind="collision"))
    stage.run(0.1)
    stage.step(touch(1, phase="end"))
    stage.run(2.0)
    reported = [
        (e.reflex, e.kind, e.number, e.phase, e.joints, e.held_joints) for e in stage.events
    ]
    assert reported == [
        ("follow_hand", "follow_hand", 1, "begin", arm, arm),
        ("retract 1", "retract", 1, "begin", arm, arm),
        ("follow_hand", "follow_hand", 1, "update", arm, ()),
        ("follow_hand", "follow_hand", 1, "end", arm, ()),
        ("retract 1", "retract", 1, "end", arm, arm),
    ]


# -- mistakes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (Comply, {"gain": 1.1}),
        (Comply, {"gain": np.nan}),
        (Comply, {"damping": 0.0}),
        (Comply, {"gain": "soft"}),
        (Comply, {"gain": True}),
        (Retract, {"distance": -1.0}),
        (Soften, {"stiffness": 2.0}),
        (Hold, {"then": "wait"}),
        (Hold, {"max_duration": np.inf}),
        (FollowHand, {"follow_with": "head"}),
        (Assist, {"torque": 0.0}),
    ],
)
def test_arguments_without_sense_are_refused(kind: Any, wrong: dict[str, Any]) -> None:
    with pytest.raises(ReflexError, match=next(iter(wrong))):
        kind(**wrong)


def test_unknown_names_are_refused_before_anything_moves() -> None:
    for wrong in ({"link": "LForearm"}, {"joint": "Elbow"}, {"kind": "crash"}):
        with pytest.raises(UnknownNameError):
            Pepper("mujoco", observer=None, reflexes=[Hold(**wrong)])  # type: ignore[arg-type]
    with pytest.raises(ReflexError, match="Hold"):
        Pepper("mujoco", observer=None, reflexes=[Hold])  # type: ignore[list-item]


@examples(30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["begin", "update", "end"]),
            st.integers(1, 3),
            st.sampled_from(["contact", "collision", "rebound"]),
            st.floats(-20.0, 20.0),
        ),
        max_size=30,
    )
)
def test_whatever_comes_in_whatever_order_all_let_go_in_the_end(story: list[Any]) -> None:
    stage = Stage(*(kind() for kind in ALL))
    for phase, number, kind, torque in story:
        stage.step(touch(number, phase, kind=kind), torque={"LShoulderRoll": torque})
        stage.run(0.05)
    for number in (1, 2, 3):
        stage.step(touch(number, "end"))
    stage.run(4.0)
    assert set(stage.controller.tasks) == stage.own_tasks
    assert (stage.arbiter.stiffness == 1.0).all()
    assert sum(event.phase == "begin" for event in stage.events) * 2 == len(stage.events)
