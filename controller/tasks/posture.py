"""Tasks of joints: posture, aperture of a hand, compliance with an external torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, UnknownNameError, load_robot
from pepper_driver.config.arguments import checked_arguments, real_array
from pepper_driver.config.arrays import FloatArray, IndexArray
from pepper_driver.config.errors import check_name
from pepper_driver.controller.errors import GainError, TargetError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tasks.targets import Target, checked_joints, finite_vector
from pepper_driver.controller.tasks.task import Task, TaskRows
from pepper_driver.controller.trajectory import Trajectory, vector_trajectory

LIMIT_TOLERANCE = 1e-6
"""[rad] A target may lie this far beyond a limit: rounding changes limits by as much."""


@checked_arguments
class PostureTask(Task):
    """Angles of joints, by a critically damped PD law about a reference motion.

    qdd* = reference acceleration + damping (reference velocity - qd) + stiffness (target - q).

    Args:
        joints: Joints in the order of the target; by default all 17 in the order of the robot.
        stiffness: [1/s2]. At 0 the damping is 0 too: joints then keep their speed unless ``damping`` is set.
        weight: Weight in the cost.
        name: Name in reports.
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

    @property
    def target(self) -> FloatArray:
        """(joints,) target angles [rad], a copy; they are checked when they are set.

        A dictionary of joints with their angles [rad] is accepted too; the other joints keep their targets.

        Raises:
            TargetError: Not as many finite numbers, or outside a joint's limits; the previous target stays.
            UnknownNameError: No such joint in the task; the previous target stays.
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
        """Return the (joints,) angles of a target [rad]; that of the task stays. Raises as :attr:`target` does."""
        return self._completed([self._checked_part(target)])[0]

    def _completed(self, parts: list[FloatArray]) -> list[FloatArray]:
        postures = [self._target]
        for part in parts:
            posture = np.where(np.isnan(part), postures[-1], part)
            # The rest posture of a compliance task is NaN until its first use, and cannot complete a target.
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
        outside = (posture < self._lower - LIMIT_TOLERANCE) | (
            posture > self._upper + LIMIT_TOLERANCE
        )
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
        # The tolerance is for rounding only: the target itself must be within its limits.
        inside: FloatArray = np.clip(posture, self._lower, self._upper)
        return inside

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Write one row per joint."""
        super().attach(model, rows)
        rows.jacobian[np.arange(self.rows), model.joint_columns[self._indices]] = 1.0

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the error: target minus position [rad]."""
        np.subtract(self._target, model.joint_position[self._indices], rows.error)

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        start = model.joint_position[self._indices]
        velocity = model.joint_velocity[self._indices].copy()
        return vector_trajectory(np.array([start, *targets]), velocity, durations, dt)

    def _follow(self, target: FloatArray) -> None:
        self._target = target


@checked_arguments
class HandTask(PostureTask):
    """Aperture of a hand, 0 closed to 1 open.

    Its weight is above that of the posture task, so that the hand follows this task.

    Args:
        hand: ``LHand`` or ``RHand``.
        stiffness: [1/s2].
        weight: Weight in the cost.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such hand.
    """

    def __init__(
        self,
        hand: str,
        *,
        stiffness: float = 20.0,
        weight: float = 1e3,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        check_name("hand", hand, robot.hands.joints)
        super().__init__(
            (hand,), stiffness=stiffness, weight=weight, name=f"hand {hand}", robot=robot
        )

    def checked(self, target: Target) -> FloatArray:
        """Return the (1,) aperture of an array or a number."""
        return super().checked(target)

    def _checked_part(self, target: Target) -> FloatArray:
        hand = self.joints[0]
        if isinstance(target, Mapping):
            return super()._checked_part(target)
        single = isinstance(target, Real) or (isinstance(target, np.ndarray) and target.ndim == 0)
        aperture: Any = [target] if single else target
        value = finite_vector(f"the aperture of {hand}", aperture, 1)
        if not 0.0 <= value[0] <= 1.0:
            raise TargetError(
                f"{hand} cannot open to {value[0]:.4g}: 0 is closed, 1 is open",
                joint=hand,
                value=float(value[0]),
                lower=0.0,
                upper=1.0,
            )
        return value


TORQUE_HOLD_TIME = 0.1
"""[s] For which a torque acts without being set again: a reflex that fails must not leave the robot drifting."""

TIME_ROUNDING = 1e-9
"""[s] Rounding error of sums of cycles."""


@checked_arguments
class ComplianceTask(PostureTask):
    """Joints follow an external torque: qdd* = torque / inertia - damping qd + stiffness (rest - q).

    The torque is an estimate that a reflex writes to :attr:`torque` in every cycle. A dead band is subtracted from it,
    without a jump at its edge; the rest is clipped. A torque that is not set again for 0.1 s ends: the joints come to
    rest. A constant torque leads to a speed of torque / (inertia damping). Without stiffness, joints stay where they
    were moved to. With it they return to :attr:`target`, the rest posture: by default that of the first use.

    The posture task acts on the joints too. The weights of two tasks decide: at the default weight, the posture of
    weight 10 has an effect of a part in a thousand. A person can move the joints, but they return slowly. The
    time constant is damping weight / (stiffness and weight of the posture): 20 min. ``dim_weight`` 0 of these joints
    in the posture task prevents it.

    Args:
        joints: Joints in the order of torque and target; by default all 17 in the order of the robot.
        inertia: Apparent inertia of the joints [kg m2], one number or one per joint.
        stiffness: Towards the rest posture [1/s2].
        damping: [1/s], also without stiffness; None for the critical one.
        dead_band: Torque without effect [N m], one number or one per joint: above the error of the estimate.
        max_torque: Largest torque beyond the dead band [N m], one number or one per joint; by default half the effort
            of the joints.
        weight: Weight in the cost.
        name: Name in reports.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such joint.
        GainError: A number that is negative or not finite; an inertia or largest torque of 0; stiffness and damping
            both 0.
    """

    def __init__(
        self,
        joints: Sequence[str] | None = None,
        *,
        inertia: ArrayLike = 0.1,
        stiffness: float = 0.0,
        damping: float | None = 5.0,
        dead_band: ArrayLike = 0.3,
        max_torque: ArrayLike | None = None,
        weight: float = 1e4,
        name: str | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        super().__init__(joints, stiffness=stiffness, weight=weight, name=name, robot=robot)
        if name is None:
            self.name = "compliance" if joints is None else f"compliance {', '.join(self.joints)}"
        self.damping = damping
        if max_torque is None:
            max_torque = [0.5 * robot.joints[robot.joint_index(j)].effort for j in self.joints]
        self._inertia = self._each("inertia", inertia, above_zero=True)
        self._dead_band = self._each("dead_band", dead_band)
        self._max_torque = self._each("max_torque", max_torque, above_zero=True)
        self._torque, self._torque_time = np.zeros(self.rows), 0.0
        self._push: FloatArray | None = None
        self._target = np.full(self.rows, np.nan)
        self._rest_known = False

    def _each(self, name: str, value: ArrayLike, *, above_zero: bool = False) -> FloatArray:
        """Return (joints,) numbers from one number for all or one per joint."""
        what = f"one or {self.rows} finite numbers {'above' if above_zero else 'not below'} 0"
        numbers = real_array(value, (), (self.rows,))
        if numbers is None or not np.isfinite(numbers).all():
            raise GainError(name, value, what)
        if not (numbers > 0 if above_zero else numbers >= 0).all():
            raise GainError(name, value, what)
        return np.full(self.rows, numbers)

    def _allow(self, stiffness: float, damping: float | None) -> None:
        if stiffness == 0.0 and not damping:
            raise GainError("damping", damping, "above 0 where there is no stiffness")

    @property
    def torque(self) -> FloatArray:
        """(joints,) external torque to follow [N m], a copy; zero when it was not set again for 0.1 s.

        Raises:
            TargetError: Not as many finite numbers; the previous torque stays for the rest of its time.
        """
        return self._torque.copy()

    @torque.setter
    def torque(self, value: ArrayLike) -> None:
        torque = finite_vector("an external torque", value, self.rows, names=self.joints)
        beyond = np.maximum(np.abs(torque) - self._dead_band, 0.0)
        push = np.copysign(np.minimum(beyond, self._max_torque), torque) / self._inertia

        def change() -> None:
            self._torque, self._torque_time = torque, TORQUE_HOLD_TIME
            self._push = push if torque.any() else None
            self._update_has_reference()

        self.change(change)

    def _update_has_reference(self) -> None:
        super()._update_has_reference()
        self.has_reference = self.has_reference or self._push is not None

    def _follow(self, target: FloatArray) -> None:
        super()._follow(target)
        self._rest_known = True

    def advance(self, model: RobotModel, dt: float) -> None:
        """Advance the age of the torque and a motion of the rest posture."""
        super().advance(model, dt)
        self._torque_time -= dt
        if self._torque_time < -TIME_ROUNDING and self._push is not None:
            self._torque, self._push = np.zeros(self.rows), None
            self._update_has_reference()

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Compute the error: rest posture minus position [rad]."""
        if not self._rest_known:
            self._follow(np.clip(model.joint_position[self._indices], self._lower, self._upper))
        super().compute(model, rows)

    def add_feedforward(self, rows: TaskRows) -> None:
        """Add the torque's acceleration to that of the reference motion."""
        super().add_feedforward(rows)
        if self._push is not None:
            rows.requested += self._push
