"""Scores of hand-made takes: each rule of detection against a timeline that one counts by hand."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.evaluation.touch.records import (
    ObserverRecord,
    ReportedEvent,
    Take,
    TorqueEstimate,
    Touched,
)
from pepper_driver.evaluation.touch.scoring import (
    TakeScore,
    reported_events,
    score_robot,
    score_take,
)
from support.evaluation import ROBOT, contact
from support.touch_records import robot, take, touched

LIMBS = tuple(ROBOT.limbs)
SECONDS = 40.0
SHOULDER, ELBOW, WRIST = "LShoulderRoll", "LElbowRoll", "LWristYaw"


TORQUE = {SHOULDER: -2.0, ELBOW: 1.5, WRIST: 0.2, "LElbowYaw": 0.5}


def touch(onset: float, release: float, **changes: Any) -> Touched:
    """A touch on the left arm that turns its shoulder most, its elbow a little less, its wrist hardly."""
    return touched(onset, "forearm", **{"release": release, "torque": TORQUE, **changes})


def event(
    number: int, phase: str, time: float, limb: str = "left_arm", **changes: Any
) -> ReportedEvent:
    joint = {"left_arm": SHOULDER, "right_arm": "RShoulderRoll", "head": "HeadYaw"}.get(limb)
    values = {"kind": "contact", "joint": joint, "direction": -1, **changes}
    values.setdefault("shown_by", values["joint"])
    return ReportedEvent(id=number, phase=phase, time=time, limb=limb, **values)  # type: ignore[arg-type]


def observed_take(
    touches: Sequence[Touched], events: Sequence[ReportedEvent], **observed: Any
) -> Take:
    """A take that is free without touches."""
    hearings = {"ours": ObserverRecord(events=tuple(events), **observed)}
    return take(touches, hearings, suite="touch" if touches else "free", seconds=SECONDS)


def scored(
    touches: Sequence[Touched], events: Sequence[ReportedEvent], **observed: Any
) -> TakeScore:
    return score_take(observed_take(touches, events, **observed), "ours", LIMBS)


def begins(*times: float, **changes: Any) -> list[ReportedEvent]:
    """Contacts of 50 ms."""
    return [
        event(number, phase, time + later, **changes)
        for number, time in enumerate(times)
        for phase, later in (("begin", 0.0), ("end", 0.05))
    ]


@pytest.mark.parametrize(
    ("time", "kind", "limb", "verdict"),
    [
        (9.99, "contact", "left_arm", "false"),
        (10.0, "contact", "left_arm", "right"),
        (11.29, "collision", "left_arm", "right"),
        (11.31, "contact", "left_arm", "false"),
        (10.5, "contact", "right_arm", "false"),
        (10.5, "contact", "trunk", "false"),
        (9.99, "rebound", "left_arm", "false"),
        (10.5, "rebound", "left_arm", "rebound"),
        (11.79, "rebound", "left_arm", "rebound"),
        (11.81, "rebound", "left_arm", "false"),
        (11.5, "rebound", "right_arm", "false"),
    ],
)
def test_an_event_is_right_a_rebound_or_false(
    time: float, kind: str, limb: str, verdict: str
) -> None:
    result = scored([touch(10.0, 11.0)], begins(time, kind=kind, limb=limb))
    counts = {"right": result.right, "rebound": result.rebounds, "false": result.false_begins}
    assert counts == {**dict.fromkeys(counts, 0), verdict: 1}
    # A rebound never detects a touch, not even while the touch lasts.
    assert [t.detected for t in result.touches] == [verdict == "right"]
    assert result.false_moves == 0


@pytest.mark.parametrize(
    ("time", "limb", "verdict"),
    [(10.5, "left_arm", "open"), (10.5, "trunk", "right"), (9.99, "left_arm", "false")],
)
def test_a_contact_that_leaves_its_limb_open_is_right_on_the_trunk_alone(
    time: float, limb: str, verdict: str
) -> None:
    """While another limb is touched it is no false one, but it detects nothing."""
    events = begins(time, limb="trunk", joint=None, limb_known=False)
    result = scored([touch(10.0, 11.0, limb=limb)], events)
    counts = {"right": result.right, "open": result.open_limbs, "false": result.false_begins}
    assert counts == {**dict.fromkeys(counts, 0), verdict: 1}
    [one] = result.touches
    assert one.detected == (verdict == "right")
    assert one.first_limb == (True if verdict == "right" else None)
    assert result.idle_contact == pytest.approx(0.01 if verdict == "false" else 0.0)


def test_false_events_keep_what_may_have_caused_them() -> None:
    touches = [touch(10.0, 11.0), touch(20.0, 30.0, limb="head", torque={})]
    events = [
        event(1, "begin", 5.0, "trunk"),
        event(2, "begin", 11.4),
        event(3, "begin", 13.49, kind="rebound"),
        event(4, "begin", 13.51),
        event(5, "begin", 25.0, "right_arm"),
        event(6, "begin", 30.2, "right_arm"),
        event(7, "begin", 12.0, "right_arm"),
    ]
    false = {f.time: f for f in scored(touches, events).false}
    assert list(false) == sorted(e.time for e in events)
    assert [f.time for f in false.values() if f.after_release] == [11.4, 13.49]
    assert [f.time for f in false.values() if f.other_touched] == [25.0, 30.2]
    assert [f.time for f in false.values() if f.rebound] == [13.49]
    assert (false[5.0].limb, false[5.0].shown_by) == ("trunk", None)
    assert false[25.0].shown_by == "RShoulderRoll"


def test_moves_are_judged_where_they_go_and_counted_apart() -> None:
    events = [
        event(1, "begin", 10.1, "trunk"),
        event(1, "update", 10.2),
        event(1, "update", 10.3, joint=ELBOW),
        event(1, "update", 10.4, joint=ELBOW, direction=1),
        event(1, "update", 10.5, joint=ELBOW, direction=1, kind="collision"),
        event(1, "update", 12.0, "right_arm"),
        event(1, "end", 13.0, "right_arm"),
    ]
    result = scored([touch(10.0, 11.0)], events)
    assert (result.right, result.false_begins, result.false_moves) == (2, 1, 1)
    reported = result.touches[0]
    assert reported.detected
    assert reported.delay == pytest.approx(0.2)
    assert reported.first_limb is False
    assert reported.end_error == pytest.approx(2.0)


def test_a_move_within_the_limb_detects_no_second_touch() -> None:
    touches = [touch(10.0, 20.0), touch(12.0, 13.0)]
    events = [event(1, "begin", 10.1), event(1, "update", 12.1, joint=ELBOW)]
    assert [t.detected for t in scored(touches, events).touches] == [True, False]


def test_a_rebound_that_turns_into_a_contact_counts_again() -> None:
    events = [event(1, "begin", 10.1, kind="rebound"), event(1, "update", 10.4)]
    result = scored([touch(10.0, 11.0)], events)
    assert (result.rebounds, result.right) == (1, 1)
    assert result.touches[0].delay == pytest.approx(0.4)
    assert scored([], events).false_moves == 1


def test_one_begin_detects_one_touch_the_latest_that_is_not_detected() -> None:
    touches = [touch(10.0, 20.0), touch(12.0, 13.0), touch(12.0, 13.0, limb="head", torque={})]
    detected = {
        times: [t.detected for t in scored(touches, begins(*times)).touches[:2]]
        for times in ((10.5,), (12.5,), (12.5, 12.7), (12.5, 12.7, 12.9), (13.5,))
    }
    assert detected == {
        (10.5,): [True, False],
        (12.5,): [False, True],
        (12.5, 12.7): [True, True],
        (12.5, 12.7, 12.9): [True, True],
        (13.5,): [True, False],
    }
    # Taps in quick succession: one contact over both detects one of them.
    taps = [touch(10.0, 10.1), touch(10.2, 10.3)]
    one = [event(1, "begin", 10.05), event(1, "end", 10.6)]
    assert [t.detected for t in scored(taps, one).touches] == [True, False]
    assert [t.detected for t in scored(taps, begins(10.05, 10.25)).touches] == [True, True]


def test_a_touch_from_before_the_start_is_timed_from_the_first_tick() -> None:
    standing = touch(-3.0, 2.0, standing_start=True)
    result = scored([standing], begins(0.4))
    assert result.touches[0].delay == pytest.approx(0.4)
    # Three other limbs of four all the time, and this one after the grace.
    assert result.hours == pytest.approx((4 * SECONDS - 2.3) / 4 / 3600)


def test_limb_that_was_reported_first() -> None:
    touches = [touch(10.0, 11.0), touch(20.0, 21.0), touch(30.0, 31.0), touch(35.0, 36.0)]
    events = [
        event(1, "begin", 9.9, "trunk"),
        event(2, "begin", 10.2),
        event(3, "begin", 10.3, "trunk"),
        event(4, "begin", 20.1, "trunk", kind="rebound"),
        event(5, "begin", 20.2, "right_arm"),
        event(6, "begin", 20.4),
        event(7, "begin", 30.5, "trunk"),
        event(8, "begin", 34.0, "trunk"),
        event(8, "update", 35.2, "right_arm"),
        event(9, "begin", 35.3, "head", kind="rebound"),
    ]
    result = scored(touches, events)
    assert [t.first_limb for t in result.touches] == [True, False, False, None]
    assert [t.detected for t in result.touches] == [True, True, False, False]
    # A contact that detects another touch says nothing of this one.
    two = [touch(10.0, 11.0), touch(10.0, 11.0, limb="head", torque={})]
    both = [event(1, "begin", 10.1, "head"), event(2, "begin", 10.2)]
    assert [t.first_limb for t in scored(two, both).touches] == [True, True]


def test_place_and_direction_at_the_alarm_and_later() -> None:
    events = [
        event(1, "begin", 10.1, joint=ELBOW, direction=-1),
        event(1, "update", 10.256, joint=SHOULDER, direction=-1),
        event(1, "update", 10.27, joint=WRIST, direction=-1),
    ]
    reported = scored([touch(10.0, 11.0)], events).touches[0]
    assert reported.alarm is not None
    assert reported.later is not None
    # The elbow has 0.75 of the largest torque, and the other sign.
    assert (reported.alarm.limb, reported.alarm.joint, reported.alarm.largest_joint) == (
        True,
        True,
        False,
    )
    assert reported.alarm.direction is False
    assert (reported.later.joint, reported.later.largest_joint) == (True, True)
    assert reported.later.direction is True


@pytest.mark.parametrize(
    ("joint", "right", "direction"),
    [("LElbowYaw", False, True), (WRIST, False, None), ("LShoulderPitch", False, None)],
)
def test_joints_with_little_torque(joint: str, right: bool, direction: bool | None) -> None:
    events = [event(1, "begin", 10.1, joint=joint, direction=1)]
    alarm = scored([touch(10.0, 11.0)], events).touches[0].alarm
    assert alarm is not None
    assert (alarm.joint, alarm.largest_joint, alarm.direction) == (right, False, direction)


@pytest.mark.parametrize(
    ("time", "acts", "direction"),
    [
        (10.1, 1.5, True),
        (10.1, -1.5, False),
        (10.1, -0.3, None),
        (11.0, 0.0, None),
        (11.1, 0.0, False),  # a tap that is detected once it is over
    ],
)
def test_direction_is_that_of_the_torque_that_acts_then(
    time: float, acts: float, direction: bool | None
) -> None:
    # A hand that holds on to a moving arm: the largest torque is to the other side.
    events = [event(1, "begin", time, direction=1, true_torque=acts)]
    alarm = scored([touch(10.0, 11.0)], events).touches[0].alarm
    assert alarm is not None
    assert (alarm.joint, alarm.direction) == (True, direction)


def test_no_joint_without_a_known_torque_or_on_the_trunk() -> None:
    unknown = scored([touch(10.0, 11.0, torque={})], begins(10.1)).touches[0].alarm
    trunk = touch(10.0, 11.0, limb="trunk", torque={"HipRoll": 4.0})
    events = [
        event(1, "begin", 10.1, "trunk"),
        event(1, "update", 10.2, "left_arm"),
        event(1, "end", 11.0, "left_arm"),
    ]
    reported = scored([trunk], events).touches[0]
    assert unknown is not None
    assert reported.alarm is not None
    assert reported.later is not None
    for place in (unknown, reported.alarm, reported.later):
        assert (place.joint, place.largest_joint, place.direction) == (None, None, None)
    assert (unknown.limb, reported.alarm.limb, reported.later.limb) == (True, True, False)


def test_a_contact_that_left_the_limb_names_no_joint_of_it() -> None:
    events = [event(1, "begin", 10.1), event(1, "update", 10.2, "head")]
    later = scored([touch(10.0, 11.0)], events).touches[0].later
    assert later is not None
    assert (later.limb, later.joint, later.largest_joint, later.direction) == (
        False,
        False,
        False,
        None,
    )


def test_ends_and_torques() -> None:
    touches = [touch(10.0, 11.0), touch(20.0, 21.0), touch(30.0, 31.0)]
    events = [
        event(1, "begin", 10.1),
        event(1, "end", 10.8),
        event(2, "begin", 10.9),
        event(2, "end", 14.0),
        event(3, "begin", 20.1),
    ]
    pairs = tuple(
        TorqueEstimate(touch=number, joint=SHOULDER, true=-2.0, estimate=-1.5)
        for number in range(3)
    )
    first, second, third = scored(touches, events, torques=pairs).touches
    assert first.end_error == pytest.approx(-0.2)
    assert (first.open, second.open, third.open) == (False, True, False)
    assert (second.end_error, third.end_error) == (None, None)
    assert (first.torques, second.torques, third.torques) == (pairs[:1], pairs[1:2], ())


def test_hours_are_those_without_a_touch_on_the_limb() -> None:
    assert scored([], []).hours == pytest.approx(SECONDS / 3600)
    touches = [
        touch(10.0, 12.0),
        touch(11.0, 12.5),
        touch(11.5, 12.0),
        touch(12.7, 13.0),
        touch(10.0, 11.0, limb="head"),
        touch(38.0, 45.0, limb="trunk"),
    ]
    # Left arm 10 to 13.3, head 10 to 11.3, trunk 38 to the end, of four limbs.
    free = 4 * SECONDS - 3.3 - 1.3 - 2.0
    assert scored(touches, []).hours == pytest.approx(free / 4 / 3600)


@pytest.mark.parametrize(
    ("events", "seconds"),
    [
        ([event(1, "begin", 9.0), event(1, "end", 12.0)], 1.0 + 0.7),
        ([event(1, "begin", 35.0)], 5.0),
        ([event(1, "begin", 35.0, kind="rebound"), event(1, "end", 36.0)], 0.0),
        ([event(1, "begin", 35.0, kind="rebound"), event(1, "update", 36.0)], 4.0),
        ([event(1, "begin", 10.2), event(2, "begin", 10.2, "head"), event(2, "end", 10.7)], 29.2),
        (
            [
                event(1, "begin", 10.1),
                event(1, "update", 10.5, "trunk"),
                event(1, "update", 10.9),
                event(1, "end", 11.2),
            ],
            0.4,
        ),
        # An end is dated back, here before an update.
        (
            [
                event(1, "begin", 20.0),
                event(1, "update", 21.0, joint=ELBOW),
                event(1, "end", 20.9, joint=ELBOW),
            ],
            1.0,
        ),
        # A number that begins again ends the contact that had it.
        ([event(1, "begin", 20.0), event(1, "begin", 21.0), event(1, "end", 21.5)], 1.5),
        ([event(1, "update", 20.0), event(1, "end", 21.0)], 0.0),
    ],
)
def test_seconds_in_contacts_where_nothing_touches(
    events: list[ReportedEvent], seconds: float
) -> None:
    assert scored([touch(10.0, 11.0)], events).idle_contact == pytest.approx(seconds)


def test_events_without_a_begin_are_left_out() -> None:
    result = scored([], [event(1, "update", 20.0), event(1, "end", 21.0)])
    assert (result.right, result.rebounds, result.false) == (0, 0, ())


# -- kinds ------------------------------------------------------------------------------------------------------------


def test_the_kind_is_the_last_one_of_the_contact_that_detected_the_touch() -> None:
    touches = [touch(10.0, 10.1), touch(15.0, 16.0), touch(20.0, 23.0), touch(30.0, 31.0)]
    events = [
        event(1, "begin", 10.05),
        event(1, "end", 10.5, kind="tap"),
        event(2, "begin", 15.1, kind="collision"),
        event(2, "end", 16.3, kind="collision"),
        event(3, "begin", 16.0, kind="grip"),
        event(4, "begin", 20.1),
        event(4, "update", 20.4, kind="push"),
        event(5, "begin", 20.5, "head"),
        event(5, "end", 20.9, "head", kind="tap"),
        event(4, "update", 22.1, kind="hold"),
    ]
    scores = scored(touches, events).touches
    assert [one.true_kind for one in scores] == ["tap", "push", "hold", "push"]
    assert [one.kind for one in scores] == ["tap", "collision", "hold", None]
    # The number of a contact that began again belongs to another one.
    again = [
        event(1, "begin", 10.05),
        event(1, "begin", 15.05),
        event(1, "update", 15.5, kind="push"),
    ]
    assert [one.kind for one in scored(touches, again).touches[:2]] == ["contact", "push"]


@pytest.mark.parametrize(
    ("time", "limb", "row", "kind"),
    [
        (10.9, "left_arm", "handshake", "grip"),
        (12.79, "left_arm", "handshake", "grip"),
        (12.81, "left_arm", "handshake", "push"),
        (10.9, "right_arm", "handshake", "push"),
        (10.9, "left_arm", "grip that pulls", "push"),
    ],
)
def test_a_grip_is_reported_by_a_contact_of_its_own(
    time: float, limb: str, row: str, kind: str
) -> None:
    events = [
        event(1, "begin", 10.1),
        event(1, "end", 10.8, kind="push"),
        event(2, "begin", time, limb, kind="grip"),
        event(2, "end", 12.9, limb, kind="grip"),
    ]
    (one,) = scored([touch(10.0, 12.5, row=row, rise=None)], events).touches
    assert one.kind == kind


# -- failures ---------------------------------------------------------------------------------------------------------


def test_failures_are_counted() -> None:
    good = observed_take([touch(10.0, 11.0)], begins(10.1, 20.0))
    tipped = replace(
        good,
        failure="tipped over",
        touches=(),
        hearings={},
        planned=(("n90", "forearm", 30.0), ("n90", "hand", 30.0)),
    )
    result = score_robot(robot(good, tipped), "ours", LIMBS)
    assert (len(result.takes), result.failed_takes, result.failed_touches) == (1, 1, 2)
    assert (result.takes[0].touches[0].detected, result.takes[0].false_begins) == (True, 1)

    # Its owner has no observer: nothing is detected, and no hours count.
    unobserved = replace(good, hearings={})
    owner = score_robot(robot(unobserved, tipped, failure="no fit"), "ours", LIMBS)
    broken = scored([touch(10.0, 11.0)], begins(10.1), failure="it stopped")
    assert (owner.failure, owner.failed_takes) == ("no fit", 1)
    for score, reason in ((owner.takes[0], "no fit"), (broken, "it stopped")):
        assert (score.failure, score.hours, score.false) == (reason, 0.0, ())
        assert [(t.detected, t.first_limb) for t in score.touches] == [(False, None)]
        assert [(t.true_kind, t.kind) for t in score.touches] == [("push", None)]
    with pytest.raises(UnknownNameError, match="observer 'ous'"):
        score_take(good, "ous", LIMBS)
    with pytest.raises(UnknownNameError):
        score_robot(robot(unobserved), "ours", LIMBS)


def test_callbacks_get_what_is_new() -> None:
    first = contact(1, 2.0)
    other = contact(2, 2.5)

    def update(time: float, **changes: Any) -> Any:
        return replace(first, phase="update", time=time, **changes)

    events = [
        replace(first, time=2.1, detection_time=2.0),
        update(2.2, intensity_deg=9.0, torque=3.0),
        update(2.3, joint="LWristYaw"),
        other,
        update(2.4, joint="LWristYaw", torque=1.0),
        update(2.5, joint="LWristYaw", kind="collision"),
        update(2.6, joint="LWristYaw", kind="collision", direction=-first.direction),
        update(2.7, joint="HeadYaw", limb="head", kind="collision", direction=-first.direction),
        replace(first, phase="end", time=2.65, joint="HeadYaw", limb="head"),
        replace(other, phase="end", time=2.9),
    ]
    result = reported_events(events, range(len(events)))
    assert [(e.id, e.phase, e.time) for e in result] == [
        (1, "begin", 2.1),
        (1, "update", 2.3),
        (2, "begin", 2.5),
        (1, "update", 2.5),
        (1, "update", 2.6),
        (1, "update", 2.7),
        (1, "end", 2.65),
        (2, "end", 2.9),
    ]
    reported = result[5]
    assert (reported.kind, reported.limb, reported.joint) == ("collision", "head", "HeadYaw")
    assert reported.direction == -first.direction
    assert reported.true_torque == 7
