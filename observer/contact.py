"""A contact, as callbacks, reflexes and the log see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Phase = Literal["begin", "update", "end"]
Kind = Literal["contact", "collision", "rebound"]
Direction = Literal[-1, 1]


@dataclass(frozen=True, kw_only=True, slots=True)
class Contact:
    """One event in the life of a contact.

    Attributes:
        id: Number of the contact; its begin, updates and end share it.
        phase: ``begin``, ``update`` or ``end``.
        kind: ``contact``; ``collision`` when it is hard; ``rebound`` when the joint only swings back after one.
        joint: The last joint of the chain that feels it; None for trunk and base.
        link: The link that hangs on that joint.
        direction: Sign of the external torque on the joint, in the joint's positive sense: minus the sign of the
            residual r = eps - eps_exp.
        intensity: Largest size of the residual so far [deg].
        torque: External torque estimate on the joint [N m], signed; None where no estimate exists.
        torque_std: Its standard deviation [N m]; None where no estimate exists.
        onset_time: Clock of the robot when the residual began to leave its free-motion band [s].
        detection_time: When the contact was detected [s].
        time: When this happened [s]; an ``end`` is raised a little later, once the residual has stayed low.
    """

    id: int
    phase: Phase
    kind: Kind
    joint: str | None
    link: str
    direction: Direction
    intensity: float
    torque: float | None
    torque_std: float | None
    onset_time: float
    detection_time: float
    time: float
