"""The bound of a joint's residual, from free motion."""

import numpy as np
import pytest

from pepper_driver.observer.fitting.bounds import THRESHOLD_FACTOR, free_residual, free_threshold
from support.observer import SILENT, recording

JOINT, WINDOW, N = "LShoulderRoll", 11, 200
STILL = np.zeros((N, 3))


def test_the_threshold_is_the_largest_filtered_residual_with_a_margin() -> None:
    """With a model that expects nothing, the residual is the tracking error."""
    error = np.zeros(N)
    error[50:80] = -0.02  # longer than half a window: it passes the median
    error[120:124] = 0.5  # shorter: it does not
    quiet = recording(STILL, np.full(N, 0.001))
    runs = [quiet, recording(STILL, error)]
    assert free_threshold(JOINT, runs, SILENT, WINDOW) == pytest.approx(THRESHOLD_FACTOR * 0.02)
    assert free_threshold(JOINT, [quiet], SILENT, WINDOW) == pytest.approx(THRESHOLD_FACTOR * 0.001)


def test_samples_that_say_nothing_do_not_count() -> None:
    error, limited, age = np.full(N, 0.01), np.zeros(N, dtype=np.bool_), np.zeros(N)
    error[50:80], limited[50:80] = 0.3, True
    error[120:150], age[120:150] = 0.4, 1.0
    run = recording(STILL, error, limited=limited, age=age)
    assert free_threshold(JOINT, [run], SILENT, WINDOW) == pytest.approx(THRESHOLD_FACTOR * 0.01)


def test_a_recording_without_a_whole_window_is_refused() -> None:
    short = recording(STILL[:5], np.full(5, 0.01))
    assert np.isnan(free_residual(JOINT, short, SILENT, WINDOW)).all()
    with pytest.raises(ValueError, match=f"{JOINT}: no recording holds 11"):
        free_threshold(JOINT, [short], SILENT, WINDOW)
