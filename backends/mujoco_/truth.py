"""What really happens in the simulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import Truth
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import PlantConfig
from pepper_driver.config.parts import FloatArray


class MujocoTruth(Truth):
    """Ground truth of the simulated robot. Arrays are copies."""

    def __init__(self, plant: PlantConfig, simulation: Simulation) -> None:
        self._plant = plant
        self._simulation = simulation

    @property
    def contact_torque(self) -> FloatArray:
        """(17,) J^T f, mean over the last cycle [N m]."""
        return self._simulation.contacts.torque.copy()

    @property
    def in_gap(self) -> NDArray[np.bool_]:
        """(17,) whether the joint is inside its backlash."""
        return self._simulation.model.in_gap(self._simulation.data)

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """(17,) whether the board met its current or voltage limit in the last cycle."""
        return self._simulation.boards.saturated.copy()

    @property
    def position(self) -> FloatArray:
        """(17,) link-side joint positions [rad]."""
        return self._simulation.position

    @property
    def plant(self) -> PlantConfig:
        """The parameters of the simulated robot."""
        return self._plant

    @property
    def stiffness(self) -> FloatArray:
        """(17,) K = kp N Kt / R [N m/rad]."""
        return np.array(self._simulation.boards.stiffness)

    @property
    def torque_limit(self) -> FloatArray:
        """(17,) largest torque the board can hold [N m]."""
        return np.array(self._simulation.boards.torque_limit)
