"""DAQP: a dense active-set solver, exact and the fastest for a robot of this size. Warm started, nothing allocated."""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray

from pepper_driver.controller.solvers.solver import NO_BOUNDS, NO_ROWS, Solution, checked

FloatArray = NDArray[np.float64]

INFEASIBLE = -1
"""DAQP's exit flag."""

UNBOUNDED = 1e30


class DaqpSolver:
    """Keeps DAQP's workspace as long as the number of variables and rows stays the same."""

    name = "daqp"

    def __init__(self) -> None:
        self._model: daqp.Model | None = None
        self._shape = (-1, -1)

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
        if self._shape != (n, m):
            self._model, self._shape = None, (n, m)
            self._lower, self._upper = np.full(n + m, -UNBOUNDED), np.empty(n + m)
            self._rows = np.zeros((m, n))
        self._lower[:n] = lower
        self._upper[:n] = upper
        self._upper[n:] = np.minimum(h, UNBOUNDED)
        self._rows[:] = G if m else 0.0
        try:
            flag = self._load(H, g, m)
            if flag < 0:
                # A refused update leaves the workspace in a state that may solve the wrong problem.
                self._model = None
                return Solution(np.zeros(n), "infeasible" if flag == INFEASIBLE else "failed")
            assert self._model is not None
            x, _, flag, _ = self._model.solve()
        except (ValueError, TypeError, RuntimeError):
            self._model = None
            return Solution(np.zeros(n), "failed")
        if flag == INFEASIBLE:
            return Solution(np.zeros(n), "infeasible")
        if flag <= 0:
            self._model = None
            return Solution(np.zeros(n), "failed")
        solution = checked(np.asarray(x), lower, upper, self._rows, h)
        if solution.status == "failed":
            self._model = None
        return solution

    def _load(self, H: FloatArray, g: FloatArray, m: int) -> int:
        """Hand the problem to DAQP; its exit flag."""
        flag: int
        if self._model is None:
            self._model = daqp.Model()
            flag, _ = self._model.setup(H, g, self._rows, self._upper, self._lower)
        elif m:
            flag = self._model.update(
                H=H, f=g, A=self._rows, bupper=self._upper, blower=self._lower
            )
        else:
            flag = self._model.update(H=H, f=g, bupper=self._upper, blower=self._lower)
        return flag
