"""When a contact began, told from the residuals before the alarm."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray

ONSET_LEVEL = 1.0 / 3.0
"""Share of the threshold below which the residual counts as not yet touched."""


class ResidualHistory:
    """Unfiltered residuals of the last ticks.

    The median raises the alarm several ticks late; the samples it was taken from still show the beginning.

    Args:
        window: Samples of the median filter.
        lookback: Samples before that window in which the onset may lie.
        width: Number of joints; the base is one column more.
    """

    def __init__(self, window: int, lookback: int, width: int) -> None:
        self._window = window
        self._residual = np.zeros((window + lookback, width + 1))
        self._time = np.zeros(window + lookback)
        self._count = 0

    def append(self, time: float, residual: FloatArray, base: float) -> None:
        """Take in one tick.

        Args:
            time: Clock [s].
            residual: (width,) unfiltered [rad], NaN where there is none.
            base: That of the base, likewise.
        """
        row = self._count % len(self._time)
        self._time[row] = time
        self._residual[row, :-1] = residual
        self._residual[row, -1] = base
        self._count += 1

    def onset(self, joint: int, sign: int, threshold: float) -> float:
        """Clock at which the residual began to leave its free-motion band [s].

        From the oldest sample of the median window that is over the threshold, back to the first of the unbroken run
        of samples that lie at ONSET_LEVEL of the threshold or more on the same side. A contact that has grown for
        longer than the history is put at the history's beginning.

        Args:
            joint: Index of the joint.
            sign: Side of the excursion: sign of the residual.
            threshold: That it has crossed in this tick [rad].
        """
        filled = min(self._count, len(self._time))
        rows = np.arange(self._count - filled, self._count) % len(self._time)
        rising = sign * self._residual[rows, joint]
        newest = max(filled - self._window, 0)
        over = np.flatnonzero(rising[newest:] > threshold)
        start = newest + int(over[0]) if len(over) else filled - 1
        # Written so that NaN ends the run.
        outside = np.flatnonzero(~(rising[:start] >= ONSET_LEVEL * threshold))
        first = int(outside[-1]) + 1 if len(outside) else 0
        return float(self._time[rows[first]])

    def reset(self) -> None:
        """Forget all samples."""
        self._count = 0
