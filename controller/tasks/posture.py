"""Posture: joints go to given angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, UnknownNameError, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray, IndexArray
from pepper_driver.controller.dither import Superposition
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.targets import Target, checked_joints, finite_vector
from pepper_driver.controller.tasks.task import Task, TaskRows
from pepper_driver.controller.trajectory import Trajectory, vector_trajectory

TOLERANCE = 1e-6
"""[rad] A target may lie this far beyond a limit: what rounding does to a limit itself."""


@checked_arguments
class PostureTask(Task):
    """Joints as critically damped springs about a reference motion.

    qdd* = reference acceleration + damping (reference velocity - qd) + stiffness (target - q).

    Args:
        joints: Which, in the order of the target; by default all 17 in the robot's order.
        stiffness: [1/s2]. At 0 the damping is 0 too: joints then keep their speed unless ``damping`` is set.
        weight: In the cost.
        name: For reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such joint.
        TargetError: Not a list of joints, each once.
    """

    needs_kinematics = False

    def __init__(
        self,
        joints: Sequence[str] | None = None,
        *,
        stiffness: float = 5.0,
        weight: float = 10.0,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        self.joints = checked_joints(robot, joints) or robot.joint_names
        indices = np.array([robot.joint_index(joint) for joint in self.joints], dtype=np.intp)
        if len(set(self.joints)) != len(self.joints):
            raise TargetError(f"a posture takes joints, each once, got {list(self.joints)}")
        label = "posture" if joints is None else f"posture {', '.join(self.joints)}"
        super().__init__(len(indices), stiffness=stiffness, weight=weight, name=name or label)
        self.robot = robot
        self._indices: slice | IndexArray = slice(None) if joints is None else indices
        self._lower, self._upper = robot.lower[indices], robot.upper[indices]
        self._target = (self._lower + self._upper) / 2
        self._superposed: Superposition | None = None

    @property
    def target(self) -> FloatArray:
        """(joints,) angles to go to [rad], a copy; setting them checks them.

        Joints by name with their angles [rad] are taken too; the others keep theirs.

        Raises:
            TargetError: Not as many finite numbers, or outside a joint's limits; the old target stays.
            UnknownNameError: No such joint in the task; the old target stays.
        """
        return self._target.copy()

    @target.setter
    def target(self, value: ArrayLike | Mapping[str, float]) -> None:
        part = self._checked_part(value)

        def change() -> None:
            self._follow(self._completed([part])[0])
            self._stop_moving()

        self.change(change)

    def checked(self, target: Target) -> FloatArray:
        """(joints,) the angles that ``target`` means [rad]; the task's target stays. Raises as :attr:`target` does."""
        return self._completed([self._checked_part(target)])[0]

    def _completed(self, parts: list[FloatArray]) -> list[FloatArray]:
        postures = [self._target]
        for part in parts:
            posture = np.where(np.isnan(part), postures[-1], part)
            # A rest posture that is not known yet completes nothing.
            postures.append(finite_vector("a posture", posture, self.rows, names=self.joints))
        return postures[1:]

    def _checked_part(self, target: Target) -> FloatArray:
        if isinstance(target, Mapping):
            for name in target:
                if name not in self.joints:
                    raise UnknownNameError("joint", name, self.joints)
            names = tuple(target)
            angles = finite_vector("a posture", list(target.values()), len(names), names=names)
            posture = np.full(self.rows, np.nan)
            posture[[self.joints.index(name) for name in names]] = angles
        else:
            posture = finite_vector("a posture", target, self.rows, names=self.joints)
        outside = (posture < self._lower - TOLERANCE) | (posture > self._upper + TOLERANCE)
        if outside.any():
            index = int(np.argmax(outside))
            joint, angle = self.joints[index], float(posture[index])
            lower, upper = float(self._lower[index]), float(self._upper[index])
            raise TargetError(
                f"{joint} cannot go to {angle:.4g} rad:"
                f" its limits are {lower:.4g} to {upper:.4g} rad",
                joint=joint,
                value=angle,
                lower=lower,
                upper=upper,
            )
        inside: FloatArray = np.clip(posture, self._lower, self._upper)
        return inside

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """One row a joint."""
        super().attach(model, rows)
        rows.jacobian[np.arange(self.rows), model.joint_columns[self._indices]] = 1.0

    def superpose(self, motion: Superposition | None) -> None:
        """Add a motion of all joints of the robot to targets and reference motion for one cycle; None for none."""
        self._superposed = motion
        self._update_driven()

    def _update_driven(self) -> None:
        super()._update_driven()
        self.driven = self.driven or self._superposed is not None

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """The error is target minus position [rad]; a superposed motion is part of the target."""
        np.subtract(self._target, model.joint_position[self._indices], rows.error)
        if self._superposed is not None:
            rows.error += self._superposed.position[self._indices]

    def add_feedforward(self, rows: TaskRows) -> None:
        """Add what the reference motion and the superposed one ask for."""
        super().add_feedforward(rows)
        if self._superposed is not None:
            rows.wanted += self._damping * self._superposed.velocity[self._indices]
            rows.wanted += self._superposed.acceleration[self._indices]

    def _relative_rate(self) -> FloatArray:
        if self._superposed is None:
            return self._rate
        return self._rate - self._superposed.velocity[self._indices]

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        start = model.joint_position[self._indices]
        velocity = model.joint_velocity[self._indices].copy()
        if self._superposed is not None:  # which goes on meanwhile
            start = start - self._superposed.position[self._indices]
            velocity -= self._superposed.velocity[self._indices]
        return vector_trajectory(np.array([start, *targets]), velocity, durations, dt)

    def _follow(self, target: FloatArray) -> None:
        self._target = target
