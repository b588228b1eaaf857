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
    """The limb moves away from the contact, as long as it is felt: its joints turn as the external torque turns them.

    The joint that feels most sets off at ``speed``, the others in proportion to their torques: J J^T f, nearly along
    the force.
    They stop when the torque has gone down to a quarter, or after ``distance``, and wait there. A hand that holds on
    is followed no further than until it pulls the other way. A contact that trunk or base feels moves no limb.

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
        """Choose the limb; the way follows from the torques of this tick. A further contact leads on."""
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
        self._answers, self._way, self._left = contact, np.zeros(len(joints)), 0.0
        self._waited = False

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Go on, or wait."""
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
            self._way[:] = 0.0
        if not self._way.any():
            self._way, self._peak = self._direction(observation), 0.0
            self._left = self.distance
        if self._left > 0.0:
            felt = float(self._way @ np.nan_to_num(observation.torque))
            self._peak = max(self._peak, felt)
            step = min(self.speed * self.robot.cycle, self._left)
            self._left -= step
            target = self._task.target + step * self._way[self.joints]
            if felt < self.stop_torque_ratio * self._peak:
                self._left, target = (
                    0.0,
                    requests.controller.stopping_position(BRAKING_STIFFNESS)[self.joints],
                )
            controller = requests.controller
            lower, upper = controller.lower[self.joints], controller.upper[self.joints]
            self._task.target = np.clip(target, lower, upper)
        requests.add_task(self._task)

    def _direction(self, observation: Observation) -> FloatArray:
        """(17,) the way to go, the largest part 1 in size."""
        felt: FloatArray = np.where(self.joints, np.nan_to_num(observation.torque), 0.0)
        felt[np.abs(felt) < self.min_torque_ratio * np.abs(felt).max()] = 0.0
        largest = float(np.abs(felt).max())
        if largest > 0.0:
            return felt / largest
        if self._answers.joint is not None:
            felt[self.robot.joint_index(self._answers.joint)] = self._answers.direction
        return felt
