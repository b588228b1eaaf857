"""Joints of a limb are judged together: small residuals of several joints are a touch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.constants import CORRECTION_TIME
from pepper_driver.observer.contact_observer import limb_numbers
from pepper_driver.observer.interface import Residuals
from pepper_driver.observer.residuals.fusion import FusionGenerator, FusionParts
from support.examples import examples
from support.fusion import ALL_JOINTS, BOUND, ELBOW, NO_JOINT, fusion_generator, touched
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS

WINDOW = SETTINGS.fusion_window
SHOULDER = ROBOT.joint_index("LShoulderRoll")
LIMBS = limb_numbers(ROBOT)
LEFT_ARM = LIMBS[ELBOW] == LIMBS


def held(signal: FusionGenerator, ticks: int = 70, **ratios: Any) -> Residuals:
    """The last of some ticks of a touch that lasts."""
    for k in range(10):
        signal.step(touched(k))
    for k in range(10, 10 + ticks):
        seen = signal.step(touched(k, **ratios))
    return seen


def ratio_of(seen: Residuals) -> FloatArray:
    ratio: FloatArray = np.abs(seen.residual) / seen.threshold
    return ratio


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
    fraction = own[0] / norm
    np.testing.assert_allclose(seen.threshold[LEFT_ARM], fraction * BOUND)
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


def test_a_joint_learns_below_half_of_its_own_threshold_though_its_limb_lowers_it() -> None:
    """Three joints with 0.45 each: 0.45 is more than half of a threshold that is lowered by a factor of sqrt(3)."""
    signal = fusion_generator(limbs=LIMBS)
    for k in range(10 + round(4.0 * CORRECTION_TIME / CYCLE)):
        ratio = 0.45 if k >= 10 else 0.0
        seen = signal.step(touched(k, LShoulderRoll=ratio, LElbowRoll=ratio, LElbowYaw=ratio))
        signal.learn(ALL_JOINTS, NO_JOINT, True)
        if k == 30:
            assert abs(seen.residual[ELBOW]) > 0.55 * seen.threshold[ELBOW]
    assert abs(seen.residual[ELBOW]) < 0.05 * BOUND
