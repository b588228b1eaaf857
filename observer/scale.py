"""How much wider than identified the threshold of a joint must be today."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

START = 3.0
"""Factor at the start, or more, when nothing is known of how the robot is today: a worn one strays so far."""

LARGEST = 30.0
"""Beyond it a joint is as good as blind."""

SLOPE = 2.0
"""Of the factor over the ratio of the medians: on worn robots the largest residual grows faster than the median."""

SAMPLES = 1000
"""That the median is taken of: 12 s of a joint's own motion. Half of them bring the factor down from START."""

TURN = 3
"""Ticks from the median of one joint to that of the next: a median is dear."""

LATER = 20
"""One in so many samples replaces an older one when there are SAMPLES of them."""


class BoundScale:
    """A factor, 1 or more, on the threshold of each of several joints.

    It follows the median of the residual's size over its median when the joint was identified, both while the joint
    moves; rest proves nothing. It learns from the first motion of a session, when nobody should touch the robot, and
    slowly afterwards: touches that are not felt would make it feel less and less.

    Args:
        identified: (n,) median of the residual's size in motion, as identified [rad].
        start: (n,) factor at the start.

    Attributes:
        factor: (n,) on the thresholds.
    """

    def __init__(self, identified: FloatArray, start: FloatArray) -> None:
        self._identified = identified
        self._start = np.minimum(start, LARGEST)
        self._size = np.zeros((len(identified), SAMPLES))
        self._joints = np.arange(len(identified))
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        self._seen = np.zeros(len(self._identified), dtype=np.int64)
        self._ticks = 0
        self.factor = np.where(np.isnan(self._identified), 1.0, self._start)

    def learn(self, residual: FloatArray, counts: BoolArray) -> None:
        """Take in one tick: residual (n,) [rad], and where it counts (n,): joints that move and nothing touches."""
        stored = np.where(
            self._seen < SAMPLES, self._seen, (self._seen - SAMPLES) // LATER % SAMPLES
        )
        joints = self._joints[counts]
        self._size[joints, stored[joints]] = np.abs(residual[joints])
        self._seen += counts
        self._ticks += 1
        if self._ticks % TURN:
            return
        joint = self._ticks // TURN % len(self._joints)
        seen = int(self._seen[joint])
        if seen:
            median = float(np.median(self._size[joint, : min(seen, SAMPLES)]))
            excess = max(median / float(self._identified[joint]) - 1.0, 0.0)
            remaining = float(self._start[joint]) * (1.0 - 2.0 * seen / SAMPLES)
            self.factor[joint] = min(max(1.0 + SLOPE * excess, remaining), LARGEST)
