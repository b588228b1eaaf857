"""Base class of tasks: error, Jacobian and bias, gains, targets.

The controller minimises the sum over tasks of weight * sum_i dim_weight_i * (J qdd + Jdot qd - a*)_i^2, with the
desired acceleration a* = stiffness * error + damping * (reference velocity - velocity) + reference acceleration. These
are the laws of the JRL task library; with a reference at rest it is the set-point law.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any
from weakref import ReferenceType

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.config import RobotConfig, suggestion
from pepper_driver.config.arguments import checked_arguments, is_number, real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ArgumentError, shown
from pepper_driver.config.parts import MAX_TASK_STIFFNESS
from pepper_driver.config.steps import MIN_DURATION
from pepper_driver.controller.changes import Change, Changes
from pepper_driver.controller.errors import GainError, ShapeError, TargetError
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.tasks.targets import Target, checked_joints, finite_vector
from pepper_driver.controller.trajectory import Trajectory

MAX_DAMPING = 120.0
"""[1/s] Above about 1.4 times this, the law is unstable with a cycle of 12 ms, as above the largest stiffness."""

MAX_WEIGHT = 1e12
"""Larger weights would leave no digit of the others in double precision."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Stiffness [1/s2], damping [1/s] and weights (rows,) of a task's rows."""

    stiffness: float
    damping: float
    weight: FloatArray


class GainsMixin:
    """Stiffness [1/s2], damping [1/s] and weights of a task, which change between two ticks.

    Damping follows the stiffness as 2 sqrt(stiffness), which is critical, unless it is set.

    Args:
        rows: Number of rows.
        stiffness: Gain of the error [1/s2].
        weight: Weight in the cost, against other tasks.

    Attributes:
        gains: Factors of the rows; another object whenever one of them was set.
        changes: Changes of the controller that has the task; None without a controller.
    """

    def __init__(self, rows: int, *, stiffness: float, weight: float) -> None:
        self.changes: Changes | None = None
        self._dim_weight = np.ones(rows)
        self._own_damping: float | None = None
        self._stiffness = checked_stiffness(stiffness)
        self._weight = _within("weight", weight, MAX_WEIGHT)
        self._update_gains()

    @property
    def stiffness(self) -> float:
        """Stiffness [1/s2]: gain of the error."""
        return self._stiffness

    @stiffness.setter
    def stiffness(self, value: float) -> None:
        stiffness = checked_stiffness(value)

        def change() -> None:
            self._allow(stiffness, self._own_damping)
            self._stiffness = stiffness
            self._update_gains()

        self.change(change)

    @property
    def damping(self) -> float:
        """Damping [1/s]: 2 sqrt(stiffness) unless set; after None it follows the stiffness again."""
        return self._damping

    @damping.setter
    def damping(self, value: float | None) -> None:
        damping = None if value is None else _within("damping", value, MAX_DAMPING)

        def change() -> None:
            self._allow(self._stiffness, damping)
            self._own_damping = damping
            self._update_gains()

        self.change(change)

    @property
    def weight(self) -> float:
        """Weight in the cost, against other tasks."""
        return self._weight

    @weight.setter
    def weight(self, value: float) -> None:
        weight = _within("weight", value, MAX_WEIGHT)

        def change() -> None:
            self._weight = weight
            self._update_gains()

        self.change(change)

    @property
    def dim_weight(self) -> FloatArray:
        """(rows,) weight of each row within the task, a copy; a row of weight 0 has no effect."""
        return self._dim_weight.copy()

    @dim_weight.setter
    def dim_weight(self, value: ArrayLike) -> None:
        rows = len(self._dim_weight)
        what = f"{rows} finite numbers that are not negative"
        weights = real_array(value, (rows,))
        if weights is None or not (np.isfinite(weights) & (weights >= 0)).all():
            raise GainError("dim_weight", value, what)

        def change() -> None:
            self._dim_weight = weights
            self._update_gains()

        self.change(change)

    def change(self, change: Change) -> None:
        """Make a change between two ticks, or at once if no controller has the task."""
        if self.changes is None:
            change()
        else:
            self.changes.make(change)

    def _allow(self, stiffness: float, damping: float | None) -> None:
        """Raise a GainError for gains that are invalid for this kind of task."""
        return

    def _update_gains(self) -> None:
        own = self._own_damping
        self._damping = 2.0 * sqrt(self._stiffness) if own is None else own
        self.gains = Gains(self._stiffness, self._damping, self._weight * self._dim_weight)


