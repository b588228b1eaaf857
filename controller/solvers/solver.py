"""Interface of a solver."""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol

import numpy as np

from pepper_driver.config.arrays import FloatArray

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
        """Solve one problem; (n, n), (n,), (n,), (n,), (m, n), (m,). H is symmetric and positive definite."""


def checked(
    x: FloatArray, lower: FloatArray, upper: FloatArray, matrix: FloatArray, bound: FloatArray
) -> Solution:
    """Return ``x`` clipped to its bounds if it satisfies bounds and rows within the tolerance; a failure otherwise.

    Solvers have returned infeasible points as solved.
    """
    inside = np.minimum(np.maximum(x, lower), upper)
    off = inside - x
    ok = off.dot(off) <= BOUND_TOLERANCE**2  # False for NaN
    if ok and len(bound):
        ok = bool((matrix @ x - bound).max() <= BOUND_TOLERANCE * (1.0 + np.abs(x).max()))
    return Solution(inside, "solved") if ok else Solution(x, "failed")
