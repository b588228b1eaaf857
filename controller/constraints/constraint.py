"""Base class of constraints, and the braking limits of the robot.

Limits that joints share, h(q) <= 0, hold by braking distance, as those of single joints. A motion is allowed if
the robot can brake to rest, each joint as its bounds allow, and satisfy them on the whole path. Braking is always
within the bounds, so a robot that satisfies this now can satisfy it in the next cycle too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, kernel
from pepper_driver.controller.constraints.braking import BRAKE_RATIO
from pepper_driver.controller.model import RobotModel

MIN_ROW_SIZE = 1e-9
"""Largest entry of a row below which no motion changes it."""


@dataclass(frozen=True, slots=True, eq=False)
class BrakingLimits:
    """Accelerations by which base and joints can change their speed.

    Attributes:
        acceleration: (20,) limits [m/s2], [rad/s2].
        dt: Cycle [s].
    """

    acceleration: FloatArray
    dt: float

    @property
    def brake(self) -> FloatArray:
        """(20,) deceleration on the path to rest [m/s2], [rad/s2]."""
        return BRAKE_RATIO * self.acceleration


@dataclass(frozen=True, slots=True)
class LinearInequality:
    """Rows ``matrix`` (m, 20) @ acceleration <= ``bound`` (m,), each with a name for messages.

    Columns are those of ``RobotModel.v``.
    """

    matrix: FloatArray
    bound: FloatArray
    names: tuple[str, ...]


@kernel
def _are_numbers(matrix: Matrix[FloatArray], bound: FloatArray) -> bool:
    """Return True where the entries of rows are finite and their bounds are numbers, which may be infinite."""
    for row in range(len(bound)):
        if np.isnan(bound[row]):
            return False
        for i in range(matrix.shape[1]):
            if not np.isfinite(matrix[row, i]):
                return False
    return True


class RowCheck:
    """Check of rows, which may come from a user.

    Args:
        nv: Number of accelerations.
    """

    def __init__(self, nv: int) -> None:
        self._nv, self._are_numbers = nv, _are_numbers.load()

    def plain(self, rows: LinearInequality) -> LinearInequality | None:
        """Return rows as solvers take them; None for others than numbers, and for shapes that do not fit."""
        matrix, bound, m = _plain(rows.matrix), _plain(rows.bound), len(rows.names)
        if matrix.shape != (m, self._nv) or bound.shape != (m,):
            return None
        if not self._are_numbers(matrix, bound):
            return None
        if matrix is rows.matrix and bound is rows.bound:
            return rows
        return LinearInequality(matrix, bound, rows.names)


def _plain(values: FloatArray) -> FloatArray:
    """Return a contiguous array of floats that may be written to: DAQP refuses others."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    return array if array.flags.writeable else array.copy()


class Constraint(ABC):
    """Rows of linear inequalities on the acceleration.

    Attributes:
        name: Name in messages.
        priority: Rows that exclude each other are relaxed from the lowest priority on: 0 constraints of users,
            1 torque, 2 self-collision and wheel speed, 3 coupled limits, 4 balance. Acceleration bounds never are.
        needs_kinematics: True if the controller must compute placements and Jacobians before
            :meth:`compute_inequality`.
        lazy: True if the controller shall call :meth:`is_satisfied` before :meth:`compute_inequality`.
    """

    name: str
    priority: int = 0
    needs_kinematics = True
    lazy = False

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        """Return True if (20,) accelerations, computed without the rows, certainly satisfy the constraint.

        Then no rows are needed. This is for constraints whose rows cost more time than this check.
        """
        return False

    @abstractmethod
    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return the relevant rows at the state of the model, in new arrays; None without any.

        Args:
            model: Model at the state of the controller.
            braking_limits: Accelerations of the robot, and the cycle.
        """


def stack(parts: Sequence[LinearInequality]) -> LinearInequality:
    """Return all rows as one inequality."""
    if len(parts) == 1:
        return parts[0]
    return LinearInequality(
        np.concatenate([rows.matrix for rows in parts]),
        np.concatenate([rows.bound for rows in parts]),
        tuple(name for rows in parts for name in rows.names),
    )
