"""DAQP: a dense active-set solver, exact and the fastest for a robot of this size.

Every cycle has a new cost, so the whole problem is passed each time. A workspace that is kept between cycles was
measured to be slower, and bad values can spoil it.
"""

from __future__ import annotations

import daqp
import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Out, kernel
from pepper_driver.controller.solvers.solver import (
    NO_BOUNDS,
    NO_ROWS,
    UNBOUNDED,
    Solution,
    SolutionCheck,
)

SOLVED = 1
INFEASIBLE = -1
"""DAQP's exit flags."""


@kernel
def _append(
    lower: FloatArray,
    upper: FloatArray,
    bound: FloatArray,
    low: Out[FloatArray],
    high: Out[FloatArray],
) -> None:
    """Write the bounds of the variables, then those of the rows, which have none below."""
    n = len(lower)
    for i in range(n):
        low[i], high[i] = lower[i], np.minimum(upper[i], UNBOUNDED)
    for row in range(len(bound)):
        low[n + row], high[n + row] = -UNBOUNDED, np.minimum(bound[row], UNBOUNDED)


class DaqpSolver:
    """Solver that passes every problem to DAQP as a whole."""

    name = "daqp"

    def __init__(self) -> None:
        self._no_rows, self._check = NO_ROWS, SolutionCheck()
        self._append = _append.load()

    def _none(self, n: int) -> FloatArray:
        """Return (0, n) rows: DAQP takes the number of variables from them."""
        if self._no_rows.shape[1] != n:
            self._no_rows = np.zeros((0, n))
        return self._no_rows

    def solve(
        self,
        H: FloatArray,
        g: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        G: FloatArray = NO_ROWS,
        h: FloatArray = NO_BOUNDS,
    ) -> Solution:
        """Solve one problem; see :class:`Solver`."""
        n, m = len(g), len(h)
        low, high = lower, upper
        if not m:
            G = self._none(n)
        else:
            low, high = np.empty(n + m), np.empty(n + m)
            self._append(lower, upper, h, low, high)
        try:
            x, _, flag, _ = daqp.solve(H, g, G, high, low)
        except (ValueError, TypeError, RuntimeError):
            return Solution(np.zeros(len(g)), "failed")
        if flag == SOLVED:
            return self._check.check(x, lower, upper, G, h)
        return Solution(np.zeros(len(g)), "infeasible" if flag == INFEASIBLE else "failed")
