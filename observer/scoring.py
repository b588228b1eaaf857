"""Scores felt contacts against pushes that are known to have happened. Event by event, as in Table I of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pepper_driver.config import RobotConfig
from pepper_driver.observer.contact import Contact

RELEASE_GRACE = 0.15
"""[s] A contact detected this long after the release still counts as felt."""

REBOUND_TIME = 0.8
"""[s] After a release the joint swings back; alarms in this time are neither felt pushes nor false contacts."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """A push or a pull that really happened.

    Attributes:
        joint: The joint it was meant for: the last of its chain that it turns.
        link: Where it acted.
        direction: Sign of its torque on the joint.
        force: Its largest size [N]; of a grab, what its spring pulls with while the link does not give way.
        torque: Largest torque on the joint [N m].
        degrees: That torque divided by the proportional stiffness of the joint [deg].
        onset: When the force began [s].
        release: When it had ended [s].
        moving: Whether the joint was meant to move at its onset.
        saturating: Whether it was meant to take a motor board beyond what it can hold.
        saturated: Whether the joint's motor board was at its limit meanwhile: such pushes are to be scored apart.
    """

    joint: str
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
class Felt:
    """A push with the contact that reported it."""

    push: Push
    contact: Contact

    @property
    def delay(self) -> float:
        """From the onset of the force to the detection [s]."""
        return self.contact.detection_time - self.push.onset


@dataclass(frozen=True, kw_only=True)
class Score:
    """Outcome of a run.

    Attributes:
        felt: Pushes with the first contact on their chain.
        missed: Pushes without one.
        false: Contacts that no push explains.
        rebounds: Contacts that were the joint swinging back after a push: not counted, as in the paper.
        repeated: Further contacts on the chain during a push that was felt already.
    """

    felt: tuple[Felt, ...]
    missed: tuple[Push, ...]
    false: tuple[Contact, ...]
    rebounds: tuple[Contact, ...]
    repeated: tuple[Contact, ...]


def score(pushes: Sequence[Push], contacts: Sequence[Contact], robot: RobotConfig) -> Score:
    """Match the begin events among ``contacts`` with ``pushes``.

    A push is felt when a contact begins on any joint of its chain, in whatever direction, from its onset until
    RELEASE_GRACE after its release. A contact that begins on that chain until REBOUND_TIME after the release belongs to
    the push too: a rebound, or a repetition of what was felt. Any other is false.
    """
    felt: dict[int, Felt] = {}
    false, rebounds, repeated = [], [], []
    for contact in contacts:
        if contact.phase != "begin":
            continue
        chain = robot.chain_of(contact.joint) if contact.joint is not None else ()
        near = [
            (number, push)
            for number, push in enumerate(pushes)
            if push.joint in chain
            and push.onset <= contact.detection_time <= push.release + REBOUND_TIME
        ]
        if not near:
            false.append(contact)
            continue
        number, push = near[-1]
        in_time = contact.detection_time <= push.release + RELEASE_GRACE
        if contact.kind == "rebound" or not in_time:
            rebounds.append(contact)
        elif number in felt:
            repeated.append(contact)
        else:
            felt[number] = Felt(push=push, contact=contact)
    return Score(
        felt=tuple(felt[number] for number in sorted(felt)),
        missed=tuple(push for number, push in enumerate(pushes) if number not in felt),
        false=tuple(false),
        rebounds=tuple(rebounds),
        repeated=tuple(repeated),
    )
