"""A contact, as callbacks, reflexes and the log see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pepper_driver.config.contact_selector import Kind

Phase = Literal["begin", "update", "end"]
Direction = Literal[-1, 1]

INTENSITY_STEP_DEG = 0.1
"""[deg] Change of the intensity that is worth an update."""

TORQUE_STEP_STDS = 0.5
"""Standard deviations of the torque: change of it that is worth an update. Smaller ones are noise."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Contact:
    """One event in the life of a contact.

    Attributes:
        id: Number of the contact; its begin, updates and end share it.
        phase: ``begin``, ``update`` or ``end``. An update comes at once when kind, place or direction change. When only
            intensity or torque change, it comes ``update_period`` (settings) or more after the event before.
        kind: ``contact``; ``collision`` when it is hard; ``rebound`` when the joint only swings back after one.
        limb: ``left_arm``, ``right_arm``, ``head`` or ``trunk``, which includes the base: that of the joint.
        joint: The last joint of the chain that feels it; None for trunk and base.
        link: The link that hangs on that joint.
        direction: Sign of the external torque on the joint, in the joint's positive sense: minus the sign of the
            residual r = eps - eps_exp.
        intensity: Largest size of the residual so far [deg]; 0 where only the wheels feel it.
        torque: External torque estimate on the joint [N m], signed; None where no estimate exists.
        torque_std: Its standard deviation [N m]; None where no estimate exists.
        onset_time: Clock of the robot when the residual began to leave its free-motion band [s].
        detection_time: When the contact was first reported [s].
        time: When this happened [s]; an ``end`` is raised a little later, once the residual has stayed low.
    """

    id: int
    phase: Phase
    kind: Kind
    limb: str
    joint: str | None
    link: str
    direction: Direction
    intensity: float
    torque: float | None
    torque_std: float | None
    onset_time: float
    detection_time: float
    time: float
