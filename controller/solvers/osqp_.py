"""OSQP through its own interface: set up once, then updated and warm started.

Its default accuracy of 1e-3 is visible in the load torque of the small joints and depends on the unit of the weights;
1e-10 costs little time. Part of it is relative to the largest variable: at 1e-8 a small variable exceeded its bound by
more than the tolerance. Polishing prints to the terminal and can return wrong points, so it is off.
"""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.solvers.solver import (
    NO_BOUNDS,
    NO_ROWS,
    UNBOUNDED,
    Solution,
    SolutionCheck,
)

SOLVER_TOLERANCE = 1e-10

MAX_ITERATIONS = 2000
"""They take 2 to 4 ms, a third of a cycle, and leave time for an exact solution if OSQP does not converge."""

RHO_TOLERANCE = 2.0
"""Factor of the step size beyond which it is adapted; with OSQP's default of 5 some cycles took twice as long."""

MIN_DIAGONAL_RATIO = 1e-6
"""Relative to the largest diagonal entry of the cost: smaller entries are scaled as this one."""


class OsqpSolver:
    """Solver with a workspace of OSQP. Its patterns of cost and rows are full, so that values may become zero."""

    name = "osqp"

    def __init__(self) -> None:
        self._shape, self._check = (-1, -1), SolutionCheck()

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
        # With NaN or infinity OSQP prints to the terminal, returns any result, and its workspace stays spoilt.
        numbers = all(np.isfinite(a).all() for a in (H, g, G))
        if not numbers or any(np.isnan(a).any() for a in (lower, upper, h)):
            return Solution(np.zeros(n), "failed")
        if (lower > upper).any() or (h <= -UNBOUNDED).any():
            return Solution(np.zeros(n), "infeasible")
        diagonal = H.diagonal()
        if diagonal.min() < 0:  # not convex: OSQP would print and continue with the last cost
            return Solution(np.zeros(n), "failed")
        # OSQP has an absolute accuracy, and scales only by the matrices of the set-up. The problem is solved for
        # x / unit, where every diagonal entry of the cost is 1, so that the result is the same for any weights.
        diagonal = np.maximum(diagonal, MIN_DIAGONAL_RATIO * (diagonal.max() or 1.0))
        smallest = diagonal.min()
        unit = np.sqrt(smallest / diagonal)
        H, g = H * (np.outer(unit, unit) / smallest), g * (unit / smallest)
        low = np.concatenate([lower / unit, np.full(m, -np.inf)])
        high = np.concatenate([upper / unit, h])
        solution = Solution(np.zeros(n), "failed")
        try:
            if self._shape != (n, m):
                self._set_up(n, m)
            # In the order of the sparse format: per column the 1 of the bounds, then the rows.
            matrix = np.concatenate([np.ones((1, n)), G.reshape(m, n) * unit])
            self._solver.update(
                Px=H[self._upper_rows, self._upper_columns],
                Ax=matrix.ravel(order="F"),
                q=g,
                l=low,
                u=high,
            )
            result = self._solver.solve(raise_error=False)
            status = result.info.status_val
            if status == osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE:
                return Solution(np.zeros(n), "infeasible")
            if status == osqp.SolverStatus.OSQP_SOLVED:
                solution = self._check.check(unit * result.x, lower, upper, G, h)
        except (ValueError, TypeError, RuntimeError, osqp.OSQPException):
            pass
        if solution.status == "failed":
            self._shape = (-1, -1)  # a spoilt workspace never recovers
        return solution

    def _set_up(self, n: int, m: int) -> None:
        columns = np.repeat(np.arange(n), np.arange(1, n + 1))
        rows = np.concatenate([np.arange(column + 1) for column in range(n)])
        self._upper_rows, self._upper_columns = rows, columns
        cost = sparse.csc_matrix((np.where(rows == columns, 1.0, 0.1), (rows, columns)), (n, n))
        constraint = sparse.csc_matrix(np.concatenate([np.eye(n), np.ones((m, n))]))
        self._solver = osqp.OSQP()
        self._solver.setup(
            cost,
            np.zeros(n),
            constraint,
            np.full(n + m, -1.0),
            np.full(n + m, 1.0),
            eps_abs=SOLVER_TOLERANCE,
            eps_rel=SOLVER_TOLERANCE,
            max_iter=MAX_ITERATIONS,
            adaptive_rho_tolerance=RHO_TOLERANCE,
            warm_starting=True,
            polishing=False,
            verbose=False,
        )
        self._shape = (n, m)
