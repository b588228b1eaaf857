from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import median_filter

from pepper_driver.observer.running_filters import RunningMaximum, RunningMedian
from support.observer import CYCLE


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


@given(st.integers(1, 12), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_the_largest_is_that_of_the_samples_in_the_memory(kept: int, n: int, seed: int) -> None:
    samples = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(n, 3))
    largest = RunningMaximum(kept * CYCLE, CYCLE, 3)
    for k in range(n):
        expected = np.abs(samples[max(0, k + 1 - kept) : k + 1]).max(axis=0)
        np.testing.assert_array_equal(largest.push(samples[k]), expected)


def test_the_largest_keeps_at_least_this_sample_and_is_not_overwritten() -> None:
    largest = RunningMaximum(0.0, CYCLE, 1)
    first = largest.push(np.array([5.0]))
    assert largest.push(np.array([2.0]))[0] == 2.0
    assert first[0] == 5.0


def test_samples_may_come_in_a_buffer_that_is_written_to_again() -> None:
    samples = np.random.default_rng(0).uniform(size=(60, 2))
    largest, buffer = RunningMaximum(5 * CYCLE, CYCLE, 2), np.empty(2)
    for k in range(60):
        buffer[:] = samples[k]
        expected = samples[max(0, k - 4) : k + 1].max(axis=0)
        np.testing.assert_array_equal(largest.push(buffer), expected)


@given(st.integers(1, 9), st.integers(0, 30))
def test_the_largest_is_nan_as_long_as_one_of_its_samples_is(kept: int, bad: int) -> None:
    largest = RunningMaximum(kept * CYCLE, CYCLE, 2)
    for k in range(50):
        value = largest.push(np.array([np.nan if k == bad else float(k), float(k)]))
        assert np.isnan(value[0]) == (bad <= k < bad + kept)
        assert value[1] == k
        value[:] = -1.0  # what it returned is the caller's
