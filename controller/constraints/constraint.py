"""Base class of constraints, and what the robot can brake.

Limits that joints share, h(q) <= 0, are kept as those of single joints are, by braking distance: a motion is allowed as
long as the robot, if each joint braked as its box allows, would keep them all the way to rest. Braking is always inside
the box, so a robot that satisfies this now can satisfy it in the next cycle too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.constraints.braking import BRAKE_RATIO
from pepper_driver.controller.model import RobotModel

MIN_ROW_SIZE = 1e-9
"""A row with smaller entries moves nothing."""


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
        """(20,) deceleration that the way to rest is computed with [m/s2], [rad/s2]."""
        return BRAKE_RATIO * self.acceleration


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
