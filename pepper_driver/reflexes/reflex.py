"""Base class of reflexes, and the joints that they choose by limb."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.callbacks.filters import meets
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arguments import is_number
from pepper_driver.config.arrays import BoolArray
from pepper_driver.config.contact_selector import (
    SELECTOR_FIELDS,
    ContactSelector,
    Kind,
    SelectorError,
)
from pepper_driver.config.errors import shown
from pepper_driver.config.robot import TRUNK
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.requests import ReflexRequests


def limb_joints(contact: Contact, robot: RobotConfig, *, fingers: bool = False) -> BoolArray:
    """(17,) the joints of the limb that a contact is on; none on the trunk: no reflex moves the legs."""
    joints = np.zeros(len(robot.joint_names), dtype=np.bool_)
    if contact.limb != TRUNK:
        joints[[robot.joint_index(name) for name in robot.limbs[contact.limb]]] = True
    if not fingers:
        joints[[robot.joint_index(name) for name in robot.hands.joints]] = False
    return joints


Then = Literal["resume", "stay"]
Resource = Literal["joints", "base", "contacts"]

MAX_REFLEX_TIME = 3600.0
"""[s] of any time that a reflex is given."""


class ReflexError(PepperError, ValueError):
    """A reflex with an argument that makes no sense, or two that claim the same."""


def kind_of(reflex: type[Reflex]) -> str:
    """Return the name of a kind of reflex in experiments: ``stop_base`` for ``StopBase``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", reflex.__name__).lower()


@dataclass(kw_only=True, eq=False)
class Reflex:
    """A reaction to contacts inside the tick. It gets what the observer reports and requests what it needs.

    It begins with the first contact that it matches. It ends ``release_delay`` after the last of them, or after
    ``max_duration``; then it waits for new ones. Rebounds neither begin nor prolong it: no reflex keeps itself alive
    on the rebound of a joint that was released.

    A subclass requests in :meth:`act` what it needs while it is active. One that does not wait for contacts overrides
    :meth:`step`. To test one without a loop, see ``docs/reflexes.md``.

    Attributes:
        limb: Only contacts on this limb; as ``link`` and ``joint`` one name, or a list of which any will do. A contact
            that a reflex is for meets all of its conditions.
        link: Only contacts on this link.
        joint: Only contacts that turn this joint most. To choose a place, take ``link``.
        kind: ``contact`` or ``collision``; None for both. A contact that grows into a collision begins a reflex that
            is for collisions.
        min_intensity_deg: Only contacts of at least this intensity [deg].
        min_torque: Only contacts with at least this torque on their joint [N m].
        min_force: Only contacts with at least this force on their limb [N].
        priority: Of several that claim the same joints, or the base, the one with the highest gets them.
        then: ``resume``: the user's motion continues. ``stay``: the joints stay where they are until the user moves
            them.
        release_delay: Time that it stays active after the last contact [s].
        max_duration: That it acts at a stretch [s].
        name: In events and log; by default its kind, ``stop_base`` for ``StopBase``.
        full_name: The same with ``number``, where several of a robot's reflexes have this name: ``hold 2``.
        number: Place among those of its name, from 1.
        joints: (17,) those it acts on, once it is active, for its own use and for the event; may be left alone.
        granted_joints: (17,) those it has been given since it began.
        held_joints: (17,) those it has been given in this tick; after its end, in its last one.
        contact: The one that it began with.
        selector: The contacts it is for.

    Raises:
        ReflexError: A number that makes no sense, or an unknown ``then``.
        UnknownNameError: No such kind of contact.
    """

    limb: str | Sequence[str] | None = None
    link: str | Sequence[str] | None = None
    joint: str | Sequence[str] | None = None
    kind: Kind | None = None
    min_intensity_deg: float = 0.0
    min_torque: float = 0.0
    min_force: float = 0.0
    priority: int = 0
    then: Then = "resume"
    release_delay: float = 0.5
    max_duration: float = 60.0
    name: str = ""
    selector: ContactSelector = field(init=False, repr=False, default=ContactSelector())
    contact: Contact | None = field(default=None, init=False, repr=False)
    _began: float | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isprintable()):
            raise ReflexError(f"the name of a reflex is a text, got {shown(self.name)}")
        self.name = self.full_name = self.name or kind_of(type(self))
        self.number = 1
        if self.then not in get_args(Then):
            raise ReflexError(f"{self.name}: 'then' is 'resume' or 'stay', got {shown(self.then)}")
        self.check("release_delay", 0.0, MAX_REFLEX_TIME)
        self.check("max_duration", 0.0, MAX_REFLEX_TIME)
        self.check("priority", -1000, 1000)
        if self.priority != int(self.priority):
            raise ReflexError(f"{self.name}: priority is a whole number, got {self.priority!r}")
        given = {name: getattr(self, name) for name in SELECTOR_FIELDS}
        try:
            self.selector = ContactSelector.from_arguments(**given)
        except SelectorError as error:
            raise ReflexError(f"{self.name}: {error}") from error

    def check(self, what: str, least: float, largest: float) -> None:
        """Refuse an attribute that is not a number within bounds.

        Raises:
            ReflexError: It is not.
        """
        value = getattr(self, what)
        if not (is_number(value) and least <= value <= largest):
            raise ReflexError(
                f"{self.name}: {what} is a number from {least:g} to {largest:g}, got {shown(value)}"
            )

    def setup(self, robot: RobotConfig) -> None:
        """Learn of the robot, before anything moves.

        Raises:
            UnknownNameError: Its limb, link or joint does not exist.
            ReflexError: No contact can meet its conditions.
        """
        self.robot = robot
        self.joints: BoolArray = np.zeros(len(robot.joint_names), dtype=np.bool_)
        self.granted_joints: BoolArray = np.zeros_like(self.joints)
        self.held_joints: BoolArray = np.zeros_like(self.joints)
        try:
            self.selector.check(robot)
        except SelectorError as error:
            raise ReflexError(f"{self.name}: {error}") from error
        self.reset()

    def reset(self) -> None:
        """Forget all contacts."""
        self._touching: dict[int, str] = {}
        self._given_up: set[int] = set()
        self._until: float | None = None
        self._began, self.contact = None, None
        self.granted_joints = self.held_joints = np.zeros_like(self.joints)

    @property
    def active(self) -> bool:
        """True while the reflex is active."""
        return self._began is not None

    @property
    def touched(self) -> bool:
        """True while a contact that it is for lasts."""
        return bool(self._touching)

    @property
    def resources(self) -> frozenset[Resource]:
        """Parts that only one reflex gets: the ``joints`` of a limb, the ``base``, or the ``contacts``."""
        return frozenset({"joints", "base"})

    def matches(self, contact: Contact) -> bool:
        """Return True where this contact starts it, in any phase."""
        return meets(contact, self.selector)

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """React to one tick; a few microseconds, no waiting."""
        time = measurement.time
        for contact in observation.contacts:
            self._take_in(contact, time, requests)
        if self._began is None:
            return
        if self._touching and time - self._began > self.max_duration:
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
                    self._until = time + self.release_delay
        elif contact.id in self._touching:
            if contact.link != self._touching[contact.id]:
                self._touching[contact.id] = contact.link
                self.begin(contact, requests)
        elif contact.id not in self._given_up and self.matches(contact):
            if self._began is None:
                self._began, self.contact = time, contact
                self.joints = np.zeros_like(self.joints)
                self.granted_joints = self.held_joints = np.zeros_like(self.joints)
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
