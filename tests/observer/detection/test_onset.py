from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.observer.detection.excursions import ONSET_LEVEL, ResidualHistory
from support.observer import CYCLE

THRESHOLD = 0.03


def history(signal: list[float], window: int = 11, lookback: int = 40) -> ResidualHistory:
    past = ResidualHistory(window, lookback, 2)
    for k, value in enumerate(signal):
        past.append(k * CYCLE, np.array([0.0, value]), 0.0)
    return past


def test_onset_is_where_the_ramp_passes_a_third_of_the_threshold() -> None:
    ramp = [0.0] * 30 + [0.004 * k for k in range(1, 14)]
    # 0.004 k reaches 0.01 with k = 3: sample 32.
    assert history(ramp).onset(1, 1, THRESHOLD) == pytest.approx(32 * CYCLE)
    mirrored = [-value for value in ramp]
    assert history(mirrored).onset(1, -1, THRESHOLD) == pytest.approx(32 * CYCLE)


def test_onset_does_not_depend_on_samples_before_the_run() -> None:
    ramp = [0.004 * k for k in range(1, 14)]
    for before in (0.0, -0.05, 0.009, float("nan")):
        assert history([before] * 30 + ramp).onset(1, 1, THRESHOLD) == pytest.approx(32 * CYCLE)


def test_a_step_is_dated_at_its_first_sample_in_the_window() -> None:
    assert history([0.0] * 50 + [0.1] * 6).onset(1, 1, THRESHOLD) == pytest.approx(50 * CYCLE)


def test_a_drop_inside_the_window_does_not_hide_the_onset() -> None:
    signal = [0.0] * 50 + [0.02, 0.04, 0.05, 0.0, 0.05, 0.05, 0.05, 0.05]
    assert history(signal).onset(1, 1, THRESHOLD) == pytest.approx(50 * CYCLE)


@pytest.mark.parametrize("before", [0, 3])
def test_a_drop_does_not_hide_the_onset_in_a_short_history(before: int) -> None:
    signal = [0.0] * before + [0.04, 0.0, 0.04]
    assert history(signal).onset(1, 1, THRESHOLD) == pytest.approx(before * CYCLE)


def test_what_is_exactly_at_the_threshold_or_its_third() -> None:
    """At the threshold is not over it; at a third of it is not free."""
    assert history([3.0, 0.0, 4.0]).onset(1, 1, 3.0) == pytest.approx(2 * CYCLE)
    assert history([0.5, 3.0 * ONSET_LEVEL, 4.0]).onset(1, 1, 3.0) == pytest.approx(CYCLE)


def test_growth_longer_than_the_history_is_put_at_its_beginning() -> None:
    slow = [0.02] * 200 + [0.04] * 6
    first = 206 - 51
    assert history(slow).onset(1, 1, THRESHOLD) == pytest.approx(first * CYCLE)
    assert history([0.04] * 3).onset(1, 1, THRESHOLD) == 0.0


def test_without_a_sample_over_the_threshold_the_newest_counts() -> None:
    assert history([0.0] * 20).onset(1, 1, THRESHOLD) == pytest.approx(19 * CYCLE)


def test_reset_forgets() -> None:
    past = history([0.04] * 30)
    past.reset()
    for k in (5, 6):
        past.append(float(k), np.array([0.0, 0.04]), 0.0)
    assert past.onset(1, 1, THRESHOLD) == 5.0


def test_the_base_is_the_column_after_the_joints() -> None:
    past = ResidualHistory(11, 40, 2)
    for k in range(50):
        joint, base = (0.04 if k >= 40 else 0.0), (-0.04 if k >= 45 else 0.0)
        past.append(k * CYCLE, np.array([0.0, joint]), base)
    assert past.onset(1, 1, THRESHOLD) == pytest.approx(40 * CYCLE)
    assert past.onset(2, -1, THRESHOLD) == pytest.approx(45 * CYCLE)
