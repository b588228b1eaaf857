"""Hold: stand still while touched."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.observer import Observation
from pepper_driver.reflexes.reflex import Control, Reflex

STIFFNESS = 400.0
"""[1/s2] Of the posture task while holding."""


class Hold(Reflex):
    """Brake when a contact begins, stand still, and go on ``pause`` [s] after the last one ended.

    What stands still is the reference, not the measured posture: the joints keep pushing back against the hand with
    their own stiffness. The reference comes to rest a twentieth of a second's way further on, as fast as the
    acceleration limits allow, and does not turn round; the base brakes, and all other tasks wait. A rebound does not
    prolong the hold, so the reflex cannot keep itself alive on the motion that follows a release. What the user asks
    for meanwhile is done afterwards.
    """

    def __init__(self, pause: float = 0.5) -> None:
        if not (np.isfinite(pause) and pause >= 0):
            raise ValueError(f"pause must be a time in seconds that is not negative, got {pause}")
        self._pause = pause
        self._touching: set[int] = set()
        self._resume_time: float | None = None

    @property
    def holding(self) -> bool:
        """Whether the posture is frozen now."""
        return bool(self._touching) or self._resume_time is not None

    def step(self, observation: Observation, measurement: Measurement, control: Control) -> None:
        """Freeze on begin, count down after end."""
        for contact in observation.contacts:
            if contact.kind == "rebound":
                continue
            if contact.phase == "begin":
                if not self.holding:
                    _brake(control)
                self._touching.add(contact.id)
                self._resume_time = None
            elif contact.phase == "end" and contact.id in self._touching:
                self._touching.discard(contact.id)
                if not self._touching:
                    self._resume_time = measurement.time + self._pause
        if self._resume_time is not None and measurement.time >= self._resume_time:
            control.posture = control.posture_stiffness = None
            self._resume_time = None

    def reset(self) -> None:
        """Forget all contacts; the posture is let go at the next reset of the robot."""
        self._touching.clear()
        self._resume_time = None


def _brake(control: Control) -> None:
    """Send the posture where the joints come to rest without turning round.

    A critically damped joint at q with velocity v decays exponentially towards q + v / sqrt(stiffness).
    """
    controller = control.controller
    rest = controller.position + controller.velocity / np.sqrt(STIFFNESS)
    control.posture = np.clip(rest, controller.lower, controller.upper)
    control.posture_stiffness = STIFFNESS