def checked_stiffness(value: float) -> float:
    """Return a stiffness [1/s2] as a float.

    Raises:
        GainError: Not a number from 0 to 3000.
    """
    return _within("stiffness", value, MAX_TASK_STIFFNESS)


def _within(name: str, value: float, largest: float) -> float:
    if not (is_number(value) and 0.0 <= value <= largest):  # False for NaN
        raise GainError(name, value, f"a number from 0 to {largest:g}")
    return float(value)


class Task(GainsMixin, ABC):
    """Rows of the cost with common gains. A task belongs to one controller at a time.

    While a controller has it, settings from any thread take effect between two ticks; see :class:`Changes`.

    Args:
        rows: Number of rows.
        stiffness: Gain of the error [1/s2].
        weight: Weight in the cost, against other tasks.
        name: Name in reports, by default that of the class.

    Attributes:
        name: Name in reports.
        rows: Number of rows.
        needs_kinematics: True if the controller must compute placements and Jacobians before :meth:`compute`.
        owner: Controller that has it.
        robot: Description that its joints and links belong to; None for a task without joints and links.
        moves_base: True if it may move the base: the controller's own base task then has less weight.
        up_to_date: True if the error is that of the present target: False from setting it to the next cycle.
        has_reference: True if there is a reference motion: :meth:`advance` and :meth:`add_feedforward` have an effect.
    """

    needs_kinematics = True
    robot: RobotConfig | None = None

    def __init__(
        self, rows: int, *, stiffness: float, weight: float, name: str | None = None
    ) -> None:
        super().__init__(rows, stiffness=stiffness, weight=weight)
        if not isinstance(name, str | None):
            raise ArgumentError(f"the name of a task is a text, got {shown(name)}")
        self.rows = rows
        self.name = name or type(self).__name__
        self.moves_base = False
        self.owner: ReferenceType[Any] | None = None
        self._moving: tuple[str, ...] | None = None
        self._with_base = True
        self._error, self._rate = np.full((2, rows), np.nan)
        self.has_reference = self.up_to_date = False
        self._reference_velocity: FloatArray | None = None
        self._reference_acceleration: FloatArray | None = None
        self._planned_motion: tuple[list[FloatArray], list[float]] | None = None
        self._trajectory: Trajectory | None = None

    # -- reference motion ---------------------------------------------------------------------------------------

    @property
    def reference_velocity(self) -> FloatArray:
        """(rows,) velocity of the reference motion, a copy. The target does not move by itself.

        Raises:
            TargetError: Not as many finite numbers; the previous velocity stays.
        """
        value = self._reference_velocity
        return np.zeros(self.rows) if value is None else value.copy()

    @reference_velocity.setter
    def reference_velocity(self, value: ArrayLike) -> None:
        velocity = finite_vector(f"the reference velocity of {self.name}", value, self.rows)

        def change() -> None:
            self._reference_velocity = velocity if velocity.any() else None
            self._update_has_reference()

        self.change(change)

    @property
    def reference_acceleration(self) -> FloatArray:
        """(rows,) acceleration of the reference motion, a copy.

        Raises:
            TargetError: Not as many finite numbers; the previous acceleration stays.
        """
        value = self._reference_acceleration
        return np.zeros(self.rows) if value is None else value.copy()

    @reference_acceleration.setter
    def reference_acceleration(self, value: ArrayLike) -> None:
        acceleration = finite_vector(f"the reference acceleration of {self.name}", value, self.rows)

        def change() -> None:
            self._reference_acceleration = acceleration if acceleration.any() else None
            self._update_has_reference()

        self.change(change)

    def _update_has_reference(self) -> None:
        self.has_reference = any(
            part is not None
            for part in (
                self._planned_motion,
                self._trajectory,
                self._reference_velocity,
                self._reference_acceleration,
            )
        )

    @property
    def under_way(self) -> bool:
        """True during a motion by :meth:`move_to` or :meth:`move_through`."""
        return self._planned_motion is not None or self._trajectory is not None

    @checked_arguments
    def move_to(self, target: Target, duration: float) -> None:
        """Go to a target in a given time [s], along a spline from the present motion to rest.

        Raises:
            TargetError: As for the target; or no duration above 0. The task continues as before.
        """
        self.move_through([target], [duration])

    @checked_arguments
    def move_through(self, targets: Sequence[Target], durations: Sequence[float]) -> None:
        """Go through targets without stopping, to each within its own time [s], along one quintic spline.

        Raises:
            TargetError: As for the target; no target; durations that are not as many numbers from a millisecond up;
                the task has no target to move to. The task continues as before.
        """
        if type(self)._plan is Task._plan:
            raise TargetError(f"{self.name} has no target to move to")
        if not isinstance(targets, Sequence | np.ndarray) or not len(targets):
            raise TargetError(f"{self.name} moves through one target or more, got {shown(targets)}")
        times = finite_vector(f"the durations of {self.name}", durations, len(targets))
        if not (times >= MIN_DURATION).all():
            raise TargetError(
                f"{self.name} takes durations from {MIN_DURATION} s up, got {times.tolist()}"
            )
        parts = [self._checked_part(target) for target in targets]

        def change() -> None:
            self._planned_motion = (self._completed(parts), times.tolist())
            self._update_has_reference()

        self.change(change)

    def _checked_part(self, target: Target) -> FloatArray:
        """Return a checked target; NaN for joints that it does not have."""
        return self.checked(target)

    def _completed(self, parts: list[FloatArray]) -> list[FloatArray]:
        """Return checked targets of one motion with their missing values, each from the target before it."""
        return parts

    def checked(self, target: Target) -> FloatArray:
        """Return the target as the task stores it; the task does not change.

        Raises:
            TargetError: Invalid target.
        """
        return finite_vector(f"the target of {self.name}", target, self.rows)

    def _set_target(self, target: FloatArray) -> None:
        """Set a target, checked and complete, and end the motion to the previous one."""

        def change() -> None:
            self._follow(target)
            self._stop_moving()

        self.change(change)

    def stop(self) -> None:
        """End a motion by :meth:`move_to`: the target stays where it is on its path."""
        self.change(self._stop_moving)

    def _stop_moving(self) -> None:
        """Remove the present motion with its reference velocity and acceleration."""
        self.up_to_date = False
        if self.under_way:
            self._planned_motion = self._trajectory = None
            self._set_reference(None, None)
            self._update_has_reference()

    def advance(self, model: RobotModel, dt: float) -> None:
        """Advance the reference motion by one cycle [s]; the controller calls it before :meth:`compute`.

        Args:
            model: Model at the state of the controller, with kinematics for tasks that need them.
            dt: Cycle [s].
        """
        if self._planned_motion is not None:
            # In this order, so that `under_way` stays True for other threads in between.
            self._trajectory = self._plan(model, *self._planned_motion, dt)
            self._planned_motion = None
        if self._trajectory is not None:
            target, velocity, acceleration = self._trajectory.next()
            self._follow(target)
            if self._trajectory.over:
                self._trajectory = None
                self._set_reference(None, None)
                self._update_has_reference()
            else:
                self._set_reference(velocity, acceleration)

    def _plan(
        self, model: RobotModel, targets: list[FloatArray], durations: list[float], dt: float
    ) -> Trajectory:
        """Return a trajectory from the state of the model through the targets. For tasks with such motions."""
        raise NotImplementedError

    def _follow(self, target: FloatArray) -> None:
        """Set a target of a trajectory, without checks."""
        raise NotImplementedError

    def _set_reference(self, velocity: FloatArray | None, acceleration: FloatArray | None) -> None:
        """Set velocity and acceleration of the target on its trajectory; None at rest."""
        self._reference_velocity, self._reference_acceleration = velocity, acceleration

    # -- use ----------------------------------------------------------------------------------------------------

    @property
    def error(self) -> FloatArray:
        """(rows,) target minus value in the last cycle, in the unit of the task; NaN before the first."""
        return self._error.copy()

    @checked_arguments
    def reached(self, tolerance: ArrayLike) -> bool:
        """Return True if every row with weight, at least one, is within a tolerance of its target and at rest.

        At rest means that the velocity is below tolerance * sqrt(stiffness), or the tolerance per second if that is
        more: the remaining motion is then shorter than the tolerance. A motion by :meth:`move_to` must have ended, and
        one cycle must have passed since the target was set.

        Args:
            tolerance: One number or (rows,), in the unit of the task.

        Raises:
            TargetError: Not a number above 0, or not as many.
        """
        limit = self._tolerance(tolerance)
        if not self.up_to_date or self.under_way:
            return False
        near = np.abs(self._error) <= limit
        slow = np.abs(self._relative_rate()) <= limit * max(sqrt(self._stiffness), 1.0)
        asked = self._dim_weight > 0
        return bool(asked.any() and (near & slow)[asked].all())

    def _relative_rate(self) -> FloatArray:
        """Return the (rows,) velocity that is zero at rest on the target."""
        return self._rate

    def _tolerance(self, value: ArrayLike) -> FloatArray:
        tolerance = real_array(value, (), (self.rows,))
        if tolerance is None or not (tolerance > 0).all():
            raise TargetError(
                f"{self.name} takes one tolerance or {self.rows}, above 0, got {shown(value)}"
            )
        return tolerance

    # -- rows ---------------------------------------------------------------------------------------------------

    def select(self, robot: RobotConfig, joints: Sequence[str] | None, *, base: bool) -> None:
        """Select the joints, and the base or not, that the task may move; before it is added.

        Raises:
            UnknownNameError: No such joint.
            TargetError: No list of names, or an empty one without the base.
        """
        base_alone = base and isinstance(joints, Sequence) and not joints
        self._moving = () if base_alone else checked_joints(robot, joints)
        self._with_base = self.moves_base = base
        self.robot = robot

    def joint_mask(self, model: RobotModel) -> FloatArray:
        """Return (20,) 1 for velocities that the task may move, 0 for the others."""
        columns = np.zeros(model.nv)
        columns[:BASE] = self._with_base
        names = model.robot.joint_names if self._moving is None else self._moving
        columns[[model.joint_columns[model.robot.joint_index(name)] for name in names]] = 1.0
        return columns

    def attach(self, model: RobotModel, rows: TaskRows) -> None:
        """Prepare the rows when the controller allocates them, before the first :meth:`compute`.

        Rows are zero at first and keep their values: write constant entries here.
        """
        rows.error[:], rows.rate[:] = self._error, self._rate
        self._error, self._rate = rows.error, rows.rate

    @abstractmethod
    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        """Evaluate the task at the model's state: assign ``rows.error``, ``rows.jacobian`` and ``rows.bias``.

        Called in every cycle, with the same ``rows`` as :meth:`attach`.
        """

    def add_feedforward(self, rows: TaskRows) -> None:
        """Add the reference motion to ``rows.requested``, which has the feedback already."""
        velocity, acceleration = self._reference_velocity, self._reference_acceleration
        requested = rows.requested
        if velocity is not None:
            requested += self._damping * velocity
        if acceleration is not None:
            requested += acceleration


