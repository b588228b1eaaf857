from __future__ import annotations

import math
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.observer.detection.chain_isolation import ChainTracker, last_in_chain
from pepper_driver.observer.detection.excursions import Excursion
from pepper_driver.observer.interface import INTENSITY_STEP_DEG, Contact, JointState
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, THRESHOLD, check_life

CHAIN = ROBOT.chains["left_arm"]
PERIOD = round(SETTINGS.update_period / CYCLE)
GAP = round(SETTINGS.merge_gap / CYCLE)
Row = dict[str, float]


class Player:
    """Feeds residuals, in multiples of the threshold, to the tracker of one chain."""

    def __init__(self, chain: tuple[str, ...] = CHAIN) -> None:
        self._k = 0
        self.states = [JointState.BLIND] * JOINTS
        self.tracker = ChainTracker(
            ROBOT, chain, SETTINGS, lambda joint, sign, threshold: 0.0, count(1).__next__
        )

    def play(self, ticks: int, **residuals: float) -> list[Contact]:
        """Events of so many ticks in which the other joints have no residual."""
        row = [0.0] * JOINTS
        for name, value in residuals.items():
            row[ROBOT.joint_index(name)] = value * THRESHOLD
        events = []
        for _ in range(ticks):
            events += self.tracker.step(self._k * CYCLE, row, [THRESHOLD] * JOINTS, self.states)
            self._k += 1
        return events

    def state(self, joint: str) -> JointState:
        return self.states[ROBOT.joint_index(joint)]


def story(events: list[Contact]) -> list[tuple[int, str, str, str | None]]:
    return [(event.id, event.phase, event.kind, event.joint) for event in events]


def test_a_touch_on_one_joint() -> None:
    player = Player()
    assert player.play(5, LElbowRoll=0.9) == []
    assert player.tracker.idle
    events = player.play(2 * PERIOD + 1, LElbowRoll=2.0)
    assert not player.tracker.idle
    events += player.play(GAP + 1, LElbowRoll=-0.5)
    assert story(events) == [(1, "begin", "contact", "LElbowRoll")]  # nothing changes
    [end] = player.play(1)
    assert player.tracker.idle
    begin = events[0]
    assert begin.link == ROBOT.joints[ROBOT.joint_index("LElbowRoll")].child
    assert begin.direction == -1  # r > 0: the joint is held back
    assert begin.intensity_deg == pytest.approx(math.degrees(2.0 * THRESHOLD))
    assert begin.time == begin.detection_time == pytest.approx(5 * CYCLE)
    # Raised after the gap, but the contact ended when the residual fell.
    assert (end.phase, end.id) == ("end", 1)
    assert end.time == pytest.approx((5 + 2 * PERIOD + 1) * CYCLE)
    assert end.direction == -1
    check_life([*events, end])


def test_direction_is_against_the_residual_and_intensity_its_largest() -> None:
    player = Player()
    events = player.play(1, HeadYaw=0.0, LElbowYaw=-1.5)
    events += player.play(PERIOD, LElbowYaw=-4.0)
    events += player.play(PERIOD, LElbowYaw=-2.0)
    events += player.play(GAP + 2)
    assert [event.phase for event in events] == ["begin", "update", "end"]
    assert [event.direction for event in events] == [1, 1, 1]
    assert [event.intensity_deg for event in events] == pytest.approx(
        [math.degrees(k * THRESHOLD) for k in (1.5, 4.0, 4.0)]
    )


def test_updates_come_a_period_after_another_and_when_the_contact_has_grown() -> None:
    step = math.radians(INTENSITY_STEP_DEG) / THRESHOLD
    player = Player()
    player.play(1, LElbowYaw=3.0)
    assert player.play(PERIOD - 1, LElbowYaw=3.0 + 1.1 * step) == []
    [first] = player.play(PERIOD, LElbowYaw=3.0 + 1.1 * step)
    assert first.phase == "update"
    assert first.time == pytest.approx(PERIOD * CYCLE)
    assert player.play(PERIOD, LElbowYaw=3.0 + 2.0 * step) == []
    [second] = player.play(1, LElbowYaw=3.0 + 2.2 * step)
    assert second.intensity_deg - first.intensity_deg == pytest.approx(1.1 * INTENSITY_STEP_DEG)
    assert player.play(3 * PERIOD, LElbowYaw=2.0) == []  # the largest so far stays


