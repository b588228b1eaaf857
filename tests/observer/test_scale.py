"""The scale of the thresholds: a running median, against the median of the samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from observer_cases import CYCLE, FloatArray

from pepper_driver.observer.scale import LARGEST, WARM_UP, BoundScale

IDENTIFIED = 5e-4
WARM = round(WARM_UP / CYCLE)
COUNTS = np.array([True])


def scale(start: float = 3.0) -> BoundScale:
    return BoundScale(np.array([IDENTIFIED]), np.array([start]), CYCLE)


def learn(target: BoundScale, residuals: FloatArray) -> list[float]:
    """Factors after each sample."""
    factors = []
    for value in residuals:
        target.learn(np.array([value]), COUNTS)
        factors.append(float(target.factor[0]))
    return factors


def residuals(n: int, median: float, seed: int = 0) -> FloatArray:
    """Of both signs, with this median of their size."""
    drawn = np.random.default_rng(seed).standard_normal(n)
    return median / 0.6745 * drawn


@pytest.mark.parametrize("ratio", [1.5, 4.0, 12.0])
def test_converges_to_the_ratio_of_the_medians(ratio: float) -> None:
    for start in (0.6 * ratio, 1.7 * ratio):
        factors = learn(scale(start), residuals(WARM, ratio * IDENTIFIED))
        assert np.mean(factors[-100:]) == pytest.approx(ratio, rel=0.12)


def test_a_third_of_touches_moves_it_no_further_than_a_median() -> None:
    """Three of ten samples from elsewhere: at worst the 5/7 quantile of the others."""
    rng = np.random.default_rng(1)
    ratio = 2.0
    sizes = rng.uniform(0.0, 2 * ratio * IDENTIFIED, WARM)
    sizes[rng.uniform(size=WARM) < 0.3] = 1.0
    factor = np.mean(learn(scale(), sizes)[-200:])
    assert ratio < factor < 1.15 * ratio * (5 / 7) / 0.5


@given(st.lists(st.floats(-1.0, 1.0), max_size=60), st.floats(0.0, 100.0))
def test_is_never_below_1_nor_beyond_the_largest(values: list[float], start: float) -> None:
    target = scale(start)
    assert 1.0 <= target.factor[0] <= LARGEST
    for factor in learn(target, np.array(values)):
        assert 1.0 <= factor <= LARGEST


def test_a_quiet_joint_comes_down_to_1_and_no_further() -> None:
    factors = learn(scale(), residuals(2 * WARM, 0.2 * IDENTIFIED))
    assert factors[0] > 2.9
    assert factors[-1] == 1.0


def test_learns_fast_at_first_and_slowly_afterwards() -> None:
    target = scale(1.0)
    factors = learn(target, residuals(WARM - 1, 3.0 * IDENTIFIED))
    seconds = CYCLE * next(k for k, factor in enumerate(factors) if factor > 2.0)
    assert seconds < 8.0
    # From then on, ten seconds of anything change little.
    before = learn(target, residuals(2, 3.0 * IDENTIFIED))[-1]
    after = learn(target, np.full(round(10.0 / CYCLE), 1.0))[-1]
    assert before < after < 1.15 * before


def test_only_what_counts_is_learned() -> None:
    target = BoundScale(np.full(2, IDENTIFIED), np.full(2, 3.0), CYCLE)
    for _ in range(300):
        target.learn(np.full(2, 0.1), np.array([True, False]))
    assert target.factor[0] > 5.0
    assert target.factor[1] == 3.0
    # Warm is who has moved: the other still learns fast.
    for _ in range(WARM):
        target.learn(np.full(2, 0.1), np.array([True, False]))
    before = target.factor.copy()
    for _ in range(20):
        target.learn(np.zeros(2), np.array([False, True]))
    assert target.factor[0] == before[0]
    assert target.factor[1] < 0.96 * before[1]


def test_joints_without_a_model_disturb_no_other() -> None:
    target = BoundScale(np.array([np.nan, IDENTIFIED]), np.array([3.0, 3.0]), CYCLE)
    for _ in range(50):
        target.learn(np.array([np.nan, 0.1]), np.array([False, True]))
    assert np.isnan(target.factor[0])
    assert target.factor[1] > 3.0


def test_reset_forgets() -> None:
    target = scale()
    first = learn(target, residuals(500, 9 * IDENTIFIED))
    target.reset()
    assert target.factor[0] == 3.0
    assert learn(target, residuals(500, 9 * IDENTIFIED)) == first
