r"""What a task is: rows of the cost.

The controller minimises the sum over tasks of weight * sum_i dim_weight_i * (J qdd + Jdot qd - a*)_i^2, with the
desired acceleration a* = stiffness * error - damping * velocity: the set-point law of the JRL task library.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import isfinite, sqrt
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pepper_driver.controller.errors import GainError, TargetError
from pepper_driver.controller.model import RobotModel

FloatArray = NDArray[np.float64]


class Task(ABC):
    """Rows of the cost with a common stiffness [1/s2], damping [1/s] and weight.

    Damping follows the stiffness as 2 sqrt(stiffness), which is critical, unless it is set.

    Args:
        rows: Number of rows.
        stiffness: Of the error [1/s2].
        weight: In the cost, against other tasks.

    Attributes:
        needs_kinematics: Whether the controller must compute Jacobians before :meth:`write`.
    """

    needs_kinematics = True

    def __init__(self, rows: int, *, stiffness: float, weight: float) -> None:
        self.rows = rows
        self._dim_weight = np.ones(rows)
        self._damping: float | None = None
        self.stiffness = stiffness
        self.weight = weight

    @property
    def stiffness(self) -> float:
        """Of the error [1/s2]."""
        return self._stiffness

    @stiffness.setter
    def stiffness(self, value: float) -> None:
        self._stiffness = _not_negative("stiffness", value)

    @property
    def damping(self) -> float:
        """Of the velocity [1/s]; 2 sqrt(stiffness) unless set."""
        return 2.0 * sqrt(self._stiffness) if self._damping is None else self._damping

    @damping.setter
    def damping(self, value: float | None) -> None:
        self._damping = None if value is None else _not_negative("damping", value)

    @property
    def weight(self) -> float:
        """In the cost, against other tasks."""
        return self._weight

    @weight.setter
    def weight(self, value: float) -> None:
        self._weight = _not_negative("weight", value)

    @property
    def dim_weight(self) -> FloatArray:
        """(rows,) weight of each row within the task."""
        return self._dim_weight

    @dim_weight.setter
    def dim_weight(self, value: FloatArray) -> None:
        if np.shape(value) != (self.rows,) or not (np.isfinite(value) & (value >= 0)).all():
            what = f"{self.rows} finite numbers that are not negative"
            raise GainError("dim_weight", value, what)
        self._dim_weight = np.array(value, dtype=np.float64)

    @abstractmethod
    def write(self, model: RobotModel, jacobian: FloatArray, acceleration: FloatArray) -> None:
        """Write the rows for the model's state.

        Args:
            model: At the state of the controller.
            jacobian: (rows, 20) to be filled with J.
            acceleration: (rows,) to be filled with a* - Jdot qd.
        """

    @abstractmethod
    def error(self, model: RobotModel) -> FloatArray:
        """(rows,) distance to the target at the model's state, in the unit of the task."""


def _not_negative(name: str, value: float) -> float:
    if not (isinstance(value, Real) and isfinite(value) and value >= 0):
        raise GainError(name, value)
    return float(value)


def finite_vector(
    what: str, value: ArrayLike, size: int, *, names: Sequence[str] = ()
) -> FloatArray:
    """A copy of ``value`` (size,) as floats.

    Args:
        what: For the message.
        value: As given by the user.
        size: How many numbers there must be.
        names: (size,) joints, to name the one at fault.

    Raises:
        TargetError: Not ``size`` finite numbers.
    """
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TargetError(f"{what} takes {size} numbers, got {type(value).__name__}") from None
    if vector.shape != (size,):
        raise TargetError(f"{what} takes {size} numbers, got shape {vector.shape}")
    finite = np.isfinite(vector)
    if not finite.all():
        index = int(np.argmin(finite))
        joint = names[index] if names else None
        raise TargetError(
            f"{what} takes finite numbers, got {vector[index]} for {joint or f'number {index}'}",
            joint=joint,
            value=float(vector[index]),
        )
    return vector
