"""Problems without solution, with NaN or infinity, with a cost that is not convex: reported, and forgotten."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pepper_driver.controller.solvers import make_solver
from pepper_driver.controller.solvers.solver import SolutionCheck
from support.solvers import SOLVERS, Problem, assert_recovers, good_problem


def contradictory(problem: Problem) -> None:
    problem[4][1] = -problem[4][0]
    problem[5][:] = 1.0, -2.0


def beyond_the_box(problem: Problem) -> None:
    problem[4][0] = 1.0
    problem[5][0] = -100.0


def unreachable(problem: Problem) -> None:
    problem[5][0] = -1e31


def minus_infinity(problem: Problem) -> None:
    problem[5][0] = -np.inf


def zero_row(problem: Problem) -> None:
    problem[4][0] = 0.0
    problem[5][0] = -1.0


def crossed_box(problem: Problem) -> None:
    problem[2][3] = 2.0


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(
    "spoil", [contradictory, beyond_the_box, unreachable, minus_infinity, zero_row, crossed_box]
)
@pytest.mark.parametrize("first", [True, False])
def test_a_problem_without_solution_is_reported_and_forgotten(
    name: str, spoil: Callable[[Problem], None], first: bool
) -> None:
    solver = SOLVERS[name]()
    if not first:
        assert_recovers(solver, 2)
    problem = good_problem(np.random.default_rng(2), 2)
    spoil(problem)
    assert solver.solve(*problem).status == "infeasible"
    assert_recovers(solver, 2)
    for _ in range(3):
        assert solver.solve(*problem).status == "infeasible"
    assert_recovers(solver, 2)
    assert_recovers(solver, 0)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("part", range(6))
@pytest.mark.parametrize("value", [np.nan, "all"])
@pytest.mark.parametrize("first", [True, False])
def test_numbers_that_are_none_are_no_solution(
    name: str, part: int, value: float | str, first: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    solver = SOLVERS[name]()
    if not first:
        assert_recovers(solver, 2)
    problem = good_problem(np.random.default_rng(2), 2)
    if value == "all":
        problem[part][:] = np.nan
    else:
        problem[part].flat[0] = value
    assert solver.solve(*problem).status != "solved"
    assert_recovers(solver, 2)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("part", "value"), [(0, np.inf), (1, np.inf), (1, 1e300)])
def test_an_infinite_cost_is_no_solution(name: str, part: int, value: float) -> None:
    solver = SOLVERS[name]()
    problem = good_problem(np.random.default_rng(2), 2)
    problem[part].flat[0] = value
    assert solver.solve(*problem).status != "solved"
    assert_recovers(solver, 2)


@pytest.mark.parametrize("m", [0, 2])
def test_osqp_does_not_go_on_with_the_last_cost_when_one_is_not_convex(
    m: int, capfd: pytest.CaptureFixture[str]
) -> None:
    solver = make_solver("osqp")
    assert_recovers(solver, m)
    problem = good_problem(np.random.default_rng(2), m)
    problem[0][0, 0] = -1.0
    assert solver.solve(*problem).status == "failed"
    assert_recovers(solver, m)
    assert capfd.readouterr().out == ""


def test_a_point_outside_called_solved_has_failed() -> None:
    lower, upper, rows, bound = -np.ones(2), np.ones(2), np.array([[1.0, 1.0]]), np.array([1.0])
    checked = SolutionCheck().check
    none = np.zeros((0, 2)), np.zeros(0)
    assert checked(np.array([0.0, 1.1]), lower, upper, *none).status == "failed"
    assert checked(np.array([0.0, np.nan]), lower, upper, *none).status == "failed"
    assert checked(np.array([0.9, 0.9]), lower, upper, rows, bound).status == "failed"
    assert checked(np.array([0.2, 0.3]), lower, upper, rows, np.array([np.nan])).status == "failed"
    rounded = checked(np.array([1.0 + 1e-9, -0.5]), lower, upper, rows, bound)
    assert rounded.status == "solved"
    assert rounded.x.tolist() == [1.0, -0.5]
