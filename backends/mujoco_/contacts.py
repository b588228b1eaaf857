"""What touches the simulated robot from outside, and the torque it puts on the joints."""

from __future__ import annotations

import mujoco
import numpy as np

from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.pushes import Pushes
from pepper_driver.backends.mujoco_.resumable import Resumable


class Contacts(Resumable):
    """All contacts of the robot, applied and measured in every step of physics.

    Attributes:
        torque: (17,) J^T f, mean over the last cycle [N m].
    """

    STATE = ("torque",)

    def __init__(self, model: PlantModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self.pushes = Pushes(model, data)
        self.torque = np.zeros(len(model.link_dof))
        self._sum = np.zeros_like(self.torque)

    def reset(self) -> None:
        """Nothing touches."""
        self.pushes.clear()
        self.torque = np.zeros_like(self._sum)

    def begin_cycle(self) -> None:
        """Start a new mean."""
        self._sum[:] = 0.0

    def apply(self) -> None:
        """Set the external wrenches for the step of physics to come."""
        self.pushes.apply()

    def accumulate(self) -> None:
        """Take in what acted in the step just made."""
        self.pushes.add_joint_torque(self._sum)

    def end_cycle(self, steps: int) -> None:
        """Finish the mean over ``steps``."""
        self.torque = self._sum / steps
