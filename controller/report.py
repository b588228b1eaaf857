"""Reports of the controller on its last cycle: active constraints, relaxed limits, errors of tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.qp import QpStatus

MIN_REPORTED_ERROR = 0.01
"""[m/s2], [rad/s2] Smallest acceleration error of a task that is reported."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ControllerStatus:
    """State of the controller after the last cycle.

    Attributes:
        solver: ``solved``; ``relaxed``: some rows were violated as little as possible, because not all can hold;
            ``infeasible`` or ``failed``: no solution, the controller braked.
        at_limit: Joints and base axes at an acceleration bound, each with the limit that causes it: ``position``,
            ``velocity``, ``acceleration`` or ``jerk``.
        active: Names of the rows of constraints that limit the motion.
        violated: Names of the rows of constraints that the accelerations violate.
        relaxed: Relaxed limits of the acceleration bounds, as ``"LHand acceleration"``: a more important limit
            prevailed, or the joint was beyond its limit.
    """

    solver: QpStatus
    at_limit: tuple[tuple[str, str], ...]
    active: tuple[str, ...]
    violated: tuple[str, ...]
    relaxed: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskReport:
    """Cost of a task in the last cycle.

    Attributes:
        name: Of the task.
        error: (rows,) target minus value.
        acceleration_error: (rows,) J qdd + Jdot qd - a*: difference to the accelerations that the task requests.
        cost: weight * sum of dim_weight acceleration_error^2.
        cost_fraction: Fraction of the cost of all tasks, 0..1.
    """

    name: str
    error: FloatArray
    acceleration_error: FloatArray
    cost: float
    cost_fraction: float


def explain(status: ControllerStatus, reports: Sequence[TaskReport]) -> str:
    """Describe in a few lines which limits act on the motion."""
    lines = []
    if status.solver == "relaxed":
        lines.append(
            f"Not all constraints can hold; relaxed by priority: {_list(status.violated)}."
        )
    elif status.solver != "solved":
        lines.append(
            f"The problem is {status.solver}: braking to rest. Violated: {_list(status.violated)}."
        )
    if status.relaxed:
        lines.append(f"Relaxed limits: {_list(status.relaxed)}.")
    if status.at_limit:
        lines.append(
            "At a limit: " + _list([f"{name} ({kind})" for name, kind in status.at_limit]) + "."
        )
    if status.active:
        lines.append(f"Active constraints: {_list(status.active)}.")
    if not lines:
        lines.append("Nothing limits the motion.")
    expensive = [
        report
        for report in reports
        if report.cost_fraction > 0.01
        and np.abs(report.acceleration_error).max() > MIN_REPORTED_ERROR
    ]
    if expensive:
        costs = [
            f"{report.name} {100 * report.cost_fraction:.0f} % (error {np.linalg.norm(report.error):.3g})"
            for report in expensive
        ]
        lines.append(f"Tasks with an acceleration error: {_list(costs)}.")
    return "\n".join(lines)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "nothing"
