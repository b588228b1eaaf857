"""Scoring on hand-made timelines."""

from dataclasses import replace

import pytest

from pepper_driver.config import load_robot
from pepper_driver.observer import Contact, KnownPush, score
from pepper_driver.observer.scoring import group_events

ROBOT = load_robot()

PUSH = KnownPush(
    joint="LShoulderRoll",
    link="LBicep",
    direction=1,
    force=12.0,
    torque=2.0,
    degrees=4.0,
    onset=10.0,
    release=11.0,
    moving=False,
)
CONTACT = Contact(
    id=1,
    phase="begin",
    kind="contact",
    limb="left_arm",
    joint="LShoulderRoll",
    shown_by="LShoulderRoll",
    link="LBicep",
    direction=1,
    intensity_deg=3.0,
    torque=None,
    torque_std=None,
    onset_time=10.1,
    detection_time=10.2,
    time=10.2,
)


def at(time: float, **changes: object) -> Contact:
    return replace(CONTACT, detection_time=time, time=time, **changes)  # type: ignore[arg-type]


def outcome(*contacts: Contact) -> tuple[int, int, int, int]:
    result = score([PUSH], contacts, ROBOT)
    return len(result.detected), len(result.missed), len(result.false), len(result.rebounds)


@pytest.mark.parametrize(
    ("contacts", "expected"),
    [
        ((), (0, 1, 0, 0)),
        ((at(10.2),), (1, 0, 0, 0)),
        ((at(10.0),), (1, 0, 0, 0)),
        ((at(9.99),), (0, 1, 1, 0)),  # before the force
        ((at(11.14),), (1, 0, 0, 0)),  # within the grace after the release
        ((at(11.2),), (0, 1, 0, 1)),  # too late to be detected, early enough to be the swing back
        ((at(11.81),), (0, 1, 1, 0)),  # too late to be anything
        ((at(10.2), at(11.3)), (1, 0, 0, 1)),
        ((at(10.2), at(10.8)), (1, 0, 0, 0)),  # the same push detected twice is one push detected
        ((at(10.2, kind="rebound"),), (0, 1, 0, 1)),  # called a rebound: not detected
        ((at(10.2, kind="collision"),), (1, 0, 0, 0)),
        ((at(10.2, phase="update"), at(10.3, phase="end")), (0, 1, 0, 0)),
        ((at(10.2, joint="LElbowRoll"),), (1, 0, 0, 0)),  # the same chain
        ((at(10.2, joint="RShoulderRoll"),), (0, 1, 1, 0)),  # the other arm
        (
            (at(10.2, joint=None),),
            (0, 1, 0, 0),
        ),  # the trunk carries the arm: not detected, not false
        ((at(10.2, joint="HipRoll"),), (0, 1, 0, 0)),
        ((at(11.5, joint=None),), (0, 1, 0, 1)),  # and swings back with it
        ((at(9.9, joint=None),), (0, 1, 1, 0)),
        ((at(10.2, joint="HeadYaw"),), (0, 1, 1, 0)),
        ((at(20.0, kind="rebound"),), (0, 1, 1, 0)),  # a rebound of nothing is false
    ],
)
def test_one_push(contacts: tuple[Contact, ...], expected: tuple[int, int, int, int]) -> None:
    assert outcome(*contacts) == expected


def test_a_second_contact_during_a_push_is_a_repetition() -> None:
    result = score([PUSH], [at(10.2), at(10.8)], ROBOT)
    assert [c.time for c in result.repeated] == [10.8]


def test_the_delay_counts_from_the_force() -> None:
    assert score([PUSH], [at(10.25)], ROBOT).detected[0].delay == pytest.approx(0.25)


def test_two_pushes_close_together_keep_their_contacts() -> None:
    second = replace(PUSH, onset=11.5, release=12.0)
    result = score([PUSH, second], [at(10.2), at(11.6)], ROBOT)
    assert [f.contact.time for f in result.detected] == [10.2, 11.6]
    assert [f.push.onset for f in result.detected] == [10.0, 11.5]


def reported(number: int, *events: tuple[str, float, str | None]) -> list[Contact]:
    """The events of one contact: phase, time, joint."""
    begin = events[0][1]
    return [
        replace(at(begin, id=number, joint=joint, phase=phase), time=time)
        for phase, time, joint in events
    ]


