"""Soften: the motors of the limb that is touched give in."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.backends import Measurement
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.limbs import limb_joints
from pepper_driver.reflexes.reflex import Part, Reflex
from pepper_driver.reflexes.requests import ReflexRequests


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Soften(Reflex):
    """Lower the stiffness of the limb's motors, down the safety gate's ramp, and up again ``pause`` after the contact.

    Below full stiffness nobody can tell what touches a joint: the observer is blind there, which ends the contact.
    ``pause`` is therefore the time for which the limb stays soft.

    Attributes:
        stiffness: 0..1 of the motors. At 0 an arm falls.
    """

    priority: int = 10
    pause: float = 3.0
    stiffness: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("stiffness", 0.0, 1.0)

    @property
    def takes(self) -> frozenset[Part]:
        """Nothing: of several wishes the lowest counts."""
        return frozenset()

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Choose the limb; a further contact adds its own."""
        self.joints = self.joints | limb_joints(contact, self.robot, fingers=True)

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Stay soft."""
        requests.lower_stiffness(self.joints, self.stiffness)
