"""Running median over the last samples of all joints (Sec. V of the paper, 11 samples)."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel


@kernel
def push_median(
    rings: Out[Matrix[FloatArray]], j: int, count: int, sample: float, ordered: Out[FloatArray]
) -> float:
    """Take in the sample number ``count`` of the signal ``j``; return the median of its window.

    ``ordered`` is a buffer of one window.
    """
    ring, window = rings[j], len(ordered)
    filled = min(count + 1, window)
    middle = filled // 2
    ring[count % window] = sample
    for k in range(filled):  # insertion sort
        value, place = ring[k], k
        while place > 0 and ordered[place - 1] > value:
            ordered[place] = ordered[place - 1]
            place -= 1
        ordered[place] = value
    if filled % 2:
        return float(ordered[middle])
    return float((ordered[middle - 1] + ordered[middle]) / 2.0)


@kernel
def _push_median(
    rings: Out[Matrix[FloatArray]],
    count: int,
    sample: FloatArray,
    ordered: Out[FloatArray],
    median: Out[FloatArray],
) -> None:
    for j in range(len(rings)):
        median[j] = push_median(rings, j, count, sample[j], ordered)


class RunningMedian:
    """Median of the last ``window`` samples of each of ``width`` signals, at the start of fewer.

    The median of a signal is undefined while a NaN is in its window; the caller must not use it.

    Attributes:
        rings: (width, window) samples, for :func:`push_median`.
        ordered: (window,) buffer.
        count: Samples so far of each signal.

    Raises:
        ValueError: A window or a width below 1.
    """

    def __init__(self, window: int, width: int) -> None:
        if window < 1 or width < 1:
            raise ValueError(f"window and width must be 1 or more, got {window} and {width}")
        self.rings, self.ordered = np.zeros((width, window)), np.zeros(window)
        self.count = 0
        self._push = _push_median.load()

    def push(self, sample: FloatArray) -> FloatArray:
        """Take in (width,) one sample of each signal; return (width,) medians, a new array."""
        median = np.empty(len(self.rings))
        self._push(self.rings, self.count, sample, self.ordered, median)
        self.count += 1
        return median

    def clear(self, where: BoolArray) -> None:
        """Set the samples so far of the signals ``where`` (width,) to zero."""
        self.rings[where] = 0.0

    def reset(self) -> None:
        """Forget all samples."""
        self.count = 0
