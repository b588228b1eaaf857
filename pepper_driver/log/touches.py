"""Touches of a simulated robot, by the ground truth of a log."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray

PUSHED = 1e-6
"""Contact torque [N m], or force [N], that counts as none: rounding of J^T f."""
PUSH_PAUSE = 0.1
"""[s] A push that pauses no longer than this is one push."""


def touches(time: FloatArray, touched: BoolArray) -> list[tuple[int, int]]:
    """Return the first and the last row of each touch, in their order.

    What a damaged log lacks is no pause: a touch on both sides of a gap is one.

    Args:
        time: (n,) of the rows [s], increasing.
        touched: (n,) rows in which something touched.
    """
    rows = np.flatnonzero(touched)
    if not len(rows):
        return []
    pauses = (np.diff(time[rows]) > PUSH_PAUSE) & (np.diff(rows) > 1)
    parts = np.split(rows, np.flatnonzero(pauses) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts]
