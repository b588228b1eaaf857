"""What a reflex is: it reacts to touch inside the tick, in bounded time."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.observer import Observation


class Control:
    """What reflexes may act on: the controller's tasks, the stiffness, the wheels.

    Attributes:
        controller: Its tasks can be changed, added and removed; they act while ``posture`` is None.
        stiffness: (17,) wanted stiffness 0..1; the safety gate ramps towards it.
        posture: (17,) posture that a reflex wants in place of the user's [rad]; None to follow the user. While there
            is one, all other tasks stand still, the base comes to rest, and afterwards they go on.
        posture_stiffness: Stiffness of the posture task that a reflex wants [1/s2]; None to follow the user.
    """

    def __init__(self, controller: WholeBodyController) -> None:
        self.controller = controller
        self.stiffness: FloatArray = np.ones(17)
        self.posture: FloatArray | None = None
        self.posture_stiffness: float | None = None


class Reflex(ABC):
    """A reaction inside the tick. It sees what the observer says and acts through ``control`` only."""

    @property
    def name(self) -> str:
        """What its events and callbacks call it: its class in small letters."""
        return type(self).__name__.lower()

    @abstractmethod
    def step(self, observation: Observation, measurement: Measurement, control: Control) -> None:
        """React to one tick; a few microseconds, no waiting."""

    @abstractmethod
    def reset(self) -> None:
        """Let go of everything, as before the first contact."""
