"""A touch on one part of the robot shakes the others: rules on their own, then in an observer."""

from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.config.arrays import BoolArray
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    HELD_FACTOR,
    PUSH_TICKS,
    SETTLING_TICKS,
    SHAKING_ACCELERATION,
)
from pepper_driver.observer.detection.disturbance import Disturbance
from pepper_driver.observer.interface import Contact
from pepper_driver.observer.models.fusion_model import TAPS
from support.fusion import BOUND, ELBOW, fusion_observer, still_base, touched
from support.observer import ROBOT, SETTINGS

LIMBS = np.array([0, 0, 1, 1, 2, 2])
CYCLE = 0.012
SWING_TICKS = round(CORRECTION_TIME / CYCLE)


def joints(*numbers: int) -> BoolArray:
    chosen = np.zeros(len(LIMBS), dtype=np.bool_)
    chosen[list(numbers)] = True
    return chosen


def take_in(target: Disturbance, *shown: int, touched: bool = True) -> None:
    """A tick in which these joints show a touch."""
    target.step(~joints(*shown), joints(), not touched)


def test_a_touch_on_a_limb_shakes_all_other_parts_at_once_and_as_long_as_it_lasts() -> None:
    target = Disturbance(LIMBS, CYCLE)
    for _ in range(3):
        take_in(target, 3)
        np.testing.assert_array_equal(target.joints, joints(0, 1, 4, 5))
    take_in(target, touched=False)
    assert target.joints is None


def test_touched_limbs_are_not_shaken_by_each_other() -> None:
    target = Disturbance(LIMBS, CYCLE)
    take_in(target, 2, 4)
    np.testing.assert_array_equal(target.joints, joints(0, 1))


def test_a_joint_that_cannot_be_judged_shows_no_touch() -> None:
    target = Disturbance(LIMBS, CYCLE)
    target.step(~joints(2, 4), joints(4), False)
    np.testing.assert_array_equal(target.joints, joints(0, 1, 4, 5))


@pytest.mark.parametrize(("shown", "shaken"), [((), (0, 1, 2, 3, 4, 5)), ((1,), (2, 3, 4, 5))])
def test_a_touch_on_the_trunk_shakes_parts_that_have_not_shown_it_meanwhile(
    shown: tuple[int, ...], shaken: tuple[int, ...]
) -> None:
    """By the base alone, or a joint of the legs."""
    target = Disturbance(LIMBS, CYCLE)
    for _ in range(PUSH_TICKS):
        take_in(target, *shown)
        assert target.joints is None
    take_in(target, *shown)
    np.testing.assert_array_equal(target.joints, joints(*shaken))


def test_the_base_swings_for_a_while_after_a_touch_and_not_during_it() -> None:
    target = Disturbance(LIMBS, CYCLE)
    take_in(target, touched=False)
    assert not target.base
    for _ in range(2):  # a touch during the swing begins it again
        take_in(target, 3)
        assert not target.base
        found = []
        for _ in range(SWING_TICKS):
            take_in(target, touched=False)
            found.append(target.base)
        assert found == [True] * (SWING_TICKS - 1) + [False]


def test_reset_forgets_all_touches() -> None:
    target = Disturbance(LIMBS, CYCLE)
    take_in(target, 3)
    target.reset()
    assert target.joints is None
    take_in(target, touched=False)
    assert not target.base


# -- in the observer --------------------------------------------------------------------------------------------------

HEAD = ROBOT.joint_index("HeadYaw")
SPREAD = 0.01
BASE, PUSH = still_base(SPREAD), 10.0 * SPREAD
"""Speed that is ten of its spreads; the threshold of the base is five."""
BEFORE = TAPS + 2 * SETTINGS.fusion_window


def test_thresholds_are_higher_while_joints_shake_the_robot_but_not_of_what_is_touched() -> None:
    observer = fusion_observer(base=BASE)
    for k in range(BEFORE):
        observer.step(touched(k, LElbowRoll=2.0 if k > BEFORE // 2 else 0.0))
    found = []
    for k in range(TAPS + SETTLING_TICKS + 3):
        one = touched(BEFORE + k, LElbowRoll=2.0)
        if k == 1:
            one.reference.acceleration[HEAD] = 1.1 * SHAKING_ACCELERATION
        found.append(observer.step(one).threshold / BOUND)
    shaken = np.array(found)
    np.testing.assert_allclose(shaken[1:-3, ELBOW], shaken[0, ELBOW])
    # The arm is touched, and shakes the head in any case.
    np.testing.assert_allclose(shaken[:, HEAD], HELD_FACTOR)

    observer = fusion_observer(base=BASE)
    found = []
    for k in range(BEFORE + TAPS + SETTLING_TICKS + 3):
        one = touched(k)
        if k == BEFORE:
            one.reference.acceleration[HEAD] = 1.1 * SHAKING_ACCELERATION
        found.append(observer.step(one).threshold[ELBOW] / BOUND)
    expected = np.ones(len(found))
    expected[BEFORE : BEFORE + TAPS + SETTLING_TICKS] = HELD_FACTOR
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize(("pause", "heard"), [(10, False), (SWING_TICKS + 10, True)])
def test_a_base_that_swings_after_a_touch_needs_a_stronger_push(pause: int, heard: bool) -> None:
    observer = fusion_observer(base=BASE)
    k = 0
    events: list[Contact] = []

    def play(ticks: int, base: float = 0.0, **ratios: float) -> None:
        nonlocal k
        for _ in range(ticks):
            events.extend(observer.step(touched(k, base=base, **ratios)).contacts)
            k += 1

    play(BEFORE)
    play(40, LElbowRoll=2.0)
    while not events or events[-1].phase != "end":
        play(1)
    # Longer than a limb that swings back excuses the trunk.
    play(round(SETTINGS.rebound_window / CYCLE) + pause)
    before = len(events)
    play(20, base=0.6 * PUSH)
    play(40)
    assert any(e.limb == "trunk" for e in events[before:]) == heard
