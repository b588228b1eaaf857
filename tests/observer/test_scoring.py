"""Scoring on hand-made timelines."""

from dataclasses import replace

import pytest

from pepper_driver.config import load_robot
from pepper_driver.observer import Contact, Push, score

ROBOT = load_robot()

PUSH = Push(
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
    joint="LShoulderRoll",
    link="LBicep",
    direction=1,
    intensity=3.0,
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
    return len(result.felt), len(result.missed), len(result.false), len(result.rebounds)


@pytest.mark.parametrize(
    ("contacts", "expected"),
    [
        ((), (0, 1, 0, 0)),
        ((at(10.2),), (1, 0, 0, 0)),
        ((at(10.0),), (1, 0, 0, 0)),
        ((at(9.99),), (0, 1, 1, 0)),  # before the force
        ((at(11.14),), (1, 0, 0, 0)),  # within the grace after the release
        ((at(11.2),), (0, 1, 0, 1)),  # too late to be felt, early enough to be the swing back
        ((at(11.81),), (0, 1, 1, 0)),  # too late to be anything
        ((at(10.2), at(11.3)), (1, 0, 0, 1)),
        ((at(10.2), at(10.8)), (1, 0, 0, 0)),  # the same push felt twice is one push felt
        ((at(10.2, kind="rebound"),), (0, 1, 0, 1)),  # called a rebound: not felt
        ((at(10.2, kind="collision"),), (1, 0, 0, 0)),
        ((at(10.2, phase="update"), at(10.3, phase="end")), (0, 1, 0, 0)),
        ((at(10.2, joint="LElbowRoll"),), (1, 0, 0, 0)),  # the same chain
        ((at(10.2, joint="RShoulderRoll"),), (0, 1, 1, 0)),  # the other arm
        ((at(10.2, joint=None),), (0, 1, 1, 0)),
        ((at(20.0, kind="rebound"),), (0, 1, 1, 0)),  # a rebound of nothing is false
    ],
)
def test_one_push(contacts: tuple[Contact, ...], expected: tuple[int, int, int, int]) -> None:
    assert outcome(*contacts) == expected


def test_a_second_contact_during_a_push_is_a_repetition() -> None:
    result = score([PUSH], [at(10.2), at(10.8)], ROBOT)
    assert [c.time for c in result.repeated] == [10.8]


def test_the_delay_counts_from_the_force() -> None:
    assert score([PUSH], [at(10.25)], ROBOT).felt[0].delay == pytest.approx(0.25)


def test_two_pushes_close_together_keep_their_contacts() -> None:
    second = replace(PUSH, onset=11.5, release=12.0)
    result = score([PUSH, second], [at(10.2), at(11.6)], ROBOT)
    assert [f.contact.time for f in result.felt] == [10.2, 11.6]
    assert [f.push.onset for f in result.felt] == [10.0, 11.5]
