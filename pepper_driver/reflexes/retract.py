"""Retract: away from what touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tasks import PostureTask
from pepper_driver.observer import Contact, Observation
from pepper_driver.reflexes.reflex import Reflex, Resource, limb_joints
from pepper_driver.reflexes.requests import BRAKING_STIFFNESS, DOMINANT_WEIGHT, ReflexRequests


@checked_arguments
@dataclass(kw_only=True, eq=False)
class Retract(Reflex):
    """The limb moves away from the contact while it lasts: its joints turn along the external torque.

    The joint with the largest torque starts at ``speed``, the others in proportion to their torques: J J^T f, nearly
    along the force.
    They stop when the torque has fallen to a quarter, or after ``distance``, and wait there. A hand that holds on
    is followed no further than until it pulls the other way. A contact on trunk or base moves no limb.

    Attributes:
        distance: That the first joint turns at most [rad].
        speed: Of that joint [rad/s].
        min_torque_ratio: Joints with less than this fraction of the largest torque on the limb stay where they are.
        stop_torque_ratio: The limb stops when the torque is below this fraction of its largest value.
    """

    priority: int = 40
    release_delay: float = 1.0
    distance: float = 0.4
    speed: float = 0.6
    min_torque_ratio: float = 0.2
    stop_torque_ratio: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("distance", 0.01, 1.5)
        self.check("speed", 0.01, 3.0)
        self.check("min_torque_ratio", 0.0, 1.0)
        self.check("stop_torque_ratio", 0.0, 1.0)

    @property
    def resources(self) -> frozenset[Resource]:
        """The limb."""
        return frozenset({"joints"})

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Choose the limb; the torques of this tick give the direction. A further contact continues the motion."""
        joints = limb_joints(contact, self.robot)
        if not joints.any():
            return
        if not np.array_equal(joints, self.joints):
            self.joints = joints
            names = [self.robot.joint_names[joint] for joint in np.flatnonzero(joints)]
            self._task = PostureTask(
                names,
                stiffness=BRAKING_STIFFNESS,
                weight=DOMINANT_WEIGHT,
                name=f"reflex: {self.name}",
                robot=self.robot,
            )
            self._task.target = requests.controller.stopping_position(BRAKING_STIFFNESS)[joints]
        self._contact, self._motion, self._remaining = contact, np.zeros(len(joints)), 0.0
        self._waited = False

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Move on, or wait."""
        if not self.joints.any():
            return
        if not requests.claim(self.joints):
            self._waited = True
            return
        if self._waited:  # the limb has been led elsewhere meanwhile
            self._waited, self._task.target = (
                False,
                requests.controller.stopping_position(BRAKING_STIFFNESS)[self.joints],
            )
            self._motion[:] = 0.0
        if not self._motion.any():
            self._motion, self._peak = self._direction(observation), 0.0
            self._remaining = self.distance
        if self._remaining > 0.0:
            torque = float(self._motion @ np.nan_to_num(observation.torque))
            self._peak = max(self._peak, torque)
            step = min(self.speed * self.robot.cycle, self._remaining)
            self._remaining -= step
            target = self._task.target + step * self._motion[self.joints]
            if torque < self.stop_torque_ratio * self._peak:
                self._remaining, target = (
                    0.0,
                    requests.controller.stopping_position(BRAKING_STIFFNESS)[self.joints],
                )
            controller = requests.controller
            lower, upper = controller.lower[self.joints], controller.upper[self.joints]
            self._task.target = np.clip(target, lower, upper)
        requests.add_task(self._task)

    def _direction(self, observation: Observation) -> FloatArray:
        """(17,) direction of the motion, its largest component 1 in size."""
        torque: FloatArray = np.where(self.joints, np.nan_to_num(observation.torque), 0.0)
        torque[np.abs(torque) < self.min_torque_ratio * np.abs(torque).max()] = 0.0
        largest = float(np.abs(torque).max())
        if largest > 0.0:
            return torque / largest
        if self._contact.joint is not None:
            torque[self.robot.joint_index(self._contact.joint)] = self._contact.direction
        return torque
