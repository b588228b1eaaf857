"""Assist: the robot helps along, so that the hand that leads it feels a set torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.comply import Comply
from pepper_driver.reflexes.reflex import Then
from pepper_driver.reflexes.requests import ReflexRequests

HELP = (0.1, 10.0)
"""Times the admittance of the same :class:`Comply`: as far as it adapts."""

RATE = 4.0
"""[1/s] At which it changes by e while the torque is twice what it should be."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Assist(Comply):
    """A :class:`Comply` whose gain adapts, so that the torque of the interaction stays at ``torque``.

    Who pushes harder than that is helped more, who pushes less is helped less: the adaptive-gain motion assistance
    that the paper names as its aim (Sec. VII).

    Attributes:
        torque: On the joint that feels most [N m].
    """

    then: Then = "stay"
    torque: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("torque", 0.1, 50.0)

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Begin as Comply does, with no more help than it gives."""
        if not self.joints.any():
            self._help = 1.0
        super().begin(contact, requests)

    def felt(self, observation: Observation) -> FloatArray:
        """(joints,) torque to follow, times the help [N m]."""
        torque = super().felt(observation)
        excess = np.clip(np.abs(torque).max(initial=0.0) / self.torque - 1.0, -1.0, 1.0)
        change = np.exp(RATE * self.robot.cycle * excess)
        self._help = float(np.clip(self._help * change, *HELP))
        return self._help * torque
