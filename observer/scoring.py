"""Score of contacts against known pushes, and the events of each contact as one track."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from pepper_driver.config import RobotConfig
from pepper_driver.config.robot import TRUNK
from pepper_driver.observer.interface import Contact


@dataclass(frozen=True, kw_only=True)
class ContactTrack:
    """One reported contact: ``begin``, the ``updates`` in their order, ``end`` [s].

    While it lasts, ``end`` is the time of the last event.
    """

    begin: Contact
    updates: tuple[Contact, ...]
    end: float

    def at(self, time: float) -> Contact:
        """Return the last event until a time [s]; ``begin`` for earlier times."""
        return next((event for event in reversed(self.updates) if event.time <= time), self.begin)

    def limbs(self, until: float, robot: RobotConfig) -> frozenset[str]:
        """Return the limbs that were reported until a time [s], that of ``begin`` always."""
        reported = (self.begin, *(event for event in self.updates if event.time <= until))
        return frozenset(robot.limb_of(event.joint) for event in reported)


def group_events(contacts: Iterable[Contact]) -> tuple[ContactTrack, ...]:
    """Return the contacts that the events of one run report, in the order in which they begin.

    Events of a contact without ``begin`` are left out.
    """
    tracks: list[list[Contact]] = []
    current: dict[int, list[Contact]] = {}
    for event in contacts:
        if event.phase == "begin":
            current[event.id] = [event]
            tracks.append(current[event.id])
        elif event.id in current:
            current[event.id].append(event)
    return tuple(
        ContactTrack(
            begin=events[0],
            updates=tuple(event for event in events if event.phase == "update"),
            end=events[-1].time,
        )
        for events in tracks
    )


RELEASE_GRACE = 0.15
"""[s] A contact that begins this long after the release still counts as the detection of the push."""

ISOLATION_TIME = 0.17
"""[s] After the detection. Observers isolate the joint again until 150 ms, and report it in the next tick."""

REBOUND_TIME = 0.8
"""[s] After a release the joint swings back; contacts in this time are neither detected pushes nor false."""

JOINT_FRACTION = 0.7
"""A joint is right if it has at least this fraction of the largest torque on the limb's joints."""

RUN_GAP = 0.3
"""[s] A contact that begins within this time after another on the same limb continues it."""


@dataclass(frozen=True, kw_only=True)
class KnownPush:
    """A push or a pull that is known from a simulation or a label.

    Attributes:
        joint: The last joint of the chain that it turns. None for a push on trunk or base.
        link: Link on which it acted.
        direction: Sign of its torque on the joint.
        force: Its largest size [N]; of a grab, the pull of the elastic hand on a link that does not move.
        torque: Largest torque on the joint [N m].
        torques: By joint of its limb, the largest torque, signed [N m]; empty where it is unknown.
        degrees: That torque divided by the proportional stiffness of the joint [deg]; on trunk and base, the largest
            value of the leg joints. NaN where the force is unknown.
        onset: When the force began [s].
        release: When it had ended [s].
        moving: True if the joint was to move at its onset.
        saturating: True if it was planned to exceed what a motor board can hold.
        saturated: True if the motor board of the joint reached its limit: such pushes are scored separately.
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
    torques: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class DetectedPush:
    """A push with the contact that detected it: ``contact`` is its begin, ``track`` all its events."""

    push: KnownPush
    contact: Contact
    track: ContactTrack

    @property
    def delay(self) -> float:
        """Time from the onset of the force to the detection [s]."""
        return self.contact.detection_time - self.push.onset

    @property
    def final_contact(self) -> Contact:
        """The contact after its last isolation, ISOLATION_TIME after its detection."""
        return self.track.at(self.contact.detection_time + ISOLATION_TIME)

    @property
    def joint_right(self) -> bool:
        """True if the joint of that contact has at least JOINT_FRACTION of the largest torque on the limb's joints."""
        joint = self.final_contact.joint
        if joint is None or not self.push.torques:
            return joint == self.push.joint
        largest = max(map(abs, self.push.torques.values()))
        return abs(self.push.torques.get(joint, 0.0)) >= JOINT_FRACTION * largest

    @property
    def direction_right(self) -> bool:
        """True if the direction of that contact is the sign of the torque on its joint."""
        contact, push = self.final_contact, self.push
        torque = push.torques.get(contact.joint or "", push.direction)
        return contact.direction * torque > 0.0


@dataclass(frozen=True, kw_only=True)
class ContactScore:
    """Outcome of a run.

    Attributes:
        detected: Pushes with the first contact on their limb.
        missed: Pushes without one.
        false: Contacts that no push explains.
        rebounds: Contacts of a joint that swings back after a push: not counted, as in the paper.
        repeated: Further contacts on the limb during a push that was detected already, and those that continue an
            earlier one.
        on_trunk: Contacts on the trunk while a limb was pushed, because the trunk carries it. Neither detected nor
            false.
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
    """Match the contacts that the events of a run report with ``pushes``.

    - A push is detected when a contact begins between its onset and RELEASE_GRACE after its release, in any direction.
      The contact must be on the pushed limb, or an update in that time must move it there. Limbs are the arms, the
      head, and the trunk with legs and base.
    - A contact on that limb until REBOUND_TIME after the release belongs to the push too: a rebound or a repetition. So
      does one on the trunk, which carries the limb.
    - Any other contact is false, unless it continues another on the same limb within RUN_GAP.
    """
    detected: dict[int, DetectedPush] = {}
    false: list[Contact] = []
    rebounds: list[Contact] = []
    repeated: list[Contact] = []
    on_trunk: list[Contact] = []
    last_end: dict[str, float] = {}
    for track in group_events(contacts):
        contact = track.begin
        time, limb = contact.detection_time, robot.limb_of(contact.joint)
        continues = time - last_end.get(limb, -math.inf) < RUN_GAP
        last_end[limb] = max(last_end.get(limb, track.end), track.end)
        # Pushes overlap: a hand may push the next limb before the joint of the last one has come to rest.
        near = [n for n, p in enumerate(pushes) if p.onset <= time <= p.release + REBOUND_TIME]
        places = {n: track.limbs(pushes[n].release + RELEASE_GRACE, robot) for n in near}
        own = [n for n in near if robot.limb_of(pushes[n].joint) in places[n]]
        carried = [n for n in near if places[n] == {TRUNK}]
        if not own and not carried:
            (repeated if continues else false).append(contact)
            continue
        # Of pushes that overlap in time, the latest counts.
        number = (own or carried)[-1]
        in_time = time <= pushes[number].release + RELEASE_GRACE
        if contact.kind == "rebound" or not in_time:
            rebounds.append(contact)
        elif not own:
            on_trunk.append(contact)
        elif number in detected:
            repeated.append(contact)
        else:
            detected[number] = DetectedPush(push=pushes[number], contact=contact, track=track)
    return ContactScore(
        detected=tuple(detected[number] for number in sorted(detected)),
        missed=tuple(push for number, push in enumerate(pushes) if number not in detected),
        false=tuple(false),
        rebounds=tuple(rebounds),
        repeated=tuple(repeated),
        on_trunk=tuple(on_trunk),
    )
