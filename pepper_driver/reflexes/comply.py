"""Compliant reflexes: comply with a push, assist a motion."""

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
from pepper_driver.reflexes.reflex import Reflex, Resource, Then, limb_joints
from pepper_driver.reflexes.requests import ReflexRequests

MIN_GAIN = 0.01
"""Gain below which joints do not comply at all."""

MAX_SPRING_STIFFNESS = 2000.0
"""[1/s2] The controller takes no stiffer task."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Comply(Reflex):
    """The joints of the touched limb comply with the external torque that the observer estimates.

    Each moves as if it had a small inertia, some friction, and a spring to where it was: inertia qdd = torque -
    damping qd - K (1 - gain) / gain (q - q0), with K of 40 N m/rad. Torques within two standard deviations of their
    estimate move nothing. Afterwards the joints return to the user's posture, or stay where they are.

    Attributes:
        gain: 0..1, from stiff, where the joints stand still, to free, where they move as long as a person pushes.
        damping: [N m s/rad] Up to 12. At the free end, a newton metre makes a speed of 1 / damping.
        max_torque: No more of it counts [N m].
        inertia: Apparent inertia of a joint [kg m2].
        half_gain_stiffness: K, the apparent stiffness of a joint at half the gain [N m/rad].
        torque_deadband_stds: Torques within so many standard deviations of their estimate move nothing.
        coast_damping: Of joints that are not pushed any more [1/s]: a joint that coasts causes a rebound later.
    """

    priority: int = 30
    gain: float = 1.0
    damping: float = 1.5
    max_torque: float = 8.0
    inertia: float = 0.1
    half_gain_stiffness: float = 40.0
    torque_deadband_stds: float = 2.0
    coast_damping: float = 60.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("gain", 0.0, 1.0)
        self.check("inertia", 0.02, 1.0)
        self.check("damping", 0.05, MAX_DAMPING * self.inertia)
        self.check("half_gain_stiffness", 1.0, 200.0)
        self.check("torque_deadband_stds", 0.0, 10.0)
        self.check("coast_damping", 1.0, MAX_DAMPING)
        self.check("max_torque", 0.1, 100.0)

    @property
    def resources(self) -> frozenset[Resource]:
        """The limb."""
        return frozenset({"joints"})

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Include this limb from now on, next to those included before."""
        joints = self.joints | limb_joints(contact, self.robot)
        if np.array_equal(joints, self.joints):
            return
        self.joints = joints
        names = [self.robot.joint_names[joint] for joint in np.flatnonzero(joints)]
        ratio = (1.0 - self.gain) / max(self.gain, MIN_GAIN)
        spring = min(self.half_gain_stiffness / self.inertia * ratio, MAX_SPRING_STIFFNESS)
        self._damping = max(self.damping / self.inertia, 2.0 * sqrt(spring))
        self._task = ComplianceTask(
            names,
            inertia=self.inertia,
            stiffness=spring,
            damping=self._damping,
            dead_band=0.0,
            max_torque=self.max_torque,
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
        # After the release, the residual is friction that holds the joints away from their target.
        pushed = np.count_nonzero(observation.state[self.joints] == JointState.CONTACT)
        if self.gain >= MIN_GAIN and pushed:
            self._task.torque, self._task.damping = self.external_torque(observation), self._damping
        else:
            self._task.torque, self._task.damping = np.zeros(self._task.rows), self.coast_damping
        requests.add_task(self._task)

    def external_torque(self, observation: Observation) -> FloatArray:
        """(joints,) external torque beyond what may be noise [N m]; 0 where nothing is known."""
        torque, unsure = observation.torque[self.joints], observation.torque_std[self.joints]
        beyond = np.abs(torque) - self.torque_deadband_stds * unsure
        with np.errstate(invalid="ignore"):
            return np.where(beyond > 0.0, np.copysign(beyond, torque), 0.0)


HELP_RANGE = (0.1, 10.0)
"""Range of the adaptation, as a factor on the admittance of the same :class:`Comply`."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Assist(Comply):
    """A :class:`Comply` whose gain adapts, so that the torque of the interaction stays at ``torque``.

    Who pushes harder than that is helped more, who pushes less is helped less: the adaptive-gain motion assistance
    that the paper names as its aim (Sec. VII).

    Attributes:
        torque: On the joint with the largest one [N m].
        adaptation_rate: The help grows by a factor e in 1 / rate while the torque is twice ``torque`` [1/s].
    """

    then: Then = "stay"
    torque: float = 2.0
    adaptation_rate: float = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("torque", 0.1, 50.0)
        self.check("adaptation_rate", 0.1, 20.0)

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Begin as Comply does, with no more help than it gives."""
        if not self.joints.any():
            self._help = 1.0
        super().begin(contact, requests)

    def external_torque(self, observation: Observation) -> FloatArray:
        """(joints,) torque to follow, times the help [N m]."""
        torque = super().external_torque(observation)
        excess = np.clip(np.abs(torque).max(initial=0.0) / self.torque - 1.0, -1.0, 1.0)
        change = np.exp(self.adaptation_rate * self.robot.cycle * excess)
        self._help = float(np.clip(self._help * change, *HELP_RANGE))
        return self._help * torque
