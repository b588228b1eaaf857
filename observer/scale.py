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

PACE = 0.003
"""By which share the running median moves with each sample at the start: threefold within 4 s of motion."""

SLOW_PACE = 1e-4
"""The same after WARM_UP: within 2 min of motion."""

WARM_UP = 10.0
"""[s] of a joint's own motion."""


class BoundScale:
    """A factor, 1 or more, on the threshold of each of several joints.

    It follows the running median of the residual's size over its median when the joint was identified, both while the
    joint moves; rest proves nothing. The largest residual of free motion follows its median closely, and a touch now
    and then does not move a median. It learns fast at the start of a session, when nobody should touch the robot much,
    and slowly afterwards.

    Args:
        identified: (n,) median of the residual's size in motion, as identified [rad].
        start: (n,) factor at the start.
        cycle: Period of the ticks [s].
    """

    def __init__(self, identified: FloatArray, start: FloatArray, cycle: float) -> None:
        self._identified = identified
        self._start = np.minimum(start, LARGEST)
        self._warm = WARM_UP / cycle
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        self._median = self._start * self._identified
        self._seen = np.zeros(len(self._median))
        self._set_factor()

    def learn(self, residual: FloatArray, counts: BoolArray) -> None:
        """Take in one tick: residual (n,) [rad], and where it counts (n,): joints that move and nothing touches."""
        above = np.abs(residual) > self._median
        step = np.where(self._seen < self._warm, 1.0 + PACE, 1.0 + SLOW_PACE)
        moved = np.where(above, self._median * step, self._median / step)
        self._median = np.where(counts, moved, self._median)
        self._seen += counts
        self._set_factor()

    def _set_factor(self) -> None:
        ratio = self._median / self._identified
        self.factor = np.minimum(np.maximum(ratio, 1.0), LARGEST)
