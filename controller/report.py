"""Reports of the controller on its last cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.qp import QpStatus

NOTICEABLE = 0.01
"""[m/s2], [rad/s2] What a task may miss without being mentioned."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ControllerStatus:
    """State of the controller after the last cycle.

    Attributes:
        solver: ``solved``; ``relaxed``: not all rows could be kept, some were broken as little as possible;
            ``infeasible`` or ``failed``: no solution, the controller braked.
        at_limit: Joints and base axes at a bound of their acceleration box, each with the limit that it is:
            ``position``, ``velocity``, ``acceleration`` or ``jerk``.
        active: Names of the constraints' rows that hold the motion back.
        violated: Names of the constraints' rows that the accelerations break.
        relaxed: Limits of the box that could not be kept, as ``"LHand acceleration"``: one that matters more prevailed,
            or the joint was beyond it.
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
        acceleration_error: (rows,) J qdd + Jdot qd - a*: by how much the accelerations are not those the task asks for.
        cost: weight * sum of dim_weight acceleration_error^2.
        share: Of the cost of all tasks, 0..1.
    """

    name: str
    error: FloatArray
    acceleration_error: FloatArray
    cost: float
    share: float


def explain(status: ControllerStatus, reports: Sequence[TaskReport]) -> str:
    """Describe in a few lines what limits the motion."""
    lines = []
    if status.solver == "relaxed":
        lines.append(f"Not all constraints can be kept: {_list(status.violated)} given up.")
    elif status.solver != "solved":
        lines.append(
            f"The problem is {status.solver}: braking to rest. Broken: {_list(status.violated)}."
        )
    if status.relaxed:
        lines.append(f"Limits not kept: {_list(status.relaxed)}.")
    if status.at_limit:
        lines.append(
            "At a limit: " + _list([f"{name} ({kind})" for name, kind in status.at_limit]) + "."
        )
    if status.active:
        lines.append(f"Held back by: {_list(status.active)}.")
    if not lines:
        lines.append("Nothing limits the motion.")
    dear = [
        report
        for report in reports
        if report.share > 0.01 and np.abs(report.acceleration_error).max() > NOTICEABLE
    ]
    if dear:
        costs = [
            f"{report.name} {100 * report.share:.0f} % (error {np.linalg.norm(report.error):.3g})"
            for report in dear
        ]
        lines.append(f"Tasks that do not get what they want: {_list(costs)}.")
    return "\n".join(lines)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "nothing"
