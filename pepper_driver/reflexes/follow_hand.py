"""FollowHand: lead the robot by the hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.robot import TRUNK
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks import BaseVelocityTask
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.comply import Comply
from pepper_driver.reflexes.reflex import ReflexError, Resource, Then
from pepper_driver.reflexes.requests import DOMINANT_WEIGHT, ReflexRequests

FollowWith = Literal["arm", "base"]

LIKELY_FORCE = 30.0
"""[N] Size of likely forces: components that joints cannot measure are assumed small."""

BASE_STIFFNESS = 16.0
"""[1/s2] Of the task that moves the base."""


@checked_arguments
@dataclass(kw_only=True, eq=False)
class FollowHand(Comply):
    """The arm, or the base, follows the hand that pulls the robot's arm.

    ``follow_with: arm`` is a free :class:`Comply` that stays where it was led to. With ``follow_with: base`` the arm
    keeps its posture, and the base rolls as the horizontal force on the hand pulls it: speed = force /
    ``base_damping``, beyond a dead band of ``base_deadband``.

    Attributes:
        follow_with: ``arm`` or ``base``.
        base_damping: [N s/m] Of the base.
        base_deadband: Force up to which the base stays [N].
        speed: Of the base, at most [m/s].
        smoothing_time: Of the force [s]: a base that follows every tremor of the estimate would jerk.
    """

    then: Then = "stay"
    follow_with: FollowWith = "arm"
    base_damping: float = 60.0
    base_deadband: float = 3.0
    speed: float = 0.25
    smoothing_time: float = 0.15

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.follow_with not in get_args(FollowWith):
            raise ReflexError(
                f"{self.name}: 'follow_with' is 'arm' or 'base', got {self.follow_with!r}"
            )
        self.check("base_damping", 1.0, 1e4)
        self.check("base_deadband", 0.0, 100.0)
        self.check("speed", 0.01, 1.0)
        self.check("smoothing_time", 0.02, 5.0)
        if self.follow_with == "base":
            self.gain = 0.0  # the arm is what one pulls at

    @property
    def resources(self) -> frozenset[Resource]:
        """The limb, and the base that may follow."""
        return frozenset({"joints", "base"} if self.follow_with == "base" else {"joints"})

    def setup(self, robot: RobotConfig) -> None:
        """Learn of the robot."""
        super().setup(robot)
        self._base = BaseVelocityTask(
            stiffness=BASE_STIFFNESS,
            weight=DOMINANT_WEIGHT / 10.0,
            name=f"reflex: {self.name}, base",
        )
        self._force = np.zeros(2)
        self._model = RobotModel(robot)

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Lead the arm; find the hand that is pulled."""
        super().begin(contact, requests)
        if contact.limb != TRUNK:
            joints = self.robot.limbs[contact.limb]
            wrist = next(name for name in reversed(joints) if name not in self.robot.hands.joints)
            self._link = self.robot.joints[self.robot.joint_index(wrist)].child
            self._force[:] = 0.0

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Follow."""
        super().act(observation, measurement, requests)
        if self.follow_with != "base" or not self.granted or not requests.claim_base():
            self._force[:] = 0.0
            return
        fraction = self.robot.cycle / self.smoothing_time
        self._force += fraction * (self._horizontal_force(observation, measurement) - self._force)
        size = float(np.linalg.norm(self._force))
        beyond = max(size - self.base_deadband, 0.0)
        velocity = min(beyond / self.base_damping, self.speed) * self._force / max(size, 1e-9)
        self._base.target = np.array([velocity[0], velocity[1], 0.0])
        requests.add_task(self._base)

    def _horizontal_force(self, observation: Observation, measurement: Measurement) -> FloatArray:
        """(2,) likeliest force on the hand in the axes of base_link [N], from the torques of its arm."""
        torque, unsure = observation.torque[self.joints], observation.torque_std[self.joints]
        known = np.isfinite(torque) & np.isfinite(unsure) & (unsure > 0.0)
        if not (self.touched and known.any()):
            return np.zeros(2)
        posture = measurement.position
        jacobian = self._model.point_jacobian(self._link, np.zeros(3), posture)[:, self.joints]
        weight = np.where(known, 1.0 / np.where(known, unsure, 1.0), 0.0)
        rows = jacobian.T * weight[:, None]
        normal = rows.T @ rows + np.eye(3) / LIKELY_FORCE**2
        force: FloatArray = np.linalg.solve(
            normal, rows.T @ (weight * np.where(known, torque, 0.0))
        )
        return force[:2]
