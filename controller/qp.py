"""Quadratic program of one cycle: cost of the tasks, acceleration bounds, rows; and their relaxation in a conflict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.constraints.constraint import LinearInequality, stack
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.solvers import Solver
from pepper_driver.controller.solvers.daqp_ import DaqpSolver
from pepper_driver.controller.solvers.solver import NO_BOUNDS, NO_ROWS
from pepper_driver.controller.tasks import Task
from pepper_driver.controller.tasks.task import Gains, TaskRows

MIN_COST = 1e-4
"""Relative to the largest diagonal entry of the cost: smaller entries are regularised as this one."""

SLACK_WEIGHT = 1e4
"""Cost of violating a relaxed row per (rad/s2)^2, relative to the largest diagonal entry of the cost."""

SLACK_MARGIN = 1e-6
"""[rad/s2] Added to the least violation of a relaxed row, so that the next problem has room for rounding."""

multiply = np.multiply

NO_INEQUALITY = LinearInequality(NO_ROWS, NO_BOUNDS, ())

QpStatus = Literal["solved", "relaxed", "infeasible", "failed"]


class QpResult(NamedTuple):
    """Accelerations (20,), valid only if the outcome is solved or relaxed."""

    acceleration: FloatArray
    outcome: QpStatus


@dataclass(slots=True)
class TaskBlock:
    """Block of a task: its rows, the (20,) mask of its velocities, and the present gains of its rows."""

    task: Task
    place: slice
    rows: TaskRows
    joint_mask: FloatArray
    gains: Gains | None = None


class QuadraticProgram:
    """Quadratic program with the rows of all tasks in one matrix, so that the cost is one product.

    The arrays are allocated once, not in every cycle.

    Args:
        nv: Number of accelerations.
        regularisation: Ratio to each acceleration's own cost; the unit of the weights thus cancels out.
        rest_rate: Rate at which a motion that no task requests decays [1/s].
    """

    def __init__(self, nv: int, regularisation: float, rest_rate: float) -> None:
        self._nv, self._ratio, self._rest_rate = nv, regularisation, rest_rate
        self.hessian, self.gradient = np.zeros((nv, nv)), np.zeros(nv)
        self._diagonal = self.hessian.ravel()[:: nv + 1]
        self._regularisation, self._resting, self._rest = np.zeros((3, nv))
        # Whatever the solver in use: this one decides, in a bounded time, if there is a solution.
        self._exact = DaqpSolver()
        self.allocate((), None)

    def allocate(self, tasks: Sequence[Task], model: RobotModel | None) -> None:
        """Allocate the rows of every task."""
        nv, count = self._nv, sum(task.rows for task in tasks)
        self._jacobian, self._mask, self._masked = np.zeros((3, count, nv))
        self._weight, self._weighted = np.zeros((2, count, nv))
        self._error, self._rate, self._bias, self._requested = np.zeros((4, count))
        self._stiffness, self._damping, self._damped = np.zeros((3, count))
        self._blocks: list[TaskBlock] = []
        start = 0
        for task in tasks:
            place = slice(start, start + task.rows)
            start += task.rows
            if model is not None:
                arrays = (self._jacobian, self._error, self._rate, self._bias, self._requested)
                rows = TaskRows(*(array[place] for array in arrays))
                task.attach(model, rows)
                self._blocks.append(TaskBlock(task, place, rows, task.joint_mask(model)))
        if all(block.joint_mask.all() for block in self._blocks):
            self._masked = self._jacobian

    def assemble(self, model: RobotModel, dt: float) -> None:
        """Evaluate all tasks at the model's state and form the cost."""
        with_reference = []
        for block in self._blocks:
            task = block.task
            if task.has_reference:
                with_reference.append(block)
                task.advance(model, dt)
            task.compute(model, block.rows)
            task.up_to_date = True
            if task.gains is not block.gains:
                self._take_gains(block)
        requested, damped, weighted = self._requested, self._damped, self._weighted
        H, g, v, rate = self.hessian, self.gradient, model.v, self._rate
        # Positional outputs and methods are the quickest calls of NumPy.
        self._jacobian.dot(v, rate)
        multiply(self._stiffness, self._error, requested)
        multiply(self._damping, rate, damped)
        requested -= damped
        requested -= self._bias
        for block in with_reference:
            block.task.add_feedforward(block.rows)
        # Two arrays, J and W J: NumPy computes the product of an array with itself by a slower routine.
        masked = self._masked
        if masked is not self._jacobian:
            multiply(self._jacobian, self._mask, masked)
        multiply(masked, self._weight, weighted)
        weighted.T.dot(masked, H)
        requested.dot(weighted, g)
        self._regularise()
        self._diagonal += self._regularisation
        multiply(self._resting, v, self._rest)
        np.subtract(self._rest, g, g)

    def _take_gains(self, block: TaskBlock) -> None:
        gains, place = block.task.gains, block.place
        block.gains = gains
        self._stiffness[place], self._damping[place] = gains.stiffness, gains.damping
        self._weight[place] = gains.weight[:, None]
        self._mask[place] = block.joint_mask

    def _regularise(self) -> None:
        """Add a fraction of each variable's own cost to it; movements that no task requests come to rest."""
        min_cost, regularisation = MIN_COST * self._diagonal.max(), self._regularisation
        np.maximum(self._diagonal, min_cost if min_cost > 0 else 1.0, out=regularisation)
        multiply(self._ratio, regularisation, regularisation)
        multiply(self._rest_rate, regularisation, self._resting)

    def solve(
        self,
        solver: Solver,
        lower: FloatArray,
        upper: FloatArray,
        groups: Sequence[tuple[int, LinearInequality]],
    ) -> QpResult:
        """Minimise the cost within the acceleration bounds and the rows.

        Rows that exclude each other are relaxed: first those of the lowest priority may be violated at a high cost.
        Those of the next follow, until there is a solution. The acceleration bounds are never violated.

        Args:
            solver: Solver of the first attempt.
            lower: (20,) acceleration bounds.
            upper: (20,) acceleration bounds.
            groups: Priorities with their rows.
        """
        rows = stack([part for _, part in groups]) if groups else NO_INEQUALITY
        problem = (self.hessian, self.gradient, lower, upper, rows.matrix, rows.bound)
        solution = solver.solve(*problem)
        if (
            solution.status == "failed"
        ):  # not converged: a problem that can be solved needs no relaxation
            solution = self._exact.solve(*problem)
        if solution.status == "solved" or not groups:
            return QpResult(solution.x, solution.status)
        priorities = np.concatenate(
            [np.full(len(part.bound), priority) for priority, part in groups]
        )
        x = self._relax_constraints(lower, upper, rows, priorities)
        return QpResult(solution.x, solution.status) if x is None else QpResult(x, "relaxed")

    def _relax_constraints(
        self,
        lower: FloatArray,
        upper: FloatArray,
        rows: LinearInequality,
        priorities: NDArray[np.int_],
    ) -> FloatArray | None:
        """Return the best accelerations with rows relaxed up to the lowest sufficient priority; None without any.

        Relaxed rows still count by priority: those of the highest are violated as little as possible, regardless of
        those below them; then the next.
        """
        relaxed: list[int] = []
        for priority in sorted(set(priorities.tolist())):
            relaxed.insert(0, priority)
            bound = rows.bound.copy()
            x = None
            for lexical, own in enumerate(relaxed):
                included = priorities >= own
                part = LinearInequality(rows.matrix[included], bound[included], ())
                x, slack = self._soft(lower, upper, part, priorities[included] == own)
                if x is None:
                    break
                if lexical + 1 < len(relaxed):
                    bound[priorities == own] += slack
            if x is not None:
                return x
        return None

    def _soft(
        self, lower: FloatArray, upper: FloatArray, rows: LinearInequality, soft: BoolArray
    ) -> tuple[FloatArray | None, FloatArray]:
        """Return the solution in which slacks may violate the ``soft`` rows, and the slack of each row.

        The cost of a slack is in units of the largest entry of its row. DAQP solves this for any solver in use: OSQP
        does not converge with costs of such different size.
        """
        nv, count = self._nv, int(soft.sum())
        size = np.abs(rows.matrix).max(axis=1, initial=0.0)
        size[size <= 0.0] = 1.0
        matrix = np.zeros((len(rows.bound), nv + count))
        matrix[:, :nv] = rows.matrix / size[:, None]
        matrix[np.flatnonzero(soft), nv + np.arange(count)] = -1.0
        H = np.zeros((nv + count, nv + count))
        H[:nv, :nv] = self.hessian
        H[range(nv, nv + count), range(nv, nv + count)] = SLACK_WEIGHT * self._diagonal.max()
        solution = self._exact.solve(
            H,
            np.concatenate([self.gradient, np.zeros(count)]),
            np.concatenate([lower, np.zeros(count)]),
            np.concatenate([upper, np.full(count, np.inf)]),
            matrix,
            rows.bound / size,
        )
        if solution.status != "solved":
            return None, np.zeros(count)
        return solution.x[:nv], (solution.x[nv:] + SLACK_MARGIN) * size[soft]

    def acceleration_errors(self, acceleration: FloatArray) -> list[tuple[Task, FloatArray, float]]:
        """Return every task with the errors of (20,) accelerations in its rows of the last cycle, and their cost."""
        acceleration_error = self._masked @ acceleration - self._requested
        cost = self._weight[:, 0] * acceleration_error**2
        return [
            (s.task, acceleration_error[s.place], float(cost[s.place].sum())) for s in self._blocks
        ]