@pytest.mark.parametrize(
    ("events", "detected", "false"),
    [
        (
            (("begin", 10.2, None), ("update", 10.25, "LElbowRoll")),
            1,
            0,
        ),  # the update finds the arm
        ((("begin", 10.2, None), ("update", 11.2, "LElbowRoll")), 0, 0),  # too late
        ((("begin", 10.2, "RElbowRoll"), ("update", 10.3, "LElbowRoll")), 1, 0),
        ((("begin", 10.2, "RElbowRoll"), ("update", 10.3, None)), 0, 1),  # it was on the other arm
        ((("begin", 10.2, None), ("update", 10.3, "RElbowRoll")), 0, 1),
        ((("begin", 9.9, "LElbowRoll"), ("update", 10.3, "LElbowRoll")), 0, 1),  # began before
    ],
)
def test_updates_move_a_contact(
    events: tuple[tuple[str, float, str | None], ...], detected: int, false: int
) -> None:
    result = score([PUSH], reported(1, *events), ROBOT)
    assert (len(result.detected), len(result.false)) == (detected, false)
    assert len(result.detected) + len(result.missed) == 1


def test_what_is_reported_of_a_contact_over_time() -> None:
    events = reported(
        3, ("begin", 10.2, None), ("update", 10.25, "LElbowRoll"), ("end", 10.6, None)
    )
    detected = score([PUSH], events, ROBOT).detected[0]
    assert detected.contact.joint is None
    assert [detected.track.at(t).joint for t in (10.2, 10.24, 10.25, 20.0)] == [
        None,
        None,
        "LElbowRoll",
        "LElbowRoll",
    ]
    assert detected.track.end == 10.6


@pytest.mark.parametrize(
    ("joint", "outcome"),
    [(None, (1, 0)), ("HipRoll", (1, 0)), ("LShoulderRoll", (0, 1)), ("HeadYaw", (0, 1))],
)
def test_a_push_on_the_trunk(joint: str | None, outcome: tuple[int, int]) -> None:
    result = score([replace(PUSH, joint=None, link="torso")], [at(10.2, joint=joint)], ROBOT)
    assert (len(result.detected), len(result.false)) == outcome


def test_two_pushes_at_once_each_have_their_contact() -> None:
    other = replace(PUSH, joint="RElbowRoll", link="RForeArm")
    contacts = [at(10.3, id=1), at(10.2, id=2, joint="RElbowYaw"), at(10.4, id=3, joint=None)]
    result = score([PUSH, other], contacts, ROBOT)
    assert [f.contact.id for f in result.detected] == [1, 2]
    assert [c.id for c in result.on_trunk] == [3]
    assert not result.missed
    assert not result.false


def test_alarms_with_a_short_gap_are_one_false_run() -> None:
    def run(number: int, begin: float, end: float, joint: str = "HeadYaw") -> list[Contact]:
        return reported(number, ("begin", begin, joint), ("end", end, joint))

    close = [*run(1, 1.0, 1.5), *run(2, 1.7, 2.0), *run(3, 2.2, 2.5)]
    result = score([], [*close, *run(4, 2.9, 3.0), *run(5, 3.1, 3.2, "LElbowRoll")], ROBOT)
    assert [c.id for c in result.false] == [1, 4, 5]
    assert [c.id for c in result.repeated] == [2, 3]


def test_what_goes_on_after_a_push_is_no_new_alarm() -> None:
    contacts = [
        *reported(1, ("begin", 10.2, "LElbowRoll"), ("end", 11.9, "LElbowRoll")),
        *reported(2, ("begin", 12.1, "LElbowRoll"), ("end", 12.2, "LElbowRoll")),
        *reported(3, ("begin", 12.6, "LElbowRoll")),
    ]
    assert [c.id for c in score([PUSH], contacts, ROBOT).false] == [3]


def test_a_false_alarm_shortly_before_a_push_does_not_hide_it() -> None:
    contacts = [
        *reported(1, ("begin", 9.5, "LElbowRoll"), ("end", 9.9, "LElbowRoll")),
        *reported(2, ("begin", 10.1, "LElbowRoll")),
    ]
    result = score([PUSH], contacts, ROBOT)
    assert [f.contact.id for f in result.detected] == [2]
    assert [c.id for c in result.false] == [1]


def test_events_without_a_begin_are_left_out() -> None:
    assert group_events([at(1.0, phase="update"), at(2.0, phase="end")]) == ()
