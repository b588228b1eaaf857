"""Requests of the reflexes for one tick."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import shown
from pepper_driver.config.robot import JointSelection, joint_mask
from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.errors import PartError
from pepper_driver.controller.tasks import BaseVelocityTask, Task

DOMINANT_WEIGHT = 1e6
"""Weight of tasks of reflexes that nothing the user asks for outweighs."""

BRAKING_STIFFNESS = 400.0
"""[1/s2] Of tasks that bring joints or base to rest: as fast as the acceleration limits allow."""


class ReflexRequests:
    """Requests for one tick: a reflex repeats its requests in each tick.

    Reflexes are asked in the order of their priority, and joints and base go to the first that claims them. Joints are
    given by name, of a joint or a chain such as ``left_arm``, by a list of names, or by a mask (17,) of bool.

    Attributes:
        controller: Its state and model, to be read only.
        posture: (17,) posture in place of the user's [rad]; None to follow the user.
        posture_stiffness: Stiffness of the posture task [1/s2]; None to follow the user.
        stiffness: (17,) stiffness of the motors 0..1; the safety gate ramps towards it.
        claimed: (17,) joints that a reflex has in this tick.
        released_in_place: (17,) joints that the user's posture shall find, from now on, where they come to rest.
        released_to_posture: (17,) joints that return, from now on, to the user's posture.
        tasks: Tasks for this tick in addition to the user's, by identity.
    """

    def __init__(self, controller: WholeBodyController, robot: RobotConfig) -> None:
        self.controller, self._robot = controller, robot
        self._none: BoolArray = np.zeros(len(robot.joint_names), dtype=np.bool_)
        self._stiff = np.ones(len(self._none))
        self._base_at_rest = BaseVelocityTask(
            stiffness=BRAKING_STIFFNESS, weight=DOMINANT_WEIGHT, name="reflex: base at rest"
        )
        self.clear()

    def clear(self) -> None:
        """Clear the requests of the previous tick."""
        self.posture: FloatArray | None = None
        self.posture_stiffness: float | None = None
        self.stiffness = self._stiff
        self.claimed = self.released_in_place = self.released_to_posture = self._none
        self.tasks: dict[int, Task] = {}
        self._base_claimed = False

    def claim(self, joints: JointSelection) -> bool:
        """Claim joints for this tick: all of them, or none where one is claimed already.

        Raises:
            UnknownNameError: No such joint or chain.
            JointSelectionError: Neither names nor a mask.
        """
        mask = joint_mask(joints, self._robot)
        if np.count_nonzero(self.claimed & mask):
            return False
        self.claimed = self.claimed | mask
        return True

    def claim_base(self) -> bool:
        """Claim the base for this tick, unless it is claimed already."""
        free, self._base_claimed = not self._base_claimed, True
        return free

    def add_task(self, task: Task) -> None:
        """Have the controller follow a task in this tick, in addition to the user's.

        Raises:
            PartError: It is no task.
        """
        if not isinstance(task, Task):
            raise PartError(f"add_task takes a task, got {shown(task)}")
        self.tasks[id(task)] = task

    def hold_posture(self, posture: FloatArray, stiffness: float) -> None:
        """Move the whole robot to a posture (17,) [rad] with a stiffness [1/s2].

        All other tasks pause meanwhile, the base comes to rest, and afterwards they continue. The first request
        counts: it is the one of the highest priority.
        """
        if self.posture is None:
            self.posture, self.posture_stiffness = posture, stiffness

    def lower_stiffness(self, joints: JointSelection, stiffness: float) -> None:
        """Lower the stiffness of motors to 0..1; the lowest request counts. Raises as :meth:`claim` does."""
        mask = joint_mask(joints, self._robot)
        self.stiffness = np.where(mask, np.minimum(self.stiffness, stiffness), self.stiffness)

    def stop_base(self) -> None:
        """Bring the base to rest."""
        self.add_task(self._base_at_rest)

    def release(self, joints: JointSelection, *, in_place: bool) -> None:
        """Return joints to the user: in place, or with a motion to the user's posture.

        Raises as :meth:`claim` does.
        """
        mask = joint_mask(joints, self._robot)
        if in_place:
            self.released_in_place = self.released_in_place | mask
        else:
            self.released_to_posture = self.released_to_posture | mask