class TaskRows:
    """Rows of a task in the QP: views of the arrays of all tasks. An assignment to a field copies values into it.

    ``rows.jacobian = J``, ``rows.jacobian[:] = J`` and ``rows.jacobian[0, 3] = 1.0`` all have an effect. Columns are
    those of ``RobotModel.v``.

    Attributes:
        jacobian: (rows, 20) matrix whose product with the velocity is the rate of the value.
        error: (rows,) target minus value.
        bias: (rows,) Jdot qd: acceleration of the value without accelerations of the robot.
        rate: (rows,) J qd; the controller computes it after :meth:`Task.compute`.
        requested: (rows,) requested accelerations a* - Jdot qd; the controller computes them.

    Raises:
        ShapeError: An assigned value of another shape, or without numbers.
    """

    __slots__ = ("bias", "error", "jacobian", "rate", "requested")

    jacobian: FloatArray
    error: FloatArray
    bias: FloatArray
    rate: FloatArray
    requested: FloatArray

    def __init__(
        self,
        jacobian: FloatArray,
        error: FloatArray,
        rate: FloatArray,
        bias: FloatArray,
        requested: FloatArray,
    ) -> None:
        # The own __setattr__ copies into arrays, which do not exist yet.
        keep = super().__setattr__
        keep("jacobian", jacobian)
        keep("error", error)
        keep("rate", rate)
        keep("bias", bias)
        keep("requested", requested)

    @classmethod
    def empty(cls, rows: int, columns: int) -> TaskRows:
        """Return rows of a single task, all zero."""
        return cls(np.zeros((rows, columns)), *np.zeros((4, rows)))

    def __setattr__(self, name: str, value: ArrayLike) -> None:
        if name not in self.__slots__:
            raise AttributeError(
                f"rows of a task have no '{name}'{suggestion(name, self.__slots__)}"
            )
        array: FloatArray = getattr(self, name)
        if value is array:  # after an operator in place
            return
        try:
            numbers = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ShapeError(f"rows.{name}", array.shape, type(value).__name__) from None
        if numbers.shape != array.shape:
            raise ShapeError(f"rows.{name}", array.shape, numbers.shape)
        array[...] = numbers
