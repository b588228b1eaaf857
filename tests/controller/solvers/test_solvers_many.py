"""Solvers on very many problems, and on those that the controller makes with five tasks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import ComTask, FrameTask, Reference, RobotModel, WholeBodyController
from pepper_driver.controller.solvers import Solution, Solver, make_solver
from pepper_driver.controller.solvers.solver import NO_BOUNDS, NO_ROWS
from support.controller import MIDDLE, ROBOT, SETTINGS, random_posture
from support.solvers import Problem, optimality_gap, random_problem

MODEL = RobotModel(ROBOT)
WRISTS = ("l_wrist", "r_wrist")
HOLD = 200  # ticks
THIRTY_SECONDS, TEN_SECONDS = 2500, 833  # ticks


class Recorder:
    """Solves by another solver and keeps problems and answers."""

    name = "recorder"

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.seen: list[tuple[Problem, Solution]] = []

    def solve(
        self,
        H: FloatArray,
        g: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        G: FloatArray = NO_ROWS,
        h: FloatArray = NO_BOUNDS,
    ) -> Solution:
        solution = self._solver.solve(H, g, lower, upper, G, h)
        problem = (H.copy(), g.copy(), lower.copy(), upper.copy(), G.reshape(-1, len(g)), h)
        self.seen.append((problem, solution))
        return solution


def five_tasks(solver: str = "daqp", scale: float = 1.0) -> WholeBodyController:
    """Posture, base, both wrists and centre of mass; all weights multiplied by ``scale``."""
    control = WholeBodyController(ROBOT, replace(SETTINGS, solver=solver))
    for link in WRISTS:
        control.add(FrameTask(link, base=True))
    control.add(ComTask(base=True))
    for task in control.tasks:
        task.weight *= scale
    return control


def wander(control: WholeBodyController, ticks: int, *, reach: float = 0.4) -> list[Reference]:
    """References on the path to poses of the wrists ``reach`` [rad] about the middle, and to random postures."""
    random = np.random.default_rng(12)
    wrists = [task for task in control.tasks if isinstance(task, FrameTask)]
    references = []
    for tick in range(ticks):
        if tick % HOLD == 0:
            near = np.clip(
                MIDDLE + random.uniform(-reach, reach, len(MIDDLE)), ROBOT.lower, ROBOT.upper
            )
            control.posture.target = random_posture(random)
            for task, link in zip(wrists, WRISTS, strict=True):
                task.target = MODEL.link_pose(link, near)
        references.append(control.step())
        assert control.status.solver == "solved"
    return references


def max_difference(one: list[Reference], two: list[Reference]) -> float:
    """Largest difference of the joint positions [rad]."""
    return max(float(np.abs(a.position - b.position).max()) for a, b in zip(one, two, strict=True))


# -- the controller's problems ----------------------------------------------------------------------------------


def test_daqp_solves_the_controllers_problems_exactly() -> None:
    control = five_tasks()
    control._solver = recorder = Recorder(make_solver("daqp"))
    wander(control, TEN_SECONDS, reach=0.8)  # more than five tasks can have together
    bound = 0
    for problem, solution in recorder.seen:
        assert optimality_gap(problem, solution.x) < 1e-9
        bound += int(((solution.x <= problem[2]) | (solution.x >= problem[3])).any())
    assert bound > TEN_SECONDS / 2  # limits mattered


def test_osqp_takes_the_same_path_with_five_tasks_for_thirty_seconds() -> None:
    exact, other = (wander(five_tasks(solver), THIRTY_SECONDS) for solver in ("daqp", "osqp"))
    assert max_difference(exact, other) < 1e-6
    loads = [np.abs(a.load_torque - b.load_torque).max() for a, b in zip(exact, other, strict=True)]
    assert max(loads) < 1e-4


@pytest.mark.parametrize(("solver", "error"), [("daqp", 1e-9), ("osqp", 1e-6)])
def test_the_unit_of_the_weights_of_five_tasks_does_not_matter(solver: str, error: float) -> None:
    expected = wander(five_tasks(solver), TEN_SECONDS)
    for scale in (1e-4, 1e-2, 1e2, 1e4):
        scaled = wander(five_tasks(solver, scale), TEN_SECONDS)
        assert max_difference(expected, scaled) < error


# -- many problems ----------------------------------------------------------------------------------------------


def many(count: int) -> Iterator[Problem]:
    """Every third has a row twice and one of zeros, every fifth three variables that cannot move."""
    random = np.random.default_rng(2024)
    for number in range(count):
        yield random_problem(random, repeated=number % 3 == 0, locked=number % 5 == 0)


def contradiction(problem: Problem) -> Problem:
    """With the first row turned round and asked for beyond reach of itself."""
    cost, gradient, lower, upper, rows, bound = problem
    return (
        cost,
        gradient,
        lower,
        upper,
        np.concatenate([rows, -rows[:1]]),
        np.concatenate([bound, -bound[:1] - 0.1]),
    )


def test_daqp_is_right_about_twenty_thousand_problems() -> None:
    """A convex problem's minimum is where the conditions of optimality hold: no other solver is asked."""
    solver: Solver = make_solver("daqp")
    for number, problem in enumerate(many(20_000)):
        if number % 10 == 0:
            assert solver.solve(*contradiction(problem)).status == "infeasible", number
        solution = solver.solve(*problem)
        assert solution.status == "solved", number
        # The cost is as good as 1e-9; a row may be violated by a few times that.
        assert optimality_gap(problem, solution.x) < 1e-8, number
