"""What reflexes may act on, and who of them gets what when several want the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.tasks import BaseVelocityTask, Task

BoolArray = NDArray[np.bool_]

OVER_ALL = 1e6
"""Weight of the task that brings the base to rest: nothing the user wants outweighs it."""

BRAKING = 400.0
"""[1/s2] Of that task: as fast as the acceleration limits allow."""


class Control:
    """Wishes of the reflexes, for one tick: a reflex that wants something still says so again in the next.

    Reflexes are asked in the order of their priority, and joints and base go to the first who claims them.

    Attributes:
        controller: Its state and model, to be read; what a reflex wants it to do goes through the methods here.
        posture: (17,) posture that a reflex wants in place of the user's [rad]; None to follow the user. While there
            is one, all other tasks stand still, the base comes to rest, and afterwards they go on.
        posture_stiffness: Stiffness of the posture task that a reflex wants [1/s2]; None to follow the user.
        stiffness: (17,) wanted stiffness of the motors 0..1; the safety gate ramps towards it.
        claimed: (17,) joints that a reflex has in this tick.
        left: (17,) joints that the user's posture shall find, from now on, where they come to rest.
        returned: (17,) joints that go back, from now on, to the user's posture.
    """

    def __init__(self, controller: WholeBodyController, robot: RobotConfig) -> None:
        self.controller = controller
        self._width = len(robot.joint_names)
        self._rest = BaseVelocityTask(
            stiffness=BRAKING, weight=OVER_ALL, name="reflex: base at rest"
        )
        self._tasks: dict[int, Task] = {}
        self._wanted: dict[int, Task] = {}
        self.begin()

    def begin(self) -> None:
        """Forget the wishes of the last tick."""
        self.posture: FloatArray | None = None
        self.posture_stiffness: float | None = None
        self.stiffness: FloatArray = np.ones(self._width)
        self.left: BoolArray = np.zeros(self._width, dtype=np.bool_)
        self.returned: BoolArray = np.zeros(self._width, dtype=np.bool_)
        self.claimed: BoolArray = np.zeros(self._width, dtype=np.bool_)
        self._base_claimed = False
        self._wanted = {}

    def claim(self, joints: BoolArray) -> bool:
        """Take joints, a mask (17,), for this tick: all of them, or, where one is taken already, none."""
        if np.count_nonzero(self.claimed & joints):
            return False
        self.claimed = self.claimed | joints
        return True

    def claim_base(self) -> bool:
        """Take the base for this tick, if nobody has."""
        free, self._base_claimed = not self._base_claimed, True
        return free

    def do(self, task: Task) -> None:
        """Have the controller follow a task in this tick, beside the user's."""
        self._wanted[id(task)] = task

    def soften(self, joints: BoolArray, stiffness: float) -> None:
        """Lower the stiffness of motors, a mask (17,), to 0..1; the lowest wish counts."""
        self.stiffness = np.where(joints, np.minimum(self.stiffness, stiffness), self.stiffness)

    def stop_base(self) -> None:
        """Bring the base to rest."""
        self.do(self._rest)

    def finish(self) -> None:
        """Give the controller the tasks that are wanted, and take back those that are no more."""
        if self._wanted.keys() == self._tasks.keys():
            return
        for key, task in self._tasks.items():
            if key not in self._wanted:
                self.controller.remove(task)
        for key, task in self._wanted.items():
            if key not in self._tasks:
                self.controller.add(task, enforce_limit=False)
        self._tasks = self._wanted
