"""Interface of a solver."""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol

import numpy as np

from pepper_driver.config.arrays import FloatArray

Status = Literal["solved", "infeasible", "failed"]

BOUND_TOLERANCE = 1e-5
"""By how much a solution may leave its bounds; a solver that says solved and returns worse has failed."""

UNBOUNDED = 1e30
"""What solvers take for infinity."""

NO_ROWS = np.zeros((0, 0))
NO_BOUNDS = np.zeros(0)


class Solution(NamedTuple):
    """Minimiser ``x`` (n,), to be used only when ``status`` is ``solved``."""

    x: FloatArray
    status: Status


class Solver(Protocol):
    """Solves min 1/2 x'Hx + g'x subject to lower <= x <= upper and Gx <= h. Never raises."""

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
    """``x`` clipped into its box, if it was there but for rounding and keeps the rows; a failure otherwise.

    Solvers have returned infeasible points as solved.
    """
    inside = np.minimum(np.maximum(x, lower), upper)
    off = inside - x
    ok = off.dot(off) <= BOUND_TOLERANCE**2  # False for NaN
    if ok and len(bound):
        ok = bool((matrix @ x - bound).max() <= BOUND_TOLERANCE * (1.0 + np.abs(x).max()))
    return Solution(inside, "solved") if ok else Solution(x, "failed")
