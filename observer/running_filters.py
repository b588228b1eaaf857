"""Filters over the last samples of all joints: running median (Sec. V of the paper, 11 samples) and maximum."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray


class RunningMedian:
    """Median of the last ``window`` samples of each of ``width`` signals, at the start of fewer.

    The median of a signal is undefined while a NaN is in its window; the caller must not use it.

    Raises:
        ValueError: A window or a width below 1.
    """

    def __init__(self, window: int, width: int) -> None:
        if window < 1 or width < 1:
            raise ValueError(f"window and width must be 1 or more, got {window} and {width}")
        self._ring = np.zeros((window, width))
        self._scratch = np.zeros((window, width))
        self._count = 0

    def push(self, sample: FloatArray) -> FloatArray:
        """Take in (width,) one sample of each signal; return (width,) medians, a new array."""
        window = len(self._ring)
        self._ring[self._count % window] = sample
        self._count += 1
        filled = min(self._count, window)
        middle = filled // 2
        # A partial sort in a buffer that is kept: np.median would allocate in every tick.
        sorted_half = self._scratch[:filled]
        sorted_half[:] = self._ring[:filled]
        if filled % 2:
            sorted_half.partition(middle, axis=0)
            median: FloatArray = sorted_half[middle].copy()
        else:
            sorted_half.partition((middle - 1, middle), axis=0)
            median = (sorted_half[middle - 1] + sorted_half[middle]) / 2
        return median

    def clear(self, where: BoolArray) -> None:
        """Set the samples so far of the signals ``where`` (width,) to zero."""
        self._ring[:, where] = 0.0

    def reset(self) -> None:
        """Forget all samples."""
        self._count = 0


class RunningMaximum:
    """Largest sample of each of ``width`` signals over the last ``memory`` [s]; NaN where one of them is.

    Args:
        memory: [s]
        cycle: Period of the samples [s].
        width: Number of signals, none of them below 0.
    """

    def __init__(self, memory: float, cycle: float, width: int) -> None:
        # Algorithm of van Herk: the window ends in this block of samples and begins in the previous one. Its
        # cost per sample does not depend on the length of the window.
        self._block = np.zeros((max(1, round(memory / cycle)), width))
        self._count = 0
        self._block_maximum = np.zeros(width)
        self._tail_maximum = np.zeros_like(self._block)

    def push(self, sample: FloatArray) -> FloatArray:
        """Take in (width,) one sample of each signal; return (width,) maxima, a new array."""
        row = self._count % len(self._block)
        self._count += 1
        if row == 0:
            # Maximum from each sample of the finished block to its end.
            np.maximum.accumulate(self._block[::-1], axis=0, out=self._tail_maximum)
            self._block_maximum = sample.copy()
        else:
            self._block_maximum = np.maximum(self._block_maximum, sample)
        self._block[row] = sample
        left = len(self._block) - 1 - row
        if left == 0:
            return self._block_maximum.copy()
        largest: FloatArray = np.maximum(self._block_maximum, self._tail_maximum[left - 1])
        return largest
