"""Stiffness, damping and weights of a task, checked where they are set."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config.arguments import is_number, real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.parts import STIFFEST
from pepper_driver.controller.changes import Change, Changes
from pepper_driver.controller.errors import GainError

MAX_DAMPING = 120.0
"""[1/s] Beyond about 1.4 times this, a cycle of 12 ms is too long for the law, as with stiffness beyond STIFFEST."""

MAX_WEIGHT = 1e12
"""Weights beyond would leave nothing of the others in double precision."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Stiffness [1/s2], damping [1/s] and weights (rows,) of a task's rows."""

    stiffness: float
    damping: float
    weight: FloatArray


class GainsMixin:
    """Stiffness [1/s2], damping [1/s] and weights of a task, set between two ticks.

    Damping follows the stiffness as 2 sqrt(stiffness), which is critical, unless it is set.

    Args:
        rows: Number of rows.
        stiffness: Of the error [1/s2].
        weight: In the cost, against other tasks.

    Attributes:
        gains: What the rows are multiplied by; another object whenever one of them was set.
        changes: Of the controller that has the task; None where none has it.
    """

    def __init__(self, rows: int, *, stiffness: float, weight: float) -> None:
        self.changes: Changes | None = None
        self._dim_weight = np.ones(rows)
        self._own_damping: float | None = None
        self._stiffness = checked_stiffness(stiffness)
        self._weight = _within("weight", weight, MAX_WEIGHT)
        self._update_gains()

    @property
    def stiffness(self) -> float:
        """Of the error [1/s2]."""
        return self._stiffness

    @stiffness.setter
    def stiffness(self, value: float) -> None:
        stiffness = checked_stiffness(value)

        def change() -> None:
            self._allow(stiffness, self._own_damping)
            self._stiffness = stiffness
            self._update_gains()

        self.change(change)

    @property
    def damping(self) -> float:
        """Of the velocity [1/s]; 2 sqrt(stiffness) unless set; None makes it follow the stiffness again."""
        return self._damping

    @damping.setter
    def damping(self, value: float | None) -> None:
        damping = None if value is None else _within("damping", value, MAX_DAMPING)

        def change() -> None:
            self._allow(self._stiffness, damping)
            self._own_damping = damping
            self._update_gains()

        self.change(change)

    @property
    def weight(self) -> float:
        """In the cost, against other tasks."""
        return self._weight

    @weight.setter
    def weight(self, value: float) -> None:
        weight = _within("weight", value, MAX_WEIGHT)

        def change() -> None:
            self._weight = weight
            self._update_gains()

        self.change(change)

    @property
    def dim_weight(self) -> FloatArray:
        """(rows,) weight of each row within the task, a copy; a row of weight 0 is not asked for."""
        return self._dim_weight.copy()

    @dim_weight.setter
    def dim_weight(self, value: ArrayLike) -> None:
        rows = len(self._dim_weight)
        what = f"{rows} finite numbers that are not negative"
        weights = real_array(value)
        if (
            weights is None
            or weights.shape != (rows,)
            or not (np.isfinite(weights) & (weights >= 0)).all()
        ):
            raise GainError("dim_weight", value, what)

        def change() -> None:
            self._dim_weight = weights
            self._update_gains()

        self.change(change)

    def change(self, change: Change) -> None:
        """Make a change between two ticks, or at once where no controller has the task."""
        if self.changes is None:
            change()
        else:
            self.changes.make(change)

    def _allow(self, stiffness: float, damping: float | None) -> None:
        """Refuse gains that a task cannot live with, by a GainError. For tasks that have such."""
        return

    def _update_gains(self) -> None:
        own = self._own_damping
        self._damping = 2.0 * sqrt(self._stiffness) if own is None else own
        self.gains = Gains(self._stiffness, self._damping, self._weight * self._dim_weight)


def checked_stiffness(value: float) -> float:
    """A stiffness [1/s2] as a float.

    Raises:
        GainError: Not a number from 0 to 3000.
    """
    return _within("stiffness", value, STIFFEST)


def _within(name: str, value: float, most: float) -> float:
    if not (is_number(value) and 0.0 <= value <= most):  # False for NaN
        raise GainError(name, value, f"a number from 0 to {most:g}")
    return float(value)
