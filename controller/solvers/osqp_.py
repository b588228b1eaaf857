"""OSQP through its own interface: set up once, then updated and warm started.

Its default accuracy of 1e-3 shows in the load torque of the small joints and depends on the unit of the weights; 1e-6
costs no measurable time. Polishing prints to the terminal and can return wrong points, so it stays off.
"""

from __future__ import annotations

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from pepper_driver.controller.solvers.solver import NO_BOUNDS, NO_ROWS, Solution, checked

FloatArray = NDArray[np.float64]

ACCURACY = 1e-6
MAX_ITERATIONS = 4000


class OsqpSolver:
    """Keeps OSQP's workspace; the pattern of every matrix is full, so that values may become zero."""

    name = "osqp"

    def __init__(self) -> None:
        self._shape = (-1, -1)

    def solve(
        self,
        H: FloatArray,  # noqa: N803
        g: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        G: FloatArray = NO_ROWS,  # noqa: N803
        h: FloatArray = NO_BOUNDS,
    ) -> Solution:
        """Solve one problem; see :class:`Solver`."""
        n, m = len(g), len(h)
        low, high = np.concatenate([lower, np.full(m, -np.inf)]), np.concatenate([upper, h])
        # OSQP works to an absolute accuracy: a cost of unit size makes the answer the same for any unit of the weights.
        scale = 1.0 / max(float(np.abs(np.diag(H)).max()), 1e-12)
        H, g = H * scale, g * scale  # noqa: N806
        try:
            if self._shape != (n, m):
                self._set_up(n, m)
            matrix = np.concatenate([np.eye(n), G]) if m else np.eye(n)
            self._solver.update(
                Px=H[self._upper_rows, self._upper_columns],
                Ax=matrix.ravel(order="F"),
                q=g,
                l=low,
                u=high,
            )
            result = self._solver.solve(raise_error=False)
        except (ValueError, TypeError, RuntimeError, osqp.OSQPException):
            self._shape = (-1, -1)
            return Solution(np.zeros(n), "failed")
        status = result.info.status_val
        if status == osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE:
            return Solution(np.zeros(n), "infeasible")
        if status != osqp.SolverStatus.OSQP_SOLVED:
            return Solution(np.zeros(n), "failed")
        return checked(np.asarray(result.x), lower, upper, G, h)

    def _set_up(self, n: int, m: int) -> None:
        columns = np.repeat(np.arange(n), np.arange(1, n + 1))
        rows = np.concatenate([np.arange(column + 1) for column in range(n)])
        self._upper_rows, self._upper_columns = rows, columns
        cost = sparse.csc_matrix((np.where(rows == columns, 1.0, 0.1), (rows, columns)), (n, n))
        constraint = sparse.csc_matrix(np.ones((n + m, n)))
        self._solver = osqp.OSQP()
        self._solver.setup(
            cost,
            np.zeros(n),
            constraint,
            np.full(n + m, -1.0),
            np.full(n + m, 1.0),
            eps_abs=ACCURACY,
            eps_rel=ACCURACY,
            max_iter=MAX_ITERATIONS,
            warm_starting=True,
            polishing=False,
            verbose=False,
        )
        self._shape = (n, m)
