"""What really happens in the simulation."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import Truth
from pepper_driver.backends.mujoco_.board import MotorBoards
from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.config import PlantConfig
from pepper_driver.config.parts import FloatArray


class MujocoTruth(Truth):
    """Ground truth of the simulated robot. Arrays are copies."""

    def __init__(
        self, plant: PlantConfig, model: PlantModel, data: mujoco.MjData, boards: MotorBoards
    ) -> None:
        self._plant = plant
        self._model = model
        self._data = data
        self._boards = boards
        self._contact_torque = np.zeros(len(model.link_dof))

    def record(self, contact_torque: FloatArray) -> None:
        """Take in the mean contact torque (17,) of a cycle [N m]."""
        self._contact_torque = contact_torque

    @property
    def contact_torque(self) -> FloatArray:
        """(17,) J^T f, mean over the last cycle [N m]."""
        return self._contact_torque.copy()

    @property
    def in_gap(self) -> NDArray[np.bool_]:
        """(17,) whether the joint is inside its backlash."""
        return self._model.in_gap(self._data)

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """(17,) whether the board met its current or voltage limit in the last cycle."""
        return self._boards.saturated.copy()

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""
        return np.array(self._data.qpos[self._model.link_qpos])

    @property
    def plant(self) -> PlantConfig:
        """The parameters of the simulated robot."""
        return self._plant

    @property
    def stiffness(self) -> FloatArray:
        """(17,) K = kp N Kt / R [N m/rad]."""
        return np.array(self._boards.stiffness)

    @property
    def torque_limit(self) -> FloatArray:
        """(17,) largest torque the board can hold [N m]."""
        return np.array(self._boards.torque_limit)
