from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import median_filter

from pepper_driver.observer.running_filters import RunningMedian


@given(st.integers(1, 12), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_is_the_median_of_the_samples_in_the_window(window: int, n: int, seed: int) -> None:
    samples = np.random.default_rng(seed).normal(size=(n, 3))
    median = RunningMedian(window, 3)
    for k in range(n):
        expected = np.median(samples[max(0, k + 1 - window) : k + 1], axis=0)
        np.testing.assert_array_equal(median.push(samples[k]), expected)


def test_equals_scipy_once_the_window_is_full() -> None:
    samples = np.random.default_rng(0).normal(size=(200, 17))
    median = RunningMedian(11, 17)
    ours = np.array([median.push(sample) for sample in samples])
    centred = median_filter(samples, size=(11, 1))
    np.testing.assert_array_equal(ours[10:], centred[5:-5])


def test_a_spike_of_five_samples_leaves_no_trace() -> None:
    median = RunningMedian(11, 1)
    out = [median.push(np.array([9.0 if 20 <= k < 25 else 0.0]))[0] for k in range(60)]
    assert max(out) == 0.0


def test_results_are_not_overwritten_and_reset_forgets() -> None:
    median = RunningMedian(3, 2)
    first = median.push(np.array([1.0, 2.0]))
    median.push(np.array([5.0, 5.0]))
    np.testing.assert_array_equal(first, [1.0, 2.0])
    median.reset()
    np.testing.assert_array_equal(median.push(np.array([7.0, 8.0])), [7.0, 8.0])


def test_nan_has_no_effect_after_one_window() -> None:
    median = RunningMedian(5, 1)
    out = [median.push(np.array([np.nan if k == 4 else float(k)]))[0] for k in range(12)]
    assert out[9:] == [7.0, 8.0, 9.0]


@pytest.mark.parametrize(("window", "width"), [(0, 3), (3, 0), (-1, 1)])
def test_refuses_empty_windows(window: int, width: int) -> None:
    with pytest.raises(ValueError, match="1 or more"):
        RunningMedian(window, width)
