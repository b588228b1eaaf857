"""Some entries of one of MuJoCo's arrays, read and written in every step of physics."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray, IndexArray


class Slots:
    """Entries of ``array`` at ``indices``, as a view where they lie side by side: that costs nothing.

    A passive hinge between two joints parts them; then they are gathered and scattered.
    """

    def __init__(self, array: FloatArray, indices: IndexArray) -> None:
        self._array, self._indices = array, indices
        first, n = int(indices[0]), len(indices)
        self._whole = bool(np.array_equal(indices, np.arange(first, first + n)))
        self._values: FloatArray = array[first : first + n] if self._whole else np.empty(n)

    def read(self) -> FloatArray:
        """(n,) the entries; do not write to them, and do not keep them."""
        if not self._whole:
            self._array.take(self._indices, out=self._values, mode="clip")
        return self._values

    def write(self, values: FloatArray) -> None:
        """Set the entries to (n,) ``values``."""
        if self._whole:
            self._values[:] = values
        else:
            self._array[self._indices] = values
