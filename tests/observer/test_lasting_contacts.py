"""A robot that is touched all the time: from the start, by a hand or a load; what it learns, and what it says."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from pepper_driver.observer.constants import HELD_FACTOR, PUSH_TICKS, RISE
from pepper_driver.observer.contact_observer import WEAR_PERIOD
from pepper_driver.observer.interface import Contact, JointState
from pepper_driver.observer.residuals.fusion import FusionParts
from support.fusion import (
    BOUND,
    ELBOW,
    STICK_SLIP,
    Motion,
    check_lives,
    drive,
    fusion_observer,
    swing,
    ticks_of,
)
from support.observer import CYCLE

TOUCHED = 36.0
AFTER = 24.0
WARNING = "left_arm was in contact for most of half a minute"


def touched(torque: float, seconds: float, motion: Motion) -> list[Contact]:
    """Events of an observer with adaptation, of a joint that is touched from before the start."""
    time = np.arange(len(motion)) * CYCLE
    profile = torque * np.clip((seconds - time) / 0.1, 0.0, 1.0)
    start = STICK_SLIP.load_gain * (torque - motion.load[0]) - np.sign(torque) * STICK_SLIP.friction
    made = ticks_of(motion, drive(motion, torque=profile, start=start, steps=20))
    # Loads of the hands widen thresholds at first; this is about spreads.
    observer = fusion_observer(adapt=True, parts=FusionParts(loads=False))
    events: list[Contact] = []
    thresholds = []
    for one in made:
        seen = observer.step(one)
        events += seen.contacts
        if one.measurement.time < seconds:
            thresholds.append(seen.threshold[ELBOW])
    # It grows in a few ticks before the touch is detected, never afterwards.
    assert max(thresholds) < HELD_FACTOR * BOUND * (1.0 + RISE) ** PUSH_TICKS
    assert seen.state[ELBOW] == JointState.FREE
    assert abs(seen.residual[ELBOW]) < 0.5 * BOUND
    check_lives(events)
    return events


@pytest.mark.parametrize("torque", [6.0, -6.0])
def test_a_joint_that_a_hand_has_from_before_the_start_is_in_contact_until_it_leaves(
    torque: float, caplog: pytest.LogCaptureFixture
) -> None:
    motion = swing(TOUCHED + AFTER, rate=1.5)
    with caplog.at_level(logging.WARNING):
        events = touched(torque, TOUCHED, motion)
    real = [c for c in events if c.kind != "rebound"]
    begin, end = (c for c in real if c.phase != "update")
    assert (begin.phase, end.phase) == ("begin", "end")
    assert begin.time < 0.5
    assert end.time == pytest.approx(TOUCHED, abs=0.3)
    assert {c.direction for c in real} == {int(np.sign(torque))}
    # After half a minute it is said that this may be no hand, once.
    assert caplog.text.count(WARNING) == 1
    assert TOUCHED > WEAR_PERIOD * CYCLE


def test_touches_with_pauses_are_not_worth_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        touched(6.0, 0.4 * WEAR_PERIOD * CYCLE, swing(WEAR_PERIOD * CYCLE + 2.0, rate=1.5))
    assert WARNING not in caplog.text
