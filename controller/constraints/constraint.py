"""What a constraint is, beyond the box of limits of single joints: rows G qdd <= h of the QP."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pepper_driver.controller.constraints.stopping import Stopping
from pepper_driver.controller.model import RobotModel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rows:
    """Inequalities ``matrix`` (m, 20) @ acceleration <= ``bound`` (m,), each with a name for messages."""

    matrix: FloatArray
    bound: FloatArray
    names: tuple[str, ...]

    def usable(self, nv: int) -> bool:
        """Whether shapes fit ``nv`` accelerations and each other, and all are numbers; a bound may be infinite."""
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
        rank: When not all rows can be kept, those of the lowest rank are given up first: 0 what users add,
            1 torque, 2 self-collision and wheel speed, 3 coupled limits, 4 balance. The box is never given up.
        needs_kinematics: Whether the controller must compute placements and Jacobians before :meth:`rows`.
        lazy: Whether :meth:`kept` is to be asked before :meth:`rows`.
    """

    name: str
    rank: int = 0
    needs_kinematics = True
    lazy = False

    def kept(self, model: RobotModel, stopping: Stopping, acceleration: FloatArray) -> bool:
        """Whether (20,) accelerations, chosen without the rows, keep the constraint anyway; then no rows are needed.

        For constraints whose rows cost more than this answer. False where it is not certain.
        """
        return False

    @abstractmethod
    def rows(self, model: RobotModel, stopping: Stopping) -> Rows | None:
        """The rows that matter at the model's state, None when none does; as many as there are, other ones each time.

        Args:
            model: At the state of the controller.
            stopping: How fast it can change its speed, and the cycle.
        """


def stack(parts: Sequence[Rows]) -> Rows:
    """All rows below one another."""
    if len(parts) == 1:
        return parts[0]
    return Rows(
        np.concatenate([rows.matrix for rows in parts]),
        np.concatenate([rows.bound for rows in parts]),
        tuple(name for rows in parts for name in rows.names),
    )


def is_number(value: object) -> bool:
    """Whether a user gave a number; only numbers can be compared with limits."""
    return isinstance(value, Real)
