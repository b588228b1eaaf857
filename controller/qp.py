"""Quadratic program of one cycle: cost of the tasks, acceleration bounds, rows; and their relaxation in a conflict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel
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

NO_INEQUALITY = LinearInequality(NO_ROWS, NO_BOUNDS, ())

QpStatus = Literal["solved", "relaxed", "infeasible", "failed"]


class QpResult(NamedTuple):
    """Accelerations (20,), valid only if the outcome is solved or relaxed."""

    acceleration: FloatArray
    outcome: QpStatus


@dataclass(slots=True)
class TaskBlock:
    """Block of a task: its rows, and their present gains."""

    task: Task
    place: slice
    rows: TaskRows
    gains: Gains | None = None


@kernel
def _feedback(
    jacobian: Matrix[FloatArray],
    velocity: FloatArray,
    error: FloatArray,
    bias: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    rate: Out[FloatArray],
    requested: Out[FloatArray],
) -> None:
    """Write the rates J v and the requested accelerations, k e - d J v - Jdot v, of all rows."""
    for row in range(len(error)):
        rate[row] = 0.0
        for i in range(len(velocity)):
            rate[row] += jacobian[row, i] * velocity[i]
        requested[row] = stiffness[row] * error[row] - damping[row] * rate[row] - bias[row]


@kernel
def _cost(
    jacobian: Matrix[FloatArray],
    mask: Matrix[FloatArray],
    weight: FloatArray,
    requested: FloatArray,
    velocity: FloatArray,
    ratio: float,
    rest_rate: float,
    moved: Out[FloatArray],
    hessian: Out[Matrix[FloatArray]],
    gradient: Out[FloatArray],
) -> None:
    """Write the cost of all rows: H = sum of w j j', g = - sum of w a j, with j = mask * J of a row.

    Each variable's own cost has a fraction added, with which a movement that no task requests comes to rest.

    Args:
        jacobian: (rows, n) J of all rows.
        mask: (rows, n) 1 where a row may move a variable, else 0.
        weight: (rows,) w.
        requested: (rows,) a.
        velocity: (n,)
        ratio: Of what is added to the own cost of a variable.
        rest_rate: Rate at which its motion then decays [1/s].
        moved: (n,) for j.
        hessian: (n, n) to write.
        gradient: (n,) to write.
    """
    n = len(velocity)
    hessian[:] = 0.0
    gradient[:] = 0.0
    for row in range(len(weight)):
        for i in range(n):
            moved[i] = jacobian[row, i] * mask[row, i]
        for i in range(n):
            weighted = moved[i] * weight[row]
            gradient[i] += requested[row] * weighted
            if weighted == 0.0:  # most rows move few variables
                continue
            for k in range(n):
                hessian[i, k] += weighted * moved[k]
    largest = 0.0
    for i in range(n):
        largest = np.maximum(largest, hessian[i, i])
    smallest = MIN_COST * largest if largest > 0.0 else 1.0
    for i in range(n):
        own = ratio * np.maximum(hessian[i, i], smallest)
        hessian[i, i] += own
        gradient[i] = rest_rate * own * velocity[i] - gradient[i]


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
        self._moved = np.zeros(nv)
        self._feedback, self._cost = _feedback.load(), _cost.load()
        self._superposed: FloatArray | None = None
        # Whatever the solver in use: this one decides, in a bounded time, if there is a solution.
        self._exact = DaqpSolver()
        self.allocate((), None)

    def allocate(self, tasks: Sequence[Task], model: RobotModel | None) -> None:
        """Allocate the rows of every task."""
        nv, count = self._nv, sum(task.rows for task in tasks)
        self._jacobian, self._mask = np.zeros((2, count, nv))
        self._error, self._rate, self._bias, self._requested = np.zeros((4, count))
        self._stiffness, self._damping, self._weight = np.zeros((3, count))
        self._blocks: list[TaskBlock] = []
        start = 0
        for task in tasks:
            place = slice(start, start + task.rows)
            start += task.rows
            if model is not None:
                arrays = (self._jacobian, self._error, self._rate, self._bias, self._requested)
                rows = TaskRows(*(array[place] for array in arrays))
                task.attach(model, rows)
                self._mask[place] = task.joint_mask(model)
                self._blocks.append(TaskBlock(task, place, rows))

    def assemble(self, model: RobotModel, dt: float) -> None:
        """Evaluate all tasks at the model's state and form the cost."""
        self._superposed = None
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
        self._feedback(
            self._jacobian,
            model.v,
            self._error,
            self._bias,
            self._stiffness,
            self._damping,
            self._rate,
            self._requested,
        )
        for block in with_reference:
            block.task.add_feedforward(block.rows)
        self._cost(
            self._jacobian,
            self._mask,
            self._weight,
            self._requested,
            model.v,
            self._ratio,
            self._rest_rate,
            self._moved,
            self.hessian,
            self.gradient,
        )

    def superpose(self, acceleration: FloatArray) -> None:
        """Have the tasks ask for (20,) accelerations more: those of a motion that is added to all of them."""
        self._superposed = acceleration
        self.gradient -= self.hessian @ acceleration

    def _take_gains(self, block: TaskBlock) -> None:
        gains, place = block.task.gains, block.place
        block.gains = gains
        self._stiffness[place], self._damping[place] = gains.stiffness, gains.damping
        self._weight[place] = gains.weight

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
        H[range(nv, nv + count), range(nv, nv + count)] = (
            SLACK_WEIGHT * self.hessian.diagonal().max()
        )
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
        if self._superposed is not None:
            acceleration = acceleration - self._superposed
        acceleration_error = (self._jacobian * self._mask) @ acceleration - self._requested
        cost = self._weight * acceleration_error**2
        return [
            (s.task, acceleration_error[s.place], float(cost[s.place].sum())) for s in self._blocks
        ]
