"""Reflexes that give way: comply with a push, assist a motion."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tasks import ComplianceTask
from pepper_driver.controller.tasks.task import MAX_DAMPING
from pepper_driver.observer import Contact, JointState, Observation
from pepper_driver.reflexes.reflex import Part, Reflex, Then, limb_joints
from pepper_driver.reflexes.requests import ReflexRequests

INERTIA = 0.1
"""[kg m2] That a joint seems to have."""

STIFFNESS = 40.0
"""[N m/rad] That it seems to have, beside its own, at half the gain."""

SURE = 2.0
"""Standard deviations of the torque estimate that move nothing: joints would follow the observer's noise."""

STIFF = 0.01
"""Gain below which joints do not give way at all."""

BRAKING = 60.0
"""[1/s] Of joints that nobody pushes any more: what they coast on is a swing back later."""

STIFFEST = 2000.0
"""[1/s2] Of the spring: the controller takes no stiffer task."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Comply(Reflex):
    """The joints of the limb that is touched give way to the external torque that the observer tells of.

    Each moves as if it had a small inertia, some friction, and a spring to where it was: inertia qdd = torque -
    damping qd - K (1 - gain) / gain (q - q0), with K of 40 N m/rad. Torques within two standard deviations of their
    estimate move nothing. Afterwards the joints go back to the user's posture, or stay where they were led to.

    Attributes:
        gain: 0..1, from stiff, where the joints stand still, to free, where they go on as long as somebody pushes.
        damping: [N m s/rad] Up to 12. At the free end, a newton metre makes a speed of 1 / damping.
        largest_torque: No more of it counts [N m].
    """

    priority: int = 30
    gain: float = 1.0
    damping: float = 1.5
    largest_torque: float = 8.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("gain", 0.0, 1.0)
        self.check("damping", 0.05, MAX_DAMPING * INERTIA)
        self.check("largest_torque", 0.1, 100.0)

    @property
    def takes(self) -> frozenset[Part]:
        """The limb."""
        return frozenset({"joints"})

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Lead the limb from here on, besides those that are led already."""
        joints = self.joints | limb_joints(contact, self.robot)
        if np.array_equal(joints, self.joints):
            return
        self.joints = joints
        names = [self.robot.joint_names[joint] for joint in np.flatnonzero(joints)]
        spring = min(STIFFNESS / INERTIA * (1.0 - self.gain) / max(self.gain, STIFF), STIFFEST)
        self._damping = max(self.damping / INERTIA, 2.0 * sqrt(spring))
        self._task = ComplianceTask(
            names,
            inertia=INERTIA,
            stiffness=spring,
            damping=self._damping,
            dead_band=0.0,
            largest_torque=self.largest_torque,
            name=f"reflex: {self.name}",
            robot=self.robot,
        )

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Follow the torque."""
        self.granted = bool(self.joints.any()) and requests.claim(self.joints)
        if not self.granted:
            return
        # What is felt after the hand has gone is friction that holds the joints off their place.
        pushed = np.count_nonzero(observation.state[self.joints] == JointState.CONTACT)
        if self.gain >= STIFF and pushed:
            self._task.torque, self._task.damping = self.felt(observation), self._damping
        else:
            self._task.torque, self._task.damping = np.zeros(self._task.rows), BRAKING
        requests.add_task(self._task)

    def felt(self, observation: Observation) -> FloatArray:
        """(joints,) external torque beyond what may be noise [N m]; 0 where nothing is known."""
        torque, unsure = observation.torque[self.joints], observation.torque_std[self.joints]
        beyond = np.abs(torque) - SURE * unsure
        with np.errstate(invalid="ignore"):
            return np.where(beyond > 0.0, np.copysign(beyond, torque), 0.0)


HELP = (0.1, 10.0)
"""Times the admittance of the same :class:`Comply`: as far as it adapts."""

RATE = 4.0
"""[1/s] At which it changes by e while the torque is twice what it should be."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Assist(Comply):
    """A :class:`Comply` whose gain adapts, so that the torque of the interaction stays at ``torque``.

    Who pushes harder than that is helped more, who pushes less is helped less: the adaptive-gain motion assistance
    that the paper names as its aim (Sec. VII).

    Attributes:
        torque: On the joint that feels most [N m].
    """

    then: Then = "stay"
    torque: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("torque", 0.1, 50.0)

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Begin as Comply does, with no more help than it gives."""
        if not self.joints.any():
            self._help = 1.0
        super().begin(contact, requests)

    def felt(self, observation: Observation) -> FloatArray:
        """(joints,) torque to follow, times the help [N m]."""
        torque = super().felt(observation)
        excess = np.clip(np.abs(torque).max(initial=0.0) / self.torque - 1.0, -1.0, 1.0)
        change = np.exp(RATE * self.robot.cycle * excess)
        self._help = float(np.clip(self._help * change, *HELP))
        return self._help * torque
