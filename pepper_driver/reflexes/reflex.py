"""Base class of reflexes: reactions to touch inside the tick, in bounded time."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends import Measurement
from pepper_driver.callbacks.filters import contact_filter
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.observer import Contact, Observation
from pepper_driver.observer.contact import Kind
from pepper_driver.reflexes.requests import ReflexRequests

BoolArray = NDArray[np.bool_]
Then = Literal["resume", "stay"]
Part = Literal["joints", "base", "contacts"]

LONGEST = 3600.0
"""[s] of any time that a reflex is given."""


class ReflexError(PepperError, ValueError):
    """A reflex with an argument that makes no sense, or two that want the same."""


def kind_of(reflex: type[Reflex]) -> str:
    """Return the name of a kind of reflex in experiments: ``stop_base`` for ``StopBase``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", reflex.__name__).lower()


@dataclass(kw_only=True, eq=False)
class Reflex:
    """A reaction to contacts inside the tick. It gets what the observer reports and requests what it needs.

    It begins with the first contact it is for, and is over ``pause`` after the last of them has ended, or after
    ``longest``; then it waits for new ones. Rebounds neither begin nor prolong it: no reflex keeps itself alive on the
    swing of a joint that was let go.

    A subclass requests in :meth:`act` what it needs while it is active. One that does not wait for contacts overrides
    :meth:`step`. To test one without a loop, see ``docs/reflexes.md``.

    Attributes:
        link: Only contacts on this link.
        joint: Only contacts felt by this joint.
        kind: ``contact`` or ``collision``; None for both. A contact that grows into a collision begins a reflex that
            is for collisions.
        min_intensity: Only contacts of at least this intensity [deg].
        priority: Of several that want the same joints, or the base, the one with the highest gets them.
        then: ``resume``: the user's motion goes on. ``stay``: the joints stay where they are until the user moves them.
        pause: After the last contact, for which it goes on [s].
        longest: That it acts without pause [s].
        name: In events and log; by default that of the class, ``stop_base`` for ``StopBase``.
        joints: (17,) those it acts on, once it is active.
        granted_joints: (17,) those it has been given since it began.
        contact: The one that it began with.

    Raises:
        ReflexError: A number that makes no sense, or an unknown ``then``.
    """

    link: str | None = None
    joint: str | None = None
    kind: Kind | None = None
    min_intensity: float = 0.0
    priority: int = 0
    then: Then = "resume"
    pause: float = 0.5
    longest: float = 60.0
    name: str = ""
    contact: Contact | None = field(default=None, init=False, repr=False)
    _began: float | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self.name = self.name or kind_of(type(self))
        if self.then not in get_args(Then):
            raise ReflexError(f"{self.name}: 'then' is 'resume' or 'stay', got {self.then!r}")
        self.check("pause", 0.0, LONGEST)
        self.check("longest", 0.0, LONGEST)
        self.check("min_intensity", 0.0, 180.0)
        self.check("priority", -1000, 1000)

    def check(self, what: str, least: float, largest: float) -> None:
        """Refuse an attribute that is not a number within bounds.

        Raises:
            ReflexError: It is not.
        """
        value = getattr(self, what)
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and math.isfinite(value) and least <= value <= largest):
            raise ReflexError(
                f"{self.name}: {what} is a number from {least:g} to {largest:g}, got {value!r}"
            )

    def prepare(self, robot: RobotConfig) -> None:
        """Learn of the robot, before anything moves.

        Raises:
            UnknownNameError: It is for a link, joint or kind that there is none of.
        """
        self.robot = robot
        self.joints: BoolArray = np.zeros(len(robot.joint_names), dtype=np.bool_)
        self.granted_joints: BoolArray = np.zeros_like(self.joints)
        self._for_it = contact_filter(
            robot,
            link=self.link,
            joint=self.joint,
            kind=self.kind,
            phase=None,
            min_intensity=self.min_intensity,
        )
        self.reset()

    def reset(self) -> None:
        """Forget all contacts."""
        self._touching: dict[int, str] = {}
        self._given_up: set[int] = set()
        self._until: float | None = None
        self._began, self.contact = None, None
        self.granted_joints = np.zeros_like(self.joints)

    @property
    def active(self) -> bool:
        """True while the reflex is active."""
        return self._began is not None

    @property
    def touched(self) -> bool:
        """True while a contact that it is for lasts."""
        return bool(self._touching)

    @property
    def takes(self) -> frozenset[Part]:
        """Parts that only one reflex gets: the ``joints`` of a limb, the ``base``, or the ``contacts``."""
        return frozenset({"joints", "base"})

    def is_for(self, contact: Contact) -> bool:
        """Return True where it answers this contact, whatever its phase."""
        return self._for_it(contact)

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """React to one tick; a few microseconds, no waiting."""
        time = measurement.time
        for contact in observation.contacts:
            self._take_in(contact, time, requests)
        if self._began is None:
            return
        if self._touching and time - self._began > self.longest:
            self._given_up |= self._touching.keys()
            self._touching.clear()
            self._until = time
        if self._until is not None and time >= self._until:
            self._end(requests)
        else:
            self.act(observation, measurement, requests)

    def _take_in(self, contact: Contact, time: float, requests: ReflexRequests) -> None:
        if contact.phase == "end":
            self._given_up.discard(contact.id)
            if contact.id in self._touching:
                del self._touching[contact.id]
                if not self._touching:
                    self._until = time + self.pause
        elif contact.id in self._touching:
            if contact.link != self._touching[contact.id]:
                self._touching[contact.id] = contact.link
                self.begin(contact, requests)
        elif contact.id not in self._given_up and self.is_for(contact):
            if self._began is None:
                self._began, self.contact = time, contact
                self.joints = np.zeros_like(self.joints)
                self.granted_joints = np.zeros_like(self.joints)
            self._touching[contact.id] = contact.link
            self._until = None
            self.begin(contact, requests)

    def _end(self, requests: ReflexRequests) -> None:
        self._began = self._until = None
        free = self.granted_joints & ~requests.claimed
        requests.release(free, in_place=self.then == "stay")

    # -- what a reflex does -------------------------------------------------------------------------------------

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """React to a contact that has begun, the first one or another, or that turned out to be on another link."""

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Request what is needed in this tick."""
