"""The scale of the thresholds, against medians of the samples themselves."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from observer_cases import FloatArray

from pepper_driver.observer.scale import LARGEST, LATER, SAMPLES, SLOPE, TURN, BoundScale

IDENTIFIED = 5e-4
COUNTS = np.array([True])


def scale(start: float = 3.0) -> BoundScale:
    return BoundScale(np.array([IDENTIFIED]), np.array([start]))


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
def test_follows_the_excess_of_the_median(ratio: float) -> None:
    drawn = residuals(SAMPLES, ratio * IDENTIFIED)
    factor = learn(scale(), drawn)[-1]
    exact = np.median(np.abs(drawn[: SAMPLES - SAMPLES % TURN])) / IDENTIFIED
    assert factor == pytest.approx(1.0 + SLOPE * (exact - 1.0), rel=0.01)
    assert exact == pytest.approx(ratio, rel=0.1)


def test_touches_move_it_no_further_than_a_median() -> None:
    """Three of ten samples from elsewhere: at worst the 5/7 quantile of the others."""
    rng = np.random.default_rng(1)
    sizes = rng.uniform(0.0, 4.0 * IDENTIFIED, SAMPLES)  # median twice the identified one
    sizes[rng.uniform(size=SAMPLES) < 0.3] = 1.0
    factor = learn(scale(), sizes)[-1]
    assert factor == pytest.approx(1.0 + SLOPE * (4.0 * 5 / 7 - 1.0), rel=0.1)


@given(st.lists(st.floats(-1.0, 1.0), max_size=60), st.floats(1.0, 100.0))
def test_is_never_below_1_nor_beyond_the_largest(values: list[float], start: float) -> None:
    target = scale(start)
    assert 1.0 <= target.factor[0] <= LARGEST
    for factor in learn(target, np.array(values)):
        assert 1.0 <= factor <= LARGEST


def test_a_quiet_joint_comes_down_to_1_with_half_of_the_samples() -> None:
    factors = learn(scale(), residuals(SAMPLES, 0.2 * IDENTIFIED))
    assert factors[0] > 2.9
    assert all(later <= earlier for earlier, later in itertools.pairwise(factors))
    assert factors[SAMPLES // 4] == pytest.approx(1.5, abs=0.05)
    assert factors[SAMPLES // 2 + TURN] == 1.0


def test_learns_slowly_when_it_has_its_samples() -> None:
    target = scale()
    before = learn(target, residuals(SAMPLES, 3.0 * IDENTIFIED))[-1]
    after = learn(target, np.full(SAMPLES, 1.0))[-1]
    assert before < after < 1.2 * before
    # But it learns: when half of the samples are new, so is the median.
    assert learn(target, np.full(SAMPLES * LATER // 2, 1.0))[-1] == LARGEST


def test_only_what_counts_is_learned() -> None:
    target = BoundScale(np.full(2, IDENTIFIED), np.full(2, 3.0))
    for _ in range(300):
        target.learn(np.full(2, 0.1), np.array([True, False]))
    assert target.factor[0] == LARGEST
    assert target.factor[1] == 3.0


def test_joints_without_a_model_disturb_no_other() -> None:
    target = BoundScale(np.array([np.nan, IDENTIFIED]), np.array([np.nan, 3.0]))
    for _ in range(50):
        target.learn(np.array([np.nan, 0.1]), np.array([False, True]))
    assert target.factor[0] == 1.0
    assert target.factor[1] == LARGEST


def test_reset_forgets() -> None:
    target = scale()
    first = learn(target, residuals(500, 9 * IDENTIFIED))
    target.reset()
    assert target.factor[0] == 3.0
    assert learn(target, residuals(500, 9 * IDENTIFIED)) == first
