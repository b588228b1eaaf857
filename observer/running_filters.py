"""Filters over the last samples of all joints: running median (Sec. V of the paper, 11 samples), largest value."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray


class RunningMedian:
    """Median of the last ``window`` samples of each of ``width`` signals; of those there are, at the start.

    A NaN spoils the median of its signal as long as it is in the window; the caller must not use it so long.

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
        """Take in (width,) one sample of each signal; returns (width,) the medians, a new array."""
        window = len(self._ring)
        self._ring[self._count % window] = sample
        self._count += 1
        filled = min(self._count, window)
        middle = filled // 2
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
        """Take the samples so far of the signals ``where`` (width,) as zeros."""
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
        # Van Herk's way: the window ends in this block of samples and begins in the one before.
        self._block = np.zeros((max(1, round(memory / cycle)), width))
        self._count = 0
        self._largest_now = np.zeros(width)
        self._largest_from = np.zeros_like(self._block)

    def push(self, sample: FloatArray) -> FloatArray:
        """Take in (width,) one sample of each signal; returns (width,) the largest, a new array."""
        row = self._count % len(self._block)
        self._count += 1
        if row == 0:
            # Of the block that has just ended, the largest from each of its samples on.
            np.maximum.accumulate(self._block[::-1], axis=0, out=self._largest_from)
            self._largest_now = sample.copy()
        else:
            self._largest_now = np.maximum(self._largest_now, sample)
        self._block[row] = sample
        left = len(self._block) - 1 - row
        if left == 0:
            return self._largest_now.copy()
        largest: FloatArray = np.maximum(self._largest_now, self._largest_from[left - 1])
        return largest
