"""Basic reflexes: hold still, lower the stiffness, stop the base, ignore contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.reflex import Reflex, Resource, limb_joints
from pepper_driver.reflexes.requests import BRAKING_STIFFNESS, ReflexRequests


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Hold(Reflex):
    """Brake when a contact begins, stand still, and continue ``release_delay`` [s] after the last one ended.

    What stands still is the reference, not the measured posture: the joints keep pushing back against the hand with
    their own stiffness. The reference comes to rest within the distance of 0.05 s of motion, as fast as the
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
            self._posture = requests.controller.stopping_position(BRAKING_STIFFNESS)
        requests.claim_base()
        requests.hold_posture(self._posture, BRAKING_STIFFNESS)


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Soften(Reflex):
    """Lower the stiffness of the limb's motors; raise it again ``release_delay`` after the contact, on the gate's ramp.

    Below full stiffness the observer is blind at a joint, which ends the contact.
    ``release_delay`` is therefore the time for which the limb stays soft.

    Attributes:
        stiffness: 0..1 of the motors. At 0 an arm falls.
    """

    priority: int = 10
    release_delay: float = 3.0
    stiffness: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("stiffness", 0.0, 1.0)

    @property
    def resources(self) -> frozenset[Resource]:
        """Nothing: of several requests the lowest counts."""
        return frozenset()

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Choose the limb; a further contact adds its own."""
        self.joints = self.joints | limb_joints(contact, self.robot, fingers=True)

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Stay soft."""
        requests.lower_stiffness(self.joints, self.stiffness)


@checked_arguments
@dataclass(kw_only=True, eq=False)
class StopBase(Reflex):
    """Brake the base as fast as its acceleration limits allow; arms and head continue."""

    priority: int = 50

    @property
    def resources(self) -> frozenset[Resource]:
        """The base."""
        return frozenset({"base"})

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Stand still."""
        if requests.claim_base():
            requests.stop_base()


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Ignore(Reflex):
    """Reflexes of lower priority do not learn of the contacts that it is for. Callbacks and log do."""

    priority: int = 100

    @property
    def resources(self) -> frozenset[Resource]:
        """Contacts, from all others."""
        return frozenset({"contacts"})
