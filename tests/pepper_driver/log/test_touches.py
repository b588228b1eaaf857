"""One touch or two: by the pauses between them."""

import numpy as np
import pytest

from pepper_driver.log.touches import PUSH_PAUSE, touches

CYCLE = 0.012
MAX_PAUSE = int(PUSH_PAUSE / CYCLE)
"""Untouched ticks that are no pause."""


def rows(*parts: tuple[bool, int]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Touched or not, so many ticks each."""
    return np.concatenate([np.full(count, touched) for touched, count in parts])


@pytest.mark.parametrize(
    ("touched", "expected"),
    [
        (rows((False, 5)), []),
        (rows((True, 5)), [(0, 4)]),
        (rows((False, 3), (True, 1), (False, 3)), [(3, 3)]),
        (rows((True, 2), (False, MAX_PAUSE - 1), (True, 3)), [(0, MAX_PAUSE + 3)]),
        (rows((True, 2), (False, MAX_PAUSE), (True, 3)), [(0, 1), (MAX_PAUSE + 2, MAX_PAUSE + 4)]),
    ],
)
def test_touches_are_parted_by_pauses(
    touched: np.ndarray[tuple[int], np.dtype[np.bool_]], expected: list[tuple[int, int]]
) -> None:
    assert touches(CYCLE * np.arange(float(len(touched))), touched) == expected


def test_what_a_damaged_log_lacks_is_no_pause() -> None:
    time = CYCLE * np.arange(100.0)
    touched = np.ones(100, dtype=np.bool_)
    kept = np.r_[0:40, 70:100]
    assert touches(time[kept], touched[kept]) == [(0, 69)]
