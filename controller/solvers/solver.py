"""Interface of a solver."""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel

Status = Literal["solved", "infeasible", "failed"]

BOUND_TOLERANCE = 1e-5
"""Tolerance of the bounds; a solver that reports success and returns a worse point has failed."""

UNBOUNDED = 1e30
"""Value that solvers treat as infinity."""

NO_ROWS = np.zeros((0, 0))
NO_BOUNDS = np.zeros(0)


class Solution(NamedTuple):
    """Minimiser ``x`` (n,), valid only if ``status`` is ``solved``."""

    x: FloatArray
    status: Status


class Solver(Protocol):
    """Solver of min 1/2 x'Hx + g'x subject to lower <= x <= upper and Gx <= h. It never raises."""

    name: str

    def solve(
        self,
        H: FloatArray,
        g: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        G: FloatArray = NO_ROWS,
        h: FloatArray = NO_BOUNDS,
    ) -> Solution:
        """Solve one problem; (n, n), (n,), (n,), (n,), (m, n), (m,). H is symmetric and positive definite.

        The arrays are contiguous.
        """


@kernel
def _inside(
    x: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    matrix: Matrix[FloatArray],
    bound: FloatArray,
    clipped: Out[FloatArray],
) -> bool:
    """Write x clipped to its bounds; return True if it satisfies bounds and rows within the tolerance."""
    off, largest = 0.0, 0.0
    for i in range(len(x)):
        clipped[i] = np.minimum(np.maximum(x[i], lower[i]), upper[i])
        off += (clipped[i] - x[i]) ** 2
        largest = max(largest, abs(x[i]))
    if not off <= BOUND_TOLERANCE**2:  # also for NaN
        return False
    for row in range(len(bound)):
        value = 0.0
        for i in range(len(x)):
            value += matrix[row, i] * x[i]
        if not value - bound[row] <= BOUND_TOLERANCE * (1.0 + largest):
            return False
    return True


class SolutionCheck:
    """Check of what a solver returns as solved: solvers have returned infeasible points."""

    def __init__(self) -> None:
        self._inside = _inside.load()

    def check(
        self,
        x: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        matrix: FloatArray,
        bound: FloatArray,
    ) -> Solution:
        """Return ``x`` clipped to its bounds if it satisfies bounds and rows within the tolerance; else a failure."""
        clipped = np.empty_like(x)
        ok = self._inside(x, lower, upper, matrix, bound, clipped)
        return Solution(clipped, "solved") if ok else Solution(x, "failed")
