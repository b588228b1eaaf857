"""Filters over the last samples of all joints: running median (Sec. V of the paper, 11 samples) and maximum."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel


@kernel
def _push_median(
    rings: Out[Matrix[FloatArray]],
    count: int,
    sample: FloatArray,
    ordered: Out[FloatArray],
    median: Out[FloatArray],
) -> None:
    """Put the sample number ``count`` of each signal into its ring; ``ordered`` is a buffer of one window."""
    window = len(ordered)
    filled = min(count + 1, window)
    middle = filled // 2
    for j in range(len(rings)):
        ring = rings[j]
        ring[count % window] = sample[j]
        for k in range(filled):  # insertion sort
            value, place = ring[k], k
            while place > 0 and ordered[place - 1] > value:
                ordered[place] = ordered[place - 1]
                place -= 1
            ordered[place] = value
        if filled % 2:
            median[j] = ordered[middle]
        else:
            median[j] = (ordered[middle - 1] + ordered[middle]) / 2.0


@kernel
def push_maximum(
    blocks: Out[Matrix[FloatArray]],
    tails: Out[Matrix[FloatArray]],
    largest: Out[FloatArray],
    j: int,
    count: int,
    sample: float,
) -> float:
    """Take in the sample number ``count`` of the signal ``j``; return the largest size in its window."""
    # Algorithm of van Herk: the window ends in this block of samples and begins in the previous one. Its
    # cost per sample does not depend on the length of the window.
    block, tail, size = blocks[j], tails[j], abs(sample)
    memory = len(block)
    row = count % memory
    if row == 0:
        # Maximum from each sample of the finished block to its end.
        tail[memory - 1] = block[memory - 1]
        for k in range(memory - 2, -1, -1):
            tail[k] = np.maximum(block[k], tail[k + 1])
        largest[j] = size
    else:
        largest[j] = np.maximum(largest[j], size)
    block[row] = size
    if row == memory - 1:
        return float(largest[j])
    return float(np.maximum(largest[j], tail[row + 1]))


@kernel
def _push_maximum(
    blocks: Out[Matrix[FloatArray]],
    tails: Out[Matrix[FloatArray]],
    largest: Out[FloatArray],
    count: int,
    sample: FloatArray,
    maximum: Out[FloatArray],
) -> None:
    for j in range(len(blocks)):
        maximum[j] = push_maximum(blocks, tails, largest, j, count, sample[j])


class RunningMedian:
    """Median of the last ``window`` samples of each of ``width`` signals, at the start of fewer.

    The median of a signal is undefined while a NaN is in its window; the caller must not use it.

    Raises:
        ValueError: A window or a width below 1.
    """

    def __init__(self, window: int, width: int) -> None:
        if window < 1 or width < 1:
            raise ValueError(f"window and width must be 1 or more, got {window} and {width}")
        self._rings, self._ordered = np.zeros((width, window)), np.zeros(window)
        self._count = 0
        self._push = _push_median.load()

    def push(self, sample: FloatArray) -> FloatArray:
        """Take in (width,) one sample of each signal; return (width,) medians, a new array."""
        median = np.empty(len(self._rings))
        self._push(self._rings, self._count, sample, self._ordered, median)
        self._count += 1
        return median

    def clear(self, where: BoolArray) -> None:
        """Set the samples so far of the signals ``where`` (width,) to zero."""
        self._rings[where] = 0.0

    def reset(self) -> None:
        """Forget all samples."""
        self._count = 0


class RunningMaximum:
    """Largest size of each of ``width`` signals over the last ``memory`` [s]; NaN where one of its samples is.

    Args:
        memory: [s]
        cycle: Period of the samples [s].
        width: Number of signals.
    """

    def __init__(self, memory: float, cycle: float, width: int) -> None:
        self._blocks = np.zeros((width, max(1, round(memory / cycle))))
        self._tails = np.zeros_like(self._blocks)
        self._largest = np.zeros(width)
        self._count = 0
        self._push = _push_maximum.load()

    def push(self, sample: FloatArray) -> FloatArray:
        """Take in (width,) one sample of each signal; return (width,) maxima, a new array."""
        maximum = np.empty(len(self._blocks))
        self._push(self._blocks, self._tails, self._largest, self._count, sample, maximum)
        self._count += 1
        return maximum