def test_a_new_touch_has_a_new_id() -> None:
    player = Player()
    events = player.play(5, LElbowYaw=2.0) + player.play(GAP + 10)
    events += player.play(5, LElbowYaw=2.0) + player.play(GAP + 10)
    assert [(event.id, event.phase) for event in events] == [
        (1, "begin"),
        (1, "end"),
        (2, "begin"),
        (2, "end"),
    ]


def test_the_last_joint_over_its_threshold_gets_the_contact() -> None:
    player = Player()
    events = player.play(1, LShoulderPitch=9.0, LElbowYaw=1.1, LShoulderRoll=-5.0)
    assert story(events) == [(1, "begin", "contact", "LElbowYaw")]
    assert player.state("LShoulderPitch") is JointState.CONTACT
    assert player.state("LHand") is JointState.FREE


def test_last_in_chain_is_the_outermost() -> None:
    def excursion(joint: int) -> Excursion:
        return Excursion(
            joint=joint, sign=1, kind="contact", onset_time=0.0, peak=1.0, begin_time=0.0
        )

    assert last_in_chain([excursion(5), excursion(8)]).joint == 8


def test_a_joint_further_out_takes_the_contact_over_at_once() -> None:
    player = Player()
    events = player.play(2, LShoulderRoll=5.0)
    events += player.play(2, LShoulderRoll=5.0, LElbowRoll=-1.5)
    assert story(events) == [
        (1, "begin", "contact", "LShoulderRoll"),
        (1, "update", "contact", "LElbowRoll"),
    ]
    moved = events[1]
    assert moved.time == pytest.approx(2 * CYCLE)
    assert moved.detection_time == 0.0
    assert moved.direction == 1
    assert moved.intensity_deg == pytest.approx(math.degrees(1.5 * THRESHOLD))


def test_a_contact_does_not_move_inwards() -> None:
    player = Player()
    player.play(3, LShoulderRoll=5.0, LElbowRoll=1.5)
    events = player.play(PERIOD + 1, LShoulderRoll=5.0)
    events += player.play(GAP + 2)
    assert story(events) == [(1, "end", "contact", "LElbowRoll")]
    # All of the chain is one touch: it ended when the last joint fell.
    assert events[-1].time == pytest.approx((3 + PERIOD + 1) * CYCLE)


def test_a_blind_joint_loses_the_contact() -> None:
    player = Player()
    player.play(3, LShoulderRoll=5.0, LElbowRoll=1.5)
    events = player.play(2, LShoulderRoll=5.0, LElbowRoll=math.nan)
    assert story(events) == [(1, "update", "contact", "LShoulderRoll")]
    assert player.state("LElbowRoll") is JointState.BLIND
    events = player.play(1, LShoulderRoll=math.nan, LElbowRoll=math.nan)
    assert story(events) == [(1, "end", "contact", "LShoulderRoll")]
    assert events[0].time == pytest.approx(5 * CYCLE)


def test_the_gap_is_that_of_the_chain() -> None:
    player = Player()
    events = player.play(3, LElbowRoll=2.0) + player.play(GAP - 5)
    events += player.play(3, LShoulderRoll=2.0) + player.play(GAP + 2)
    assert story(events) == [
        (1, "begin", "contact", "LElbowRoll"),
        (1, "end", "contact", "LElbowRoll"),
    ]
    assert events[1].time == pytest.approx((3 + GAP - 5 + 3) * CYCLE)


def test_a_rebound_has_its_own_id() -> None:
    player = Player()
    events = player.play(5, LElbowRoll=5.0) + player.play(3)
    events += player.play(4, LElbowRoll=-2.0) + player.play(GAP + 2)
    assert story(events) == [
        (1, "begin", "contact", "LElbowRoll"),
        (1, "end", "contact", "LElbowRoll"),
        (2, "begin", "rebound", "LElbowRoll"),
        (2, "end", "rebound", "LElbowRoll"),
    ]
    assert events[1].time == pytest.approx(5 * CYCLE)
    assert events[2].time == pytest.approx(8 * CYCLE)
    assert events[3].time == pytest.approx(12 * CYCLE)
    assert (events[1].direction, events[2].direction) == (-1, 1)


