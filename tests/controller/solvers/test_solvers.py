"""Solvers against closed forms, the conditions of optimality and each other."""

from __future__ import annotations

import numpy as np
import pytest
import qpsolvers
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import Bounds, LinearConstraint, minimize

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.solvers import make_solver
from pepper_driver.controller.solvers.qpsolvers_ import QpsolversSolver
from support.examples import examples
from support.solvers import ACCURACY, SOLVERS, Problem, good_problem, optimality_gap, random_problem


@pytest.mark.parametrize("name", SOLVERS)
def test_a_diagonal_cost_is_a_clip(name: str) -> None:
    random = np.random.default_rng(1)
    solver = SOLVERS[name]()
    for _ in range(200):
        diagonal = 10.0 ** random.uniform(-1, 4, 20)
        gradient = diagonal * random.normal(size=20) * 10
        lower = random.uniform(-8, 4, 20)
        upper = lower + random.uniform(0, 8, 20) * (random.random(20) > 0.1)
        solution = solver.solve(np.diag(diagonal), gradient, lower, upper)
        expected = np.clip(-gradient / diagonal, lower, upper)
        assert solution.status == "solved"
        assert np.abs(solution.x - expected).max() < ACCURACY[name]


@pytest.mark.parametrize("m", [0, 1, 8])
def test_daqp_meets_the_conditions_of_optimality(m: int) -> None:
    random = np.random.default_rng(m)
    solver = make_solver("daqp")
    for _ in range(150):
        problem = random_problem(random, m=m)
        solution = solver.solve(*problem)
        assert solution.status == "solved"
        assert optimality_gap(problem, solution.x) < 1e-9


def test_the_check_of_optimality_sees_a_wrong_point() -> None:
    problem = good_problem(np.random.default_rng(3), 2)
    x = make_solver("daqp").solve(*problem).x
    assert optimality_gap(problem, x) < 1e-9
    assert optimality_gap(problem, x * 0.999) > 1e-5


def slsqp(problem: Problem) -> FloatArray:
    """The minimiser that scipy finds."""
    cost, gradient, lower, upper, rows, bound = problem

    def value(x: FloatArray) -> float:
        return float(0.5 * x @ cost @ x + gradient @ x)

    def slope(x: FloatArray) -> FloatArray:
        at: FloatArray = cost @ x + gradient
        return at

    result = minimize(
        value,
        np.zeros(len(gradient)),
        jac=slope,
        bounds=Bounds(lower, upper),
        constraints=LinearConstraint(rows, -np.inf, bound),
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return np.asarray(result.x, dtype=np.float64)


def test_daqp_finds_the_minimum_that_scipy_finds() -> None:
    random = np.random.default_rng(5)
    for _ in range(10):
        problem = good_problem(random, 3)
        assert np.abs(make_solver("daqp").solve(*problem).x - slsqp(problem)).max() < 1e-5


@pytest.mark.parametrize("m", [0, 8])
@pytest.mark.parametrize("name", ["osqp", "qpsolvers"])
def test_the_other_solvers_agree_with_daqp(name: str, m: int) -> None:
    random = np.random.default_rng(11)
    solver, exact = SOLVERS[name](), make_solver("daqp")
    for _ in range(60):
        cost, gradient, *limits = random_problem(random, m=m)
        cost += 0.02 * cost.max() * np.eye(20)  # the minimiser is then well determined
        solution = solver.solve(cost, gradient, *limits)
        assert solution.status == "solved"
        assert np.abs(solution.x - exact.solve(cost, gradient, *limits).x).max() < 1e-5


@given(power=st.integers(-6, 6), seed=st.integers(0, 1000))
@examples(40)
@pytest.mark.parametrize("name", SOLVERS)
def test_the_unit_of_the_cost_does_not_matter(name: str, power: int, seed: int) -> None:
    cost, gradient, *limits = good_problem(np.random.default_rng(seed), 2)
    solver = SOLVERS[name]()
    expected = solver.solve(cost, gradient, *limits)
    solution = solver.solve(10.0**power * cost, 10.0**power * gradient, *limits)
    assert solution.status == expected.status == "solved"
    assert np.abs(solution.x - expected.x).max() < ACCURACY[name]


@pytest.mark.parametrize("m", [0, 2])
@pytest.mark.parametrize("name", SOLVERS)
def test_infinite_bounds_do_not_bind(name: str, m: int) -> None:
    problem = good_problem(np.random.default_rng(2), m)
    problem[2][:], problem[3][:], problem[5][:] = -np.inf, np.inf, np.inf
    solution = SOLVERS[name]().solve(*problem)
    assert solution.status == "solved"
    assert np.abs(solution.x - np.linalg.solve(problem[0], -problem[1])).max() < 1e-5


@pytest.mark.parametrize("name", SOLVERS)
def test_a_variable_without_cost_is_no_obstacle(name: str) -> None:
    diagonal = np.array([1e4, 10.0, 1e-6])
    solution = SOLVERS[name]().solve(
        np.diag(diagonal), np.array([-1e4, -10.0, 0.0]), -np.full(3, 5.0), np.full(3, 5.0)
    )
    assert solution.status == "solved"
    assert np.abs(solution.x - [1, 1, 0]).max() < 1e-5


@pytest.mark.parametrize("name", SOLVERS)
def test_arguments_stay_as_they_are_and_solutions_stay_too(name: str) -> None:
    random = np.random.default_rng(4)
    solver, problem = SOLVERS[name](), good_problem(random, 2)
    before = [part.copy() for part in problem]
    first = solver.solve(*problem)
    kept = first.x.copy()
    solver.solve(*good_problem(random, 2))
    assert all(np.array_equal(a, b) for a, b in zip(before, problem, strict=True))
    assert np.array_equal(first.x, kept)


def test_solvers_by_name() -> None:
    assert make_solver("daqp").name == "daqp"
    assert make_solver("osqp").name == "osqp"
    for name in qpsolvers.available_solvers:
        assert make_solver(name).name == name
    with pytest.raises(UnknownNameError) as caught:
        make_solver("dapq")
    assert {"daqp", "osqp", *qpsolvers.available_solvers} == set(caught.value.choices)
    assert "did you mean daqp" in str(caught.value)
    assert "osqp" in str(caught.value)


def test_another_name_of_qpsolvers_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qpsolvers, "available_solvers", ["daqp", "osqp", "other"])
    solver = make_solver("other")
    assert isinstance(solver, QpsolversSolver)
    # Unknown to qpsolvers after all: reported, not raised.
    assert solver.solve(*good_problem(np.random.default_rng(0), 0)).status == "failed"
