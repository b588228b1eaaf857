"""Compliance: joints give way to a torque, as if they had a small inertia and some friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arguments import checked_arguments, real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.errors import GainError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.posture import PostureTask
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.tasks.task import TaskRows

HOLD = 0.1
"""[s] How long a torque acts that is not renewed: a reflex that stops must not leave the robot drifting."""

SLIP = 1e-9
"""[s] What sums of cycles may be off by."""


@checked_arguments
class ComplianceTask(PostureTask):
    """Joints follow an external torque: qdd* = torque / inertia - damping qd + stiffness (rest - q).

    The torque is an estimate that a reflex writes to :attr:`torque` in every cycle. Its dead band is subtracted, so
    that nothing jumps at the edge; what is left is clipped. A torque that is not renewed for 0.1 s ends: the joints
    come to rest. Held, they end at a speed of torque / (inertia damping). Without stiffness, joints stay where they
    were led to; with it they return to :attr:`target`, the rest posture: by default where they were at first use.

    The posture task pulls too. Between two tasks the higher weight decides: at the default one, joints follow this
    task to a part in a thousand of the posture's pull of weight 10, enough to lead them but not to keep them for
    minutes (they creep back with a time constant of damping weight / (the posture's stiffness and weight): 20 min).
    Give the joints ``dim_weight`` 0 in the posture task to have none of it.

    Args:
        joints: Which, in the order of torque and target; by default all 17 in the robot's order.
        inertia: That the joints seem to have [kg m2], one number or one a joint.
        stiffness: Towards the rest posture [1/s2].
        damping: [1/s], also without stiffness; None for the critical one.
        dead_band: Torque that moves nothing [N m], one number or one a joint: above what the estimate is off by.
        largest_torque: Beyond the dead band [N m], one number or one a joint; by default half the joints' effort.
        weight: In the cost.
        name: For reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such joint.
        GainError: A number that is negative or not finite; an inertia or largest torque of 0; neither stiffness nor
            damping.
    """

    def __init__(
        self,
        joints: Sequence[str] | None = None,
        *,
        inertia: ArrayLike = 0.1,
        stiffness: float = 0.0,
        damping: float | None = 5.0,
        dead_band: ArrayLike = 0.3,
        largest_torque: ArrayLike | None = None,
        weight: float = 1e4,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        super().__init__(joints, stiffness=stiffness, weight=weight, name=name, robot=robot)
        if name is None:
            self.name = "compliance" if joints is None else f"compliance {', '.join(self.joints)}"
        self.damping = damping
        if largest_torque is None:
            largest_torque = [0.5 * robot.joints[robot.joint_index(j)].effort for j in self.joints]
        self._inertia = self._each("inertia", inertia, above_zero=True)
        self._dead_band = self._each("dead_band", dead_band)
        self._largest = self._each("largest_torque", largest_torque, above_zero=True)
        self._torque, self._left = np.zeros(self.rows), 0.0
        self._push: FloatArray | None = None
        self._target = np.full(self.rows, np.nan)
        self._rest_known = False

    def _each(self, name: str, value: ArrayLike, *, above_zero: bool = False) -> FloatArray:
        """(joints,) one number for all or one a joint."""
        what = f"one or {self.rows} finite numbers {'above' if above_zero else 'not below'} 0"
        numbers = real_array(value)
        if numbers is None:
            raise GainError(name, value, what)
        good = np.isfinite(numbers) & ((numbers > 0) if above_zero else (numbers >= 0))
        if numbers.shape not in ((), (self.rows,)) or not good.all():
            raise GainError(name, value, what)
        return np.full(self.rows, numbers)

    def _allow(self, stiffness: float, damping: float | None) -> None:
        if stiffness == 0.0 and not damping:
            raise GainError("damping", damping, "above 0 where there is no stiffness")

    @property
    def torque(self) -> FloatArray:
        """(joints,) external torque to follow [N m], a copy, as last set; zero once it was not renewed for 0.1 s.

        Raises:
            TargetError: Not as many finite numbers; the old torque stays for the rest of its time.
        """
        return self._torque.copy()

    @torque.setter
    def torque(self, value: ArrayLike) -> None:
        torque = finite_vector("an external torque", value, self.rows, names=self.joints)
        beyond = np.maximum(np.abs(torque) - self._dead_band, 0.0)
        push = np.copysign(np.minimum(beyond, self._largest), torque) / self._inertia

        def change() -> None:
            self._torque, self._left = torque, HOLD
            self._push = push if torque.any() else None
            self._update_driven()

        self.change(change)

    def _update_driven(self) -> None:
        super()._update_driven()
        self.driven = self.driven or self._push is not None

    def _follow(self, target: FloatArray) -> None:
        super()._follow(target)
        self._rest_known = True

    def advance(self, model: RobotModel, dt: float) -> None:
        """Let the torque grow old, and a motion of the rest posture go on."""
        super().advance(model, dt)
        self._left -= dt
        if self._left < -SLIP and self._push is not None:
            self._torque, self._push = np.zeros(self.rows), None
            self._update_driven()

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """The error is rest posture minus position [rad]."""
        if not self._rest_known:
            self._follow(np.clip(model.joint_position[self._indices], self._lower, self._upper))
        super().compute(model, rows)

    def add_feedforward(self, rows: TaskRows) -> None:
        """Add the torque's acceleration to that of the reference motion."""
        super().add_feedforward(rows)
        if self._push is not None:
            rows.wanted += self._push
