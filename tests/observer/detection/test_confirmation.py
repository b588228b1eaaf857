"""Joints of a limb are judged together, and a push on the base confirms one on a limb."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import CONFIRMING_RATIO, PUSH_TICKS
from pepper_driver.observer.contact_observer import limb_numbers
from pepper_driver.observer.interface import Contact, Residuals
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel
from pepper_driver.observer.residuals.fusion import FusionGenerator, FusionParts
from support.examples import examples
from support.fusion import (
    BOUND,
    ELBOW,
    PER_AMPERE,
    STICK_SLIP,
    fusion_generator,
    fusion_observer,
)
from support.observer import JOINTS, ROBOT, SETTINGS, tick

WINDOW = SETTINGS.fusion_window
SHOULDER, OTHER = ROBOT.joint_index("LShoulderRoll"), ROBOT.joint_index("RElbowRoll")
LIMBS = limb_numbers(ROBOT)
LEFT_ARM = LIMBS[ELBOW] == LIMBS
MATRIX = np.asarray(ROBOT.wheels.matrix)
SPREAD = 0.01
BASE = BaseModel(
    coefficients=((0.0,) * 6,) * (6 * TAPS),
    still=(SPREAD,) * 6,
    moving=(SPREAD,) * 6,
    shaking=(SPREAD,) * 6,
    driving=(SPREAD,) * 6,
)
BEFORE = TAPS + 2 * WINDOW  # ticks after which joints and base are judged
ENDED = round(SETTINGS.merge_gap / ROBOT.cycle)  # ticks after which a contact is over


def touched(index: int, *, base: bool = False, **ratios: float) -> Tick:
    """A tick in which hands push joints off their commands, and their motors against that."""
    error = np.zeros(JOINTS)
    for name, ratio in ratios.items():
        error[ROBOT.joint_index(name)] = ratio * BOUND
    one = tick(index, error)
    one.measurement.current[:] = np.abs(error) / PER_AMPERE
    if base:
        one.measurement.wheel_speed[:] = MATRIX @ np.array([10.0 * SPREAD, 0.0, 0.0])
    return one


def held(signal: FusionGenerator, ticks: int = 2 * BEFORE, **ratios: Any) -> Residuals:
    """The last of some ticks of a touch that lasts."""
    for k in range(10):
        signal.step(touched(k))
    for k in range(10, 10 + ticks):
        seen = signal.step(touched(k, **ratios))
    return seen


def ratio_of(seen: Residuals) -> FloatArray:
    ratio: FloatArray = np.abs(seen.residual) / seen.threshold
    return ratio


# -- limbs ------------------------------------------------------------------------------------------------------------


def test_numbers_of_limbs_are_those_of_the_robot() -> None:
    for joints in ROBOT.limbs.values():
        assert len({LIMBS[ROBOT.joint_index(name)] for name in joints}) == 1
    assert len(set(LIMBS.tolist())) == len(ROBOT.limbs)


def test_two_joints_of_a_limb_find_together_what_neither_finds_alone() -> None:
    ratios: dict[str, Any] = {"LShoulderRoll": 0.8, "LElbowRoll": 0.7}
    seen = held(fusion_generator(limbs=LIMBS), **ratios)
    alone = held(fusion_generator(), **ratios)
    assert ratio_of(alone).max() == pytest.approx(0.8, rel=0.03)
    own = ratio_of(alone)[[SHOULDER, ELBOW]]
    norm = math.hypot(*own)
    assert norm > 1.03
    assert ratio_of(seen)[SHOULDER] == pytest.approx(norm, rel=1e-9)
    # Their order is kept, and other limbs keep their thresholds.
    share = own[0] / norm
    np.testing.assert_allclose(seen.threshold[LEFT_ARM], share * BOUND)
    np.testing.assert_allclose(seen.threshold[~LEFT_ARM], BOUND)
    np.testing.assert_array_equal(seen.residual, alone.residual)


def test_joints_of_different_limbs_find_nothing_together() -> None:
    seen = held(fusion_generator(limbs=LIMBS), LElbowRoll=0.9, RElbowRoll=0.9)
    np.testing.assert_allclose(seen.threshold, BOUND)
    assert ratio_of(seen).max() < 1.0


def test_without_the_part_each_joint_is_judged_alone() -> None:
    signal = fusion_generator(limbs=LIMBS, parts=FusionParts(limbs=False))
    np.testing.assert_allclose(held(signal, LShoulderRoll=0.8, LElbowRoll=0.7).threshold, BOUND)


@examples(40)
@given(st.lists(st.floats(-3.0, 3.0), min_size=JOINTS, max_size=JOINTS))
def test_the_largest_ratio_of_a_limb_becomes_the_norm_and_no_threshold_rises(
    ratios: list[float],
) -> None:
    seen = held(
        fusion_generator(limbs=LIMBS),
        WINDOW + 8,
        **dict(zip(ROBOT.joint_names, ratios, strict=True)),
    )
    assert (seen.threshold <= BOUND * (1.0 + 1e-12)).all()
    for number in set(LIMBS.tolist()):
        limb = number == LIMBS
        own = np.abs(seen.residual[limb]) / BOUND
        assert np.ptp(seen.threshold[limb]) < 1e-15
        if own.max() > 0.0:
            assert ratio_of(seen)[limb].max() == pytest.approx(np.linalg.norm(own))


def test_a_joint_that_cannot_be_judged_adds_nothing_to_its_limb() -> None:
    signal = fusion_generator(limbs=LIMBS)
    for k in range(60):
        ratio = 0.9 if k > 10 else 0.0
        one = touched(k, LElbowRoll=ratio, LShoulderRoll=ratio)
        one.measurement.position[SHOULDER] = math.nan if k > 8 else one.sent.position[SHOULDER]
        seen = signal.step(one)
    assert np.isnan(seen.threshold[SHOULDER])
    assert seen.threshold[ELBOW] == pytest.approx(BOUND)


# -- confirmation -----------------------------------------------------------------------------------------------------


def thresholds(pushes: list[bool], *, parts: FusionParts | None = None) -> FloatArray:
    """Threshold over that of the joint alone, by tick, of the elbow; the base is pushed in some of the ticks."""
    observer = fusion_observer(base=BASE, parts=parts)
    for k in range(BEFORE):
        observer.step(touched(k, LElbowRoll=0.1 if k >= BEFORE - WINDOW else 0.0))
    found = []
    for k, push in enumerate(pushes):
        seen = observer.step(touched(BEFORE + k, base=push, LElbowRoll=0.1))
        # Only the limb that shows most.
        assert seen.threshold[ROBOT.joint_index("RElbowRoll")] == pytest.approx(BOUND)
        found.append(seen.threshold[ELBOW] / BOUND)
    return np.array(found)


def test_a_push_on_the_base_lowers_thresholds_for_a_while() -> None:
    factor = thresholds([False] * 5 + [True] * 100 + [False] * 50)
    first = 5 + WINDOW // 2  # of the median
    expected = np.ones(len(factor))
    expected[first : first + PUSH_TICKS] = CONFIRMING_RATIO
    np.testing.assert_allclose(factor, expected)


@pytest.mark.parametrize(("pause", "again"), [(PUSH_TICKS + 4, False), (ENDED + PUSH_TICKS, True)])
def test_only_a_push_after_quiet_does_so(pause: int, again: bool) -> None:
    """After the contact of the one before: a hand that lets go shakes the base as well."""
    push = [True] * (2 * PUSH_TICKS)
    factor = thresholds([*push, *[False] * pause, *push])
    confirmed = int(np.count_nonzero(factor < 0.99))
    assert confirmed == (2 if again else 1) * PUSH_TICKS


def test_without_the_part_a_push_on_the_base_lowers_nothing() -> None:
    np.testing.assert_allclose(thresholds([True] * 40, parts=FusionParts(confirmation=False)), 1.0)


def begins(
    ratio: float, push: bool, *, earlier: int = 0, confirmation: bool = True
) -> list[Contact]:
    """Begins of a touch; the joint shows it some ticks earlier than the base."""
    observer = fusion_observer(base=BASE, parts=FusionParts(confirmation=confirmation))
    events: list[Contact] = []
    for k in range(BEFORE + 100):
        now = BEFORE <= k < BEFORE + 60
        shown = BEFORE - earlier <= k < BEFORE + 60
        one = touched(k, base=push and now, **({"LElbowRoll": ratio} if shown else {}))
        events += observer.step(one).contacts
    return [event for event in events if event.phase == "begin"]


def test_the_base_confirms_the_limb_that_shows_most_and_no_other() -> None:
    observer = fusion_observer(base=BASE)
    events: list[Contact] = []
    for k in range(BEFORE + 100):
        now = BEFORE <= k < BEFORE + 60
        both = {"LElbowRoll": 0.8, "RElbowRoll": 0.7} if now else {}
        events += observer.step(touched(k, base=now, **both)).contacts
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
    observer = fusion_observer(adapt=True, base=replace(BASE))
    for k in range(BEFORE):
        observer.step(touched(k))
    for k in range(100):
        observer.step(touched(BEFORE + k, base=k < 20))
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
        one = touched(k, base=base and lifted, LElbowRoll=error)
        one.reference.load_torque[ELBOW] = 1.5 * BOUND / STICK_SLIP.load_gain
        limbs += [contact.limb for contact in observer.step(one).contacts]
    assert ("left_arm" in limbs) == base
