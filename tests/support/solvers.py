"""Quadratic programs to try solvers on, and how good an answer is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.solvers import Solver, make_solver
from pepper_driver.controller.solvers.qpsolvers_ import QpsolversSolver

Problem = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]

SOLVERS: dict[str, Callable[[], Solver]] = {
    "daqp": lambda: make_solver("daqp"),
    "osqp": lambda: make_solver("osqp"),
    "qpsolvers": lambda: QpsolversSolver("daqp"),
}
ACCURACY = {"daqp": 1e-12, "osqp": 1e-5, "qpsolvers": 1e-12}


def random_problem(
    random: np.random.Generator,
    n: int = 20,
    m: int = 8,
    *,
    locked: bool | None = None,
    repeated: bool | None = None,
) -> Problem:
    """Like those of a controller: rank deficient cost with a ridge; x = 0 is always feasible.

    ``locked``: three variables may not move; ``repeated``: one row twice and one of zeros; by chance unless given.
    """
    rank = int(random.integers(6, 26))
    tasks = random.normal(size=(rank, n)) * 10.0 ** random.uniform(-1, 1)
    ridge = 10.0 ** random.uniform(-6, 1)
    cost = tasks.T @ tasks + ridge * np.eye(n)
    gradient = -tasks.T @ random.normal(size=rank) * 10.0 ** random.uniform(-1, 1)
    lower, upper = -random.uniform(0.1, 5, n), random.uniform(0.1, 5, n)
    if random.random() < 0.3 if locked is None else locked:
        still = random.choice(n, 3, replace=False)
        lower[still] = upper[still] = 0.0
    rows, bound = random.normal(size=(m, n)), random.uniform(0, 2, m)
    if m >= 3 and (random.random() < 0.4 if repeated is None else repeated):
        rows[1], bound[1] = rows[0], bound[0]
        rows[2] = 0.0
    if random.random() < 0.3 and m:
        bound[-1] = np.inf
    return cost, gradient, lower, upper, rows, bound


def optimality_gap(problem: Problem, x: FloatArray) -> float:
    """Largest violation of the KKT conditions, with the best multipliers there are, relative to the gradient."""
    cost, gradient, lower, upper, rows, bound = problem
    near = 1e-9 * (1 + np.abs(x).max())
    identity = np.eye(len(x))
    active = np.concatenate(
        [identity[x >= upper - near], -identity[x <= lower + near], rows[rows @ x >= bound - near]]
    )
    slope = cost @ x + gradient
    left = nnls(active.T, -slope)[1] if len(active) else float(np.linalg.norm(slope))
    outside = np.concatenate([lower - x, x - upper, rows @ x - bound]).max(initial=0.0)
    return max(left / (1 + float(np.linalg.norm(gradient))), float(outside))


def good_problem(random: np.random.Generator, m: int) -> Problem:
    half = random.normal(size=(6, 6))
    return (
        half @ half.T + np.eye(6),
        3 * random.normal(size=6),
        -np.ones(6),
        np.ones(6),
        random.normal(size=(m, 6)),
        random.uniform(0, 1, m),
    )


def assert_recovers(solver: Solver, m: int) -> None:
    random = np.random.default_rng(7)
    for _ in range(3):
        problem = good_problem(random, m)
        solution = solver.solve(*problem)
        assert solution.status == "solved"
        assert optimality_gap(problem, make_solver("daqp").solve(*problem).x) < 1e-9
        assert np.abs(solution.x - make_solver("daqp").solve(*problem).x).max() < 1e-5
