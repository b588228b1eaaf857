"""A push on the base confirms one on a limb: rules on their own, then in an observer."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.constants import CONFIRMING_RATIO, HELD_FACTOR, PUSH_TICKS
from pepper_driver.observer.detection.confirmation import BaseConfirmation
from pepper_driver.observer.interface import Contact
from pepper_driver.observer.models.fusion_model import TAPS
from pepper_driver.observer.residuals.fusion import FusionParts
from support.fusion import BOUND, ELBOW, STICK_SLIP, fusion_observer, still_base, touched
from support.observer import ROBOT, SETTINGS

WINDOW = SETTINGS.fusion_window
SPREAD = 0.01
BASE, PUSH = still_base(SPREAD), 10.0 * SPREAD
BEFORE = TAPS + 2 * WINDOW  # ticks after which joints and base are judged
ENDED = round(SETTINGS.merge_gap / ROBOT.cycle)  # ticks after which a contact is over


LIMBS = np.array([0, 0, 1, 1, 2, 2])
YES = np.ones(len(LIMBS), dtype=np.bool_)
QUIET, PUSHED = 0.5, -1.5
"""Residuals of the base in units of its threshold."""


def confirms(target: BaseConfirmation, residual: float, ticks: int = 1) -> list[bool]:
    return [target.step(residual) for _ in range(ticks)]


def test_a_push_confirms_for_twelve_ticks_and_is_remembered_as_long() -> None:
    target = BaseConfirmation(LIMBS)
    assert confirms(target, QUIET, 3) == [False] * 3
    assert not target.pushed
    found = []
    for k in range(PUSH_TICKS + 3):
        found.append((target.step(QUIET if k else PUSHED), target.pushed))
    assert found == [(True, True)] * PUSH_TICKS + [(False, False)] * 3


@pytest.mark.parametrize("value", [QUIET, math.nan])
@pytest.mark.parametrize(("pause", "again"), [(PUSH_TICKS - 1, False), (PUSH_TICKS, True)])
def test_a_push_soon_after_another_one_confirms_nothing(
    value: float, pause: int, again: bool
) -> None:
    target = BaseConfirmation(LIMBS)
    confirms(target, PUSHED, 2 * PUSH_TICKS)
    assert confirms(target, value, pause) == [False] * pause
    assert confirms(target, PUSHED, 2) == [again] * 2


def test_a_push_while_the_robot_is_touched_confirms_nothing() -> None:
    target = BaseConfirmation(LIMBS)
    target.untouched = False
    assert confirms(target, PUSHED, PUSH_TICKS) == [False] * PUSH_TICKS
    target.reset()
    assert confirms(target, PUSHED) == [True]


def lowered(
    residual: list[float], *, stale: int | None = None, blind: int | None = None
) -> set[int]:
    """Joints whose thresholds of 1 are lower; one joint has shown the same for long, one cannot be judged."""
    fresh, cannot = YES.copy(), ~YES
    if stale is not None:
        fresh[stale] = False
    if blind is not None:
        cannot[blind] = True
    threshold = np.ones(len(LIMBS))
    BaseConfirmation(LIMBS).lower(threshold, np.array(residual), fresh, cannot)
    assert set(threshold.tolist()) <= {1.0, CONFIRMING_RATIO}
    return set(np.flatnonzero(threshold < 1.0).tolist())


def test_the_limb_that_shows_most_has_lower_thresholds_whatever_the_trunk_shows() -> None:
    assert lowered([0.9, -0.9, 0.1, 0.2, 0.0, -0.3]) == {4, 5}
    assert lowered([0.9, -0.9, 0.1, -0.4, 0.0, -0.3]) == {2, 3}
    assert lowered([0.9, -0.9, 0.0, 0.0, 0.0, 0.0]) == set()


def test_joints_that_have_shown_it_for_long_or_are_blind_do_not_count() -> None:
    assert lowered([0.0, 0.0, 0.1, 0.2, 0.0, 0.3], stale=5) == {2, 3}
    assert lowered([0.0, 0.0, 0.1, 0.2, 0.0, 0.3], stale=4) == {5}
    assert lowered([0.0, 0.0, 0.1, 0.2, 0.0, math.nan], blind=5) == {2, 3}


# -- in the observer --------------------------------------------------------------------------------------------------


def thresholds(pushes: list[bool], *, parts: FusionParts | None = None) -> FloatArray:
    """Threshold over that of the joint alone, by tick, of the elbow; the base is pushed in some of the ticks."""
    observer = fusion_observer(base=BASE, parts=parts)
    for k in range(BEFORE):
        observer.step(touched(k, LElbowRoll=0.1 if k >= BEFORE - WINDOW else 0.0))
    found = []
    for k, push in enumerate(pushes):
        seen = observer.step(touched(BEFORE + k, base=PUSH * push, LElbowRoll=0.1))
        # Only the limb that shows most.
        assert seen.threshold[ROBOT.joint_index("RElbowRoll")] >= 0.999 * BOUND
        found.append(seen.threshold[ELBOW] / BOUND)
    return np.array(found)


def test_a_push_on_the_base_lowers_thresholds_for_a_while() -> None:
    factor = thresholds([False] * 5 + [True] * 100 + [False] * 50)
    first = 5 + WINDOW // 2  # of the median
    expected = np.ones(len(factor))
    expected[first : first + PUSH_TICKS] = CONFIRMING_RATIO
    # Of the trunk alone: it shakes the limbs until its contact is over.
    expected[first + PUSH_TICKS + 1 : first + 100 + ENDED + 2] = HELD_FACTOR
    np.testing.assert_allclose(factor, expected)


@pytest.mark.parametrize(("pause", "again"), [(PUSH_TICKS + 4, False), (ENDED + PUSH_TICKS, True)])
def test_only_a_push_after_quiet_does_so(pause: int, again: bool) -> None:
    """After the contact of the one before: a hand that lets go shakes the base as well."""
    push = [True] * (2 * PUSH_TICKS)
    factor = thresholds([*push, *[False] * pause, *push])
    confirmed = int(np.count_nonzero(factor < 0.99))
    assert confirmed == (2 if again else 1) * PUSH_TICKS


def test_without_the_part_a_push_on_the_base_lowers_nothing() -> None:
    factor = thresholds([True] * 40, parts=FusionParts(confirmation=False))
    np.testing.assert_allclose(factor[: PUSH_TICKS + WINDOW // 2 + 1], 1.0)
    np.testing.assert_allclose(factor[PUSH_TICKS + WINDOW // 2 + 1 :], HELD_FACTOR)


def begins(
    ratio: float, push: bool, *, earlier: int = 0, confirmation: bool = True
) -> list[Contact]:
    """Begins of a touch; the joint shows it some ticks earlier than the base."""
    observer = fusion_observer(base=BASE, parts=FusionParts(confirmation=confirmation))
    events: list[Contact] = []
    for k in range(BEFORE + 100):
        now = BEFORE <= k < BEFORE + 60
        shown = BEFORE - earlier <= k < BEFORE + 60
        one = touched(k, base=PUSH * (push and now), **({"LElbowRoll": ratio} if shown else {}))
        events += observer.step(one).contacts
    return [event for event in events if event.phase == "begin"]


def test_the_base_confirms_the_limb_that_shows_most_and_no_other() -> None:
    observer = fusion_observer(base=BASE)
    events: list[Contact] = []
    for k in range(BEFORE + 100):
        now = BEFORE <= k < BEFORE + 60
        both = {"LElbowRoll": 0.8, "RElbowRoll": 0.7} if now else {}
        events += observer.step(touched(k, base=PUSH * now, **both)).contacts
    assert {event.limb for event in events} == {"left_arm"}


def test_a_weak_touch_on_a_limb_that_moves_the_base_is_found_on_the_limb() -> None:
    assert begins(0.7, push=False) == []
    [found] = begins(0.7, push=True)
    assert (found.limb, found.link) == ("left_arm", "LForeArm")
    [without] = begins(0.7, push=True, confirmation=False)
    assert without.limb == "trunk"
    # One that hardly shows on the limb is one on the base.
    [weak] = begins(0.5 * CONFIRMING_RATIO, push=True)
    assert weak.limb == "trunk"


@pytest.mark.parametrize(
    ("earlier", "limb"), [(PUSH_TICKS - 4, "left_arm"), (PUSH_TICKS + 4, "trunk")]
)
def test_what_a_joint_shows_for_long_is_not_confirmed(earlier: int, limb: str) -> None:
    """A worn wrist rests off its place, and a base that begins to drive looks pushed: no one touches the arm."""
    [found] = begins(0.7, push=True, earlier=earlier)
    assert found.limb == limb


def test_the_lower_threshold_is_not_the_one_that_learns() -> None:
    """Else a residual of an ordinary size would count as large there, or a threshold stay low."""
    observer = fusion_observer(adapt=True, base=BASE)
    for k in range(BEFORE):
        observer.step(touched(k))
    for k in range(100):
        observer.step(touched(BEFORE + k, base=PUSH * (k < 20)))
    seen = observer.step(touched(BEFORE + 100))
    np.testing.assert_allclose(seen.threshold, BOUND, rtol=0.01)


# -- a sudden push ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", [True, False])
def test_a_current_may_reverse_at_once_while_the_base_shows_a_push(base: bool) -> None:
    """The motor carries a load; a hand lifts it from one sample to the next, so that the motor pulls down."""
    observer, limbs = fusion_observer(base=BASE), []
    for k in range(BEFORE + 40):
        lifted = k >= BEFORE
        # 0.03 rad of load; lifted, the motor gives 0.02 to the other side, from whose size no sign follows.
        error = -1.0 if lifted else 1.5
        one = touched(k, base=PUSH * (base and lifted), LElbowRoll=error)
        one.reference.load_torque[ELBOW] = 1.5 * BOUND / STICK_SLIP.load_gain
        limbs += [contact.limb for contact in observer.step(one).contacts]
    assert ("left_arm" in limbs) == base
