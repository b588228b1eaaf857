"""What a constraint is, beyond the box of limits of single joints: rows G qdd <= h of the QP."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.constraints.braking_limits import BrakingLimits
from pepper_driver.controller.model import RobotModel


@dataclass(frozen=True, slots=True)
class LinearInequality:
    """Rows ``matrix`` (m, 20) @ acceleration <= ``bound`` (m,), each with a name for messages.

    Columns are those of ``RobotModel.v``.
    """

    matrix: FloatArray
    bound: FloatArray
    names: tuple[str, ...]

    def usable(self, nv: int) -> bool:
        """Return True where shapes fit ``nv`` accelerations and each other, and all are numbers.

        A bound may be infinite.
        """
        m = len(self.names)
        return (
            self.matrix.shape == (m, nv)
            and self.bound.shape == (m,)
            and bool(np.isfinite(self.matrix).all())
            and not np.isnan(self.bound).any()
        )


class Constraint(ABC):
    """Rows of linear inequalities on the acceleration.

    Attributes:
        name: For messages.
        priority: When not all rows can be kept, those of the lowest priority are relaxed first: 0 what users add,
            1 torque, 2 self-collision and wheel speed, 3 coupled limits, 4 balance. The box is never relaxed.
        needs_kinematics: True if the controller must compute placements and Jacobians before
            :meth:`compute_inequality`.
        lazy: True if :meth:`is_satisfied` is to be asked before :meth:`compute_inequality`.
    """

    name: str
    priority: int = 0
    needs_kinematics = True
    lazy = False

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        """Return True if (20,) accelerations, chosen without the rows, keep the constraint anyway.

        Then no rows are needed. For constraints whose rows cost more than this answer. False where it is not certain.
        """
        return False

    @abstractmethod
    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Return the rows that matter at the model's state, None when none does; other ones each time.

        Args:
            model: At the state of the controller.
            braking_limits: How fast it can change its speed, and the cycle.
        """


def stack(parts: Sequence[LinearInequality]) -> LinearInequality:
    """All rows below one another."""
    if len(parts) == 1:
        return parts[0]
    return LinearInequality(
        np.concatenate([rows.matrix for rows in parts]),
        np.concatenate([rows.bound for rows in parts]),
        tuple(name for rows in parts for name in rows.names),
    )
