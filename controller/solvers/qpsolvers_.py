"""Any solver that qpsolvers wraps: slower, for comparison."""

from __future__ import annotations

import warnings

import numpy as np
import qpsolvers

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.solvers.solver import NO_BOUNDS, NO_ROWS, Solution, SolutionCheck


class QpsolversSolver:
    """Solver of ``qpsolvers.available_solvers``, set up again in every call."""

    def __init__(self, name: str) -> None:
        self.name, self._check = name, SolutionCheck()

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
        matrix, bound = (G, h) if len(h) else (None, None)
        try:
            problem = qpsolvers.Problem(H, g, matrix, bound, lb=lower, ub=upper)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about sparse matrices
                solution = qpsolvers.solve_problem(problem, solver=self.name)
        except Exception:  # each wrapped solver raises errors of its own
            return Solution(np.zeros(len(g)), "failed")
        if not solution.found or solution.x is None:
            return Solution(np.zeros(len(g)), "infeasible")
        return self._check.check(solution.x, lower, upper, G, h)
