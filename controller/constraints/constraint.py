"""What a constraint is, beyond the box of joint limits: rows G qdd <= h of the QP."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from pepper_driver.controller.model import RobotModel

FloatArray = NDArray[np.float64]


class Constraint(ABC):
    """Rows of linear inequalities on the acceleration.

    Attributes:
        name: For messages.
        rows: How many, the same in every tick; a row that does not matter now gets an infinite bound.
        needs_kinematics: Whether the controller must compute Jacobians before :meth:`write`.
    """

    name: str
    rows: int
    needs_kinematics = True

    @abstractmethod
    def write(self, model: RobotModel, dt: float, matrix: FloatArray, bound: FloatArray) -> None:
        """Fill ``matrix`` (rows, 20) and ``bound`` (rows,) for the model's state and a cycle of ``dt`` [s]."""
