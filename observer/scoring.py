"""Score of contacts against known pushes; events of one contact together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pepper_driver.config import RobotConfig
from pepper_driver.config.robot import TRUNK
from pepper_driver.observer.interface import Contact


@dataclass(frozen=True, kw_only=True)
class ContactTrack:
    """One contact as it was told: ``begin``, the ``updates`` in their order, ``end`` [s].

    While it lasts, ``end`` is the time of the last event.
    """

    begin: Contact
    updates: tuple[Contact, ...]
    end: float

    def at(self, time: float) -> Contact:
        """Return the report of the contact at a time [s]: the last event until then; ``begin`` before it."""
        return next((event for event in reversed(self.updates) if event.time <= time), self.begin)

    def limbs(self, until: float, robot: RobotConfig) -> frozenset[str]:
        """Return the limbs it was put on until a time [s], that of its begin always."""
        told = (self.begin, *(event for event in self.updates if event.time <= until))
        return frozenset(robot.limb_of(event.joint) for event in told)


def group_events(contacts: Iterable[Contact]) -> tuple[ContactTrack, ...]:
    """Return the contacts that the events of one run tell of, in the order in which they begin.

    Events of a contact whose begin is missing are left out.
    """
    lives: list[list[Contact]] = []
    current: dict[int, list[Contact]] = {}
    for event in contacts:
        if event.phase == "begin":
            current[event.id] = [event]
            lives.append(current[event.id])
        elif event.id in current:
            current[event.id].append(event)
    return tuple(
        ContactTrack(
            begin=life[0],
            updates=tuple(event for event in life if event.phase == "update"),
            end=life[-1].time,
        )
        for life in lives
    )


RELEASE_GRACE = 0.15
"""[s] A contact detected this long after the release still counts as detected."""

SETTLED = 0.17
"""[s] After the alarm; observers may name the joint again until 150 ms after it, and tell so in the next tick."""

REBOUND_TIME = 0.8
"""[s] After a release the joint swings back; alarms in this time are neither detected pushes nor false contacts."""

RUN_GAP = 0.3
"""[s] An alarm that begins sooner after another on the same limb is the same run of alarms."""


@dataclass(frozen=True, kw_only=True)
class KnownPush:
    """A push or a pull that really happened.

    Attributes:
        joint: The joint it was meant for: the last of its chain that it turns. None for a push on trunk or base.
        link: Where it acted.
        direction: Sign of its torque on the joint.
        force: Its largest size [N]; of a grab, what its spring pulls with while the link does not give way.
        torque: Largest torque on the joint [N m].
        degrees: That torque divided by the proportional stiffness of the joint [deg]; on trunk and base, of the leg
            joint where that is most. NaN where nobody measured it.
        onset: When the force began [s].
        release: When it had ended [s].
        moving: Whether the joint was meant to move at its onset.
        saturating: Whether it was meant to take a motor board beyond what it can hold.
        saturated: Whether the joint's motor board was at its limit meanwhile: such pushes are to be scored apart.
    """

    joint: str | None
    link: str
    direction: int
    force: float
    torque: float
    degrees: float
    onset: float
    release: float
    moving: bool
    saturating: bool = False
    saturated: bool = False


@dataclass(frozen=True, kw_only=True)
class DetectedPush:
    """A push with the contact that reported it: as it began, and with all that was told of it later."""

    push: KnownPush
    contact: Contact
    alarm: ContactTrack

    @property
    def delay(self) -> float:
        """From the onset of the force to the detection [s]."""
        return self.contact.detection_time - self.push.onset

    @property
    def settled(self) -> Contact:
        """The contact once its joint has been named for the last time, SETTLED after its detection."""
        return self.alarm.at(self.contact.detection_time + SETTLED)


@dataclass(frozen=True, kw_only=True)
class ContactScore:
    """Outcome of a run.

    Attributes:
        detected: Pushes with the first contact on their limb.
        missed: Pushes without one.
        false: Contacts that no push explains.
        rebounds: Contacts that were the joint swinging back after a push: not counted, as in the paper.
        repeated: Further contacts on the limb during a push that was detected already, and those that only go on with
            an earlier one.
        on_trunk: Contacts told on the trunk while a limb was pushed: it carries the limb. Neither detected nor false.
    """

    detected: tuple[DetectedPush, ...]
    missed: tuple[KnownPush, ...]
    false: tuple[Contact, ...]
    rebounds: tuple[Contact, ...]
    repeated: tuple[Contact, ...]
    on_trunk: tuple[Contact, ...] = ()


def score(
    pushes: Sequence[KnownPush], contacts: Sequence[Contact], robot: RobotConfig
) -> ContactScore:
    """Match the contacts that the events of a run tell of with ``pushes``.

    A push is detected when a contact begins from its onset until RELEASE_GRACE after its release, in whatever
    direction, and is on the pushed limb then or is moved there by an update in that time. Limbs are the arms, the head,
    and the trunk with legs and base. A contact that begins on that limb until REBOUND_TIME after the release belongs to
    the push too: a rebound, or a repetition of what was detected; so does one on the trunk, which carries the limb. Any
    other contact is false, unless it goes on with another on the same limb within RUN_GAP.
    """
    detected: dict[int, DetectedPush] = {}
    false: list[Contact] = []
    rebounds: list[Contact] = []
    repeated: list[Contact] = []
    on_trunk: list[Contact] = []
    over: dict[str, float] = {}
    for alarm in group_events(contacts):
        contact = alarm.begin
        time, limb = contact.detection_time, robot.limb_of(contact.joint)
        continues = time - over.get(limb, -math.inf) < RUN_GAP
        over[limb] = max(over.get(limb, alarm.end), alarm.end)
        near = [n for n, p in enumerate(pushes) if p.onset <= time <= p.release + REBOUND_TIME]
        places = {n: alarm.limbs(pushes[n].release + RELEASE_GRACE, robot) for n in near}
        own = [n for n in near if robot.limb_of(pushes[n].joint) in places[n]]
        carried = [n for n in near if places[n] == {TRUNK}]
        if not own and not carried:
            (repeated if continues else false).append(contact)
            continue
        number = (own or carried)[-1]
        in_time = time <= pushes[number].release + RELEASE_GRACE
        if contact.kind == "rebound" or not in_time:
            rebounds.append(contact)
        elif not own:
            on_trunk.append(contact)
        elif number in detected:
            repeated.append(contact)
        else:
            detected[number] = DetectedPush(push=pushes[number], contact=contact, alarm=alarm)
    return ContactScore(
        detected=tuple(detected[number] for number in sorted(detected)),
        missed=tuple(push for number, push in enumerate(pushes) if number not in detected),
        false=tuple(false),
        rebounds=tuple(rebounds),
        repeated=tuple(repeated),
        on_trunk=tuple(on_trunk),
    )
