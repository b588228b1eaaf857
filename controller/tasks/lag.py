"""What tasks on a velocity or a momentum share: a first-order lag in place of a spring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.task import Task, TaskRows


class LagTask(Task):
    """A rate goes to a target: a* = damping (target - rate). The target is the task's reference velocity."""

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """There is no error of position: only the rate matters, and the target is its reference."""
        super().attach(model, rows)
        rows.error[:] = 0.0

    def _update_gains(self) -> None:
        super()._update_gains()
        self.gains = replace(self.gains, stiffness=0.0)

    @property
    def error(self) -> FloatArray:
        """(rows,) target minus rate in the last cycle; NaN before the first."""
        error: FloatArray = self.reference_velocity - self._rate
        return error

    @checked_arguments
    def reached(self, tolerance: ArrayLike) -> bool:
        """Whether every row that has weight is within a tolerance of its target.

        Args:
            tolerance: One number or (rows,), in the unit of the task.

        Raises:
            TargetError: Not a number above 0, or not as many.
        """
        near = np.abs(self.error) <= self._tolerance(tolerance)
        return bool(near[self._dim_weight > 0].all())
