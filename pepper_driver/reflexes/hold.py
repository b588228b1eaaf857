"""Hold: stand still while touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.reflex import Reflex
from pepper_driver.reflexes.requests import ReflexRequests

STIFFNESS = 400.0
"""[1/s2] Of the posture task while holding."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Hold(Reflex):
    """Brake when a contact begins, stand still, and go on ``pause`` [s] after the last one ended.

    What stands still is the reference, not the measured posture: the joints keep pushing back against the hand with
    their own stiffness. The reference comes to rest a twentieth of a second's way further on, as fast as the
    acceleration limits allow, and does not turn round; the base brakes, and all other tasks wait. What the user asks
    for meanwhile is done afterwards. It takes the whole robot: as long as another reflex of higher priority has a part
    of it, it waits.
    """

    priority: int = 20

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Take the whole robot; choose where to stand still."""
        if not self.joints.all():
            self.joints = np.ones_like(self.joints)
            self._posture: FloatArray | None = None

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Stand still there."""
        if not requests.claim(self.joints):
            self._posture = None  # the robot moves meanwhile
            return
        if self._posture is None:
            self._posture = requests.controller.rest(STIFFNESS)
        requests.claim_base()
        requests.hold_posture(self._posture, STIFFNESS)