def test_a_residual_that_jumps_to_the_other_side_ends_and_begins_in_one_tick() -> None:
    player = Player()
    player.play(5, LElbowRoll=5.0)
    events = player.play(1, LElbowRoll=-5.0)
    assert story(events) == [
        (1, "end", "contact", "LElbowRoll"),
        (2, "begin", "rebound", "LElbowRoll"),
    ]
    assert [event.time for event in events] == pytest.approx([5 * CYCLE] * 2)


def test_a_rebound_that_stays_ends_and_a_contact_begins() -> None:
    """A person holds the joint: a program that waits for the begin of a contact must receive it."""
    player = Player()
    player.play(5, LElbowRoll=5.0)
    player.play(3)
    events = player.play(60, LElbowRoll=-2.0)
    rebound = [event for event in events if event.id == 2]
    contact = [event for event in events if event.id == 3]
    assert {event.kind for event in rebound} == {"rebound"}
    assert {event.kind for event in contact} == {"contact"}
    assert (rebound[0].phase, rebound[-1].phase) == ("begin", "end")
    assert contact[0].phase == "begin"
    assert contact[0].time == rebound[-1].time
    assert contact[0].time - rebound[0].time == pytest.approx(
        SETTINGS.rebound_window, abs=1.5 * CYCLE
    )


def test_a_joint_swinging_back_does_not_end_the_contact_of_another() -> None:
    player = Player()
    events = player.play(3, LShoulderRoll=3.0, LElbowRoll=3.0)
    events += player.play(4, LShoulderRoll=3.0, LElbowRoll=-2.0)
    assert story(events) == [(1, "begin", "contact", "LElbowRoll")]
    assert player.state("LElbowRoll") is JointState.REBOUND
    events = player.play(2, LElbowRoll=-2.0)
    assert story(events) == [
        (1, "end", "contact", "LElbowRoll"),
        (2, "begin", "rebound", "LElbowRoll"),
    ]


def test_a_new_touch_during_a_rebound_is_a_contact_of_its_own() -> None:
    player = Player()
    player.play(3, LElbowRoll=3.0)
    player.play(2)
    player.play(3, LElbowRoll=-2.0)
    events = player.play(1, LElbowRoll=-2.0, LShoulderRoll=2.0)
    assert story(events) == [
        (2, "end", "rebound", "LElbowRoll"),
        (3, "begin", "contact", "LShoulderRoll"),
    ]
    events = player.play(1, LElbowRoll=-2.0, LWristYaw=2.0)
    assert story(events) == [(3, "update", "contact", "LWristYaw")]


def test_a_touch_that_begins_with_a_rebound_is_on_the_joint_that_does_not_swing_back() -> None:
    player = Player()
    player.play(3, LElbowRoll=3.0)
    player.play(GAP + 2)  # the contact has ended, the rebound window has not
    assert player.tracker.idle
    events = player.play(1, LElbowRoll=-2.0, LShoulderRoll=2.0)
    assert story(events) == [(2, "begin", "contact", "LShoulderRoll")]


def test_reset_forgets() -> None:
    player = Player()
    player.play(5, LElbowRoll=5.0)
    player.tracker.reset()
    assert player.tracker.idle
    assert player.play(GAP + 5) == []


VALUES = st.sampled_from([0.0, 0.5, -0.9, 1.5, -1.5, 3.0, -3.0, math.nan])
SIGNALS = st.lists(st.tuples(st.integers(1, 40), VALUES, VALUES, VALUES), min_size=1, max_size=25)


@given(SIGNALS)
def test_events_make_sense_for_any_signal(parts: list[tuple[int, float, float, float]]) -> None:
    names = ("LShoulderPitch", "LElbowYaw", "LHand")
    player = Player()
    events = []
    for ticks, *values in parts:
        row = dict(zip(names, values, strict=True))
        new = player.play(ticks, **row)
        for event in new:
            assert event.joint is not None
            if event.phase != "end":
                value = row[event.joint]
                assert not math.isnan(value)
                if event.phase == "begin":
                    assert abs(value) > 1
                    assert event.direction == -math.copysign(1, value)
        events += new
    events += player.play(GAP + 2)
    check_life(events)
    assert player.tracker.idle
    begun = [event.id for event in events if event.phase == "begin"]
    assert begun == list(range(1, len(begun) + 1))
    assert [event.id for event in events if event.phase == "end"] == begun
    # One contact at a time on a chain.
    open_id = None
    for event in events:
        if event.phase == "begin":
            assert open_id is None
            open_id = event.id
        assert event.id == open_id
        if event.phase == "end":
            open_id = None
