"""A reflex of your own: the arm that is touched goes up."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver import Contact, Observation, Reflex
from pepper_driver.backends import Measurement
from pepper_driver.controller import PostureTask
from pepper_driver.reflexes import ReflexRequests

STIFFNESS = 30.0  # [1/s2] of the task
WEIGHT = 1e6  # outweighs the program's tasks


@dataclass(kw_only=True, eq=False)
class LiftArm(Reflex):
    """Lift the arm that is touched, sideways and up, as long as the contact lasts and ``release_delay`` [s] longer.

    Attributes:
        angle: Of the shoulder roll, away from the trunk [rad].
    """

    priority: int = 60
    angle: float = 0.8

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("angle", 0.1, 1.4)  # a ReflexError where it is not within

    def begin(self, contact: Contact, requests: ReflexRequests) -> None:
        """Choose the arm; a contact elsewhere lifts none."""
        chains = [
            chain
            for chain in ("left_arm", "right_arm")
            if contact.joint in self.robot.chains[chain]
        ]
        self._arm = chains[0] if chains else None
        if self._arm is not None:
            left = self._arm == "left_arm"
            self._task = PostureTask(
                ["LShoulderRoll" if left else "RShoulderRoll"],
                stiffness=STIFFNESS,
                weight=WEIGHT,
                name=f"reflex: {self.name}",
                robot=self.robot,
            )
            self._task.target = [self.angle if left else -self.angle]

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Hold it there: what is requested counts for this tick."""
        if self._arm is not None and requests.claim(self._arm):
            requests.add_task(self._task)
