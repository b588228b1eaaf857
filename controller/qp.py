"""The quadratic program of one cycle: the tasks' cost, the box, the rows; and what is given up if they conflict."""

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
"""Of the largest diagonal entry of the cost: an acceleration that tasks care less for is regularised as this one."""

SLACK_WEIGHT = 1e4
"""Of the largest diagonal entry of the cost: what breaking a row that was given up costs, per (rad/s2)^2."""

SLACK_MARGIN = 1e-6
"""[rad/s2] What a row that was given up may be broken by beyond its least, so that the next solution has room."""

multiply = np.multiply

NOTHING = LinearInequality(NO_ROWS, NO_BOUNDS, ())

QpStatus = Literal["solved", "relaxed", "infeasible", "failed"]


class QpResult(NamedTuple):
    """Accelerations (20,), to be used only when the outcome is solved or relaxed."""

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
    """Stacks the tasks' rows in one matrix, so that the cost is one product; nothing else is allocated in a cycle.

    Args:
        nv: Number of accelerations.
        regularisation: Ratio to each acceleration's own cost; so the unit of the weights cancels out.
        rest_rate: Rate at which a motion that no task requests dies out [1/s].
    """

    def __init__(self, nv: int, regularisation: float, rest_rate: float) -> None:
        self._nv, self._ratio, self._rest_rate = nv, regularisation, rest_rate
        self.hessian, self.gradient = np.zeros((nv, nv)), np.zeros(nv)
        self._diagonal = self.hessian.ravel()[:: nv + 1]
        self._regularisation, self._resting, self._rest = np.zeros((3, nv))
        self._exact = DaqpSolver()
        self.allocate((), None)

    def allocate(self, tasks: Sequence[Task], model: RobotModel | None) -> None:
        """Give every task its rows."""
        nv, count = self._nv, sum(task.rows for task in tasks)
        self._jacobian, self._mask, self._masked = np.zeros((3, count, nv))
        self._weight, self._weighted = np.zeros((2, count, nv))
        self._error, self._rate, self._bias, self._wanted = np.zeros((4, count))
        self._stiffness, self._damping, self._damped = np.zeros((3, count))
        self._slots: list[TaskBlock] = []
        start = 0
        for task in tasks:
            place = slice(start, start + task.rows)
            start += task.rows
            if model is not None:
                arrays = (self._jacobian, self._error, self._rate, self._bias, self._wanted)
                rows = TaskRows(*(array[place] for array in arrays))
                task.attach(model, rows)
                self._slots.append(TaskBlock(task, place, rows, task.joint_mask(model)))
        if all(slot.joint_mask.all() for slot in self._slots):
            self._masked = self._jacobian

    def assemble(self, model: RobotModel, dt: float) -> None:
        """Evaluate all tasks at the model's state and form the cost."""
        driven = []
        for slot in self._slots:
            task = slot.task
            if task.driven:
                driven.append(slot)
                task.advance(model, dt)
            task.compute(model, slot.rows)
            task.up_to_date = True
            if task.gains is not slot.gains:
                self._take_gains(slot)
        wanted, damped, weighted = self._wanted, self._damped, self._weighted
        H, g, v, rate = self.hessian, self.gradient, model.v, self._rate
        # Positional outputs and methods: NumPy's quickest ways to say these things.
        self._jacobian.dot(v, rate)
        multiply(self._stiffness, self._error, wanted)
        multiply(self._damping, rate, damped)
        wanted -= damped
        wanted -= self._bias
        for slot in driven:
            slot.task.add_feedforward(slot.rows)
        # Two arrays, J and W J: as one times itself the product would take the slower way of symmetric ones.
        masked = self._masked
        if masked is not self._jacobian:
            multiply(self._jacobian, self._mask, masked)
        multiply(masked, self._weight, weighted)
        weighted.T.dot(masked, H)
        wanted.dot(weighted, g)
        self._regularise()
        self._diagonal += self._regularisation
        multiply(self._resting, v, self._rest)
        np.subtract(self._rest, g, g)

    def _take_gains(self, slot: TaskBlock) -> None:
        gains, place = slot.task.gains, slot.place
        slot.gains = gains
        self._stiffness[place], self._damping[place] = gains.stiffness, gains.damping
        self._weight[place] = gains.weight[:, None]
        self._mask[place] = slot.joint_mask

    def _regularise(self) -> None:
        """Add a fraction of each variable's own cost to it; movements that no task asks for come to rest."""
        least, regularisation = MIN_COST * self._diagonal.max(), self._regularisation
        np.maximum(self._diagonal, least if least > 0 else 1.0, out=regularisation)
        multiply(self._ratio, regularisation, regularisation)
        multiply(self._rest_rate, regularisation, self._resting)

    def solve(
        self,
        solver: Solver,
        lower: FloatArray,
        upper: FloatArray,
        groups: Sequence[tuple[int, LinearInequality]],
    ) -> QpResult:
        """Minimise the cost inside the box and the rows.

        Rows that cannot all be kept are relaxed: those of the lowest priority first may be broken at a high price, then
        also those of the next, until there is a solution. The box is never broken.

        Args:
            solver: Which.
            lower: (20,) of the box.
            upper: (20,) of the box.
            groups: Ranks with their rows.
        """
        rows = stack([part for _, part in groups]) if groups else NOTHING
        problem = (self.hessian, self.gradient, lower, upper, rows.matrix, rows.bound)
        solution = solver.solve(*problem)
        if (
            solution.status == "failed"
        ):  # not converged: what can be solved is no reason to give anything up
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
        """Return the best accelerations when rows up to some priority, the lowest that will do, are given up; or None.

        What is given up still counts by priority: rows of the highest are broken as little as possible, whatever those
        below them want; then the next.
        """
        given_up: list[int] = []
        for priority in sorted(set(priorities.tolist())):
            given_up.insert(0, priority)
            bound = rows.bound.copy()
            x = None
            for lexical, own in enumerate(given_up):
                kept = priorities >= own
                part = LinearInequality(rows.matrix[kept], bound[kept], ())
                x, slack = self._soft(lower, upper, part, priorities[kept] == own)
                if x is None:
                    break
                if lexical + 1 < len(given_up):
                    bound[priorities == own] += slack
            if x is not None:
                return x
        return None

    def _soft(
        self, lower: FloatArray, upper: FloatArray, rows: LinearInequality, soft: BoolArray
    ) -> tuple[FloatArray | None, FloatArray]:
        """Return the solution in which slacks may break the ``soft`` rows, and the slack of each row.

        Slacks are priced in units of each row's largest entry. Found by DAQP whatever solver is in use: with costs as
        far apart as these, OSQP does not converge.
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
        """Every task with what (20,) accelerations miss of its rows and what that costs, in the last cycle's rows."""
        acceleration_error = self._masked @ acceleration - self._wanted
        price = self._weight[:, 0] * acceleration_error**2
        return [
            (s.task, acceleration_error[s.place], float(price[s.place].sum())) for s in self._slots
        ]
