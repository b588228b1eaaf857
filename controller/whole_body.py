"""Whole-body controller: one quadratic program per cycle gives accelerations, integration gives the reference."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.fields import Measurement
from pepper_driver.config import ControllerSettings, RobotConfig, load_controller_settings
from pepper_driver.config.arguments import checked_arguments, is_number
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import shown
from pepper_driver.config.kernels import Out, kernel
from pepper_driver.controller.changes import Changes
from pepper_driver.controller.constraints import (
    AccelerationBox,
    BrakingLimits,
    Constraint,
    LinearInequality,
    standard_constraints,
)
from pepper_driver.controller.constraints.constraint import RowCheck
from pepper_driver.controller.dither import Dither, Superposition
from pepper_driver.controller.errors import (
    GainError,
    PartError,
    RobotMismatchError,
    TaskCountError,
)
from pepper_driver.controller.model import BASE, LoadTorque, RobotModel
from pepper_driver.controller.odometry import Feedback, Odometry
from pepper_driver.controller.qp import QpResult, QpStatus, QuadraticProgram
from pepper_driver.controller.report import ControllerStatus, TaskReport, explain
from pepper_driver.controller.solvers import make_solver
from pepper_driver.controller.tasks import BaseVelocityTask, PostureTask, Task
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.tick import Reference
from pepper_driver.controller.trajectory import load_splines

BASE_HOLD_STIFFNESS = 400.0
"""[1/s2] Stiffness of the base while it is held: it brakes as fast as its acceleration limits allow."""

MAX_TASKS = 64
"""Largest number of tasks in use, with the two own ones: of the most expensive kind they take 2.4 ms of a cycle."""

VIOLATION_TOLERANCE = 1e-6
"""[rad/s2] Violation up to which a row counts as satisfied."""


@kernel
def _advance(
    velocity: FloatArray,
    acceleration: FloatArray,
    dt: float,
    displacement: Out[FloatArray],
    after: Out[FloatArray],
) -> None:
    """Write the displacement v dt + a dt^2 / 2 of a cycle, and the velocity after it, v + a dt."""
    for i in range(len(velocity)):
        change = acceleration[i] * dt
        displacement[i] = (velocity[i] + change * 0.5) * dt
        after[i] = velocity[i] + change


@checked_arguments
class WholeBodyController:
    """Acceleration-resolved, weighted multi-objective QP on the 3 base and 17 joint degrees of freedom.

    In each cycle the costs of the tasks are minimised over the accelerations within their bounds and the rows of the
    constraints. The accelerations are integrated, q+ = q + v dt + a dt^2 / 2 and v+ = v + a dt. With ``feedback: none``
    no measurement enters the state of the controller. The tracking error then keeps the whole effect of a touch, as in
    the paper. With ``feedback: joints`` tasks and constraints are evaluated at the smoothed measured position, and the
    accelerations are still integrated on the controller's own state.

    Args:
        robot: Its description.
        settings: Gains, limits, solver; by default those of ``controller.yaml``.
        dt: Cycle [s], by default the robot's.
        changes: Changes of other threads between two ticks, by default of its own.

    Attributes:
        changes: Changes by :meth:`add`, :meth:`remove` and the setters of tasks in use.
        model: Model at the state of the last cycle.
        posture: Posture task that exists from the start.
        base_velocity: Base velocity task that exists from the start; its target is zero. While a task in use moves the
            base, its weight is a hundredth, unless its target is a motion.
        odometry: Pose of the base from its wheels.
        return_speed: Largest speed of joints that a reflex has released [rad/s].
        min_return_time: Smallest time of their return [s].
        dither: Small oscillation that is added to the motion of all tasks; off at the start.
        hold: True if only the posture task acts and the base comes to rest. All other tasks pause meanwhile.

    Raises:
        UnknownNameError: No such solver.
        GainError: A cycle that is not a time above 0.
    """

    def __init__(
        self,
        robot: RobotConfig,
        settings: ControllerSettings | None = None,
        *,
        dt: float | None = None,
        changes: Changes | None = None,
    ) -> None:
        settings = settings or load_controller_settings(robot)
        self._robot = robot
        self.changes = Changes() if changes is None else changes
        self._dt = robot.cycle if dt is None else _checked_cycle(dt)
        self._jerk_limited = settings.jerk_limit is not None
        self.model = RobotModel(robot)
        self._displacement = np.zeros(self.model.nv)
        self._advance, self._row_check = _advance.load(), RowCheck(self.model.nv)
        load_splines()
        self.return_speed, self.min_return_time = settings.return_speed, settings.min_return_time
        self._box = AccelerationBox(robot, settings, self.model, self._dt)
        self._braking_limits = BrakingLimits(self._box.acceleration_limit, self._dt)
        self._solver = make_solver(settings.solver)
        self._program = QuadraticProgram(self.model.nv, settings.regularisation, settings.rest_rate)
        self.odometry = Odometry(robot)
        self.dither = Dither(robot, settings.attentive, self._dt, margin=settings.position_margin)
        self._feedback: Feedback | None = None
        if settings.feedback == "joints":
            fraction = min(1.0, self._dt / settings.feedback_time)
            self._feedback = Feedback(self.model, self.odometry, fraction)
        self.posture = PostureTask(
            stiffness=settings.posture.stiffness, weight=settings.posture.weight, robot=robot
        )
        self.base_velocity = BaseVelocityTask(
            stiffness=settings.base.stiffness, weight=settings.base.weight
        )
        self._base_hold = BaseVelocityTask(
            stiffness=BASE_HOLD_STIFFNESS, weight=settings.base.weight, name="base at rest"
        )
        self._tasks: list[Task] = []
        self._constraints: list[Constraint] = []
        self.add(self.posture)
        self.add(self.base_velocity)
        self._constraints = standard_constraints(robot, settings)
        self.hold = False
        self._allocated = False
        self.reset((robot.lower + robot.upper) / 2)

    # -- tasks and constraints ----------------------------------------------------------------------------------

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks in use."""
        return tuple(self._tasks)

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints in use, without the limits of single joints."""
        return tuple(self._constraints)

    def add(self, part: Task | Constraint, *, enforce_limit: bool = True) -> None:
        """Add a task or a constraint to the QP from the next cycle on; one that is in use already stays once.

        A task that another controller has is removed from that one. The call is allowed from any thread.

        Args:
            part: The task or constraint.
            enforce_limit: False for a task that must act in spite of the largest number of tasks, as of a reflex.

        Raises:
            PartError: It is neither a task nor a constraint.
            RobotMismatchError: The task was made for a robot with other joints or links.
            TaskCountError: :data:`MAX_TASKS` are in use.
        """
        check_part(part, self._robot)
        if isinstance(part, Task):
            task = part
            self.changes.make(lambda: self._add_task(task, enforce_limit))
        else:
            constraint = part
            self.changes.make(lambda: self._add_constraint(constraint))

    def _add_task(self, task: Task, enforce_limit: bool) -> None:
        others = self._without(task)
        if enforce_limit and len(others) >= MAX_TASKS:
            raise TaskCountError(task.name, MAX_TASKS)
        owner = task.owner() if task.owner is not None else None
        if owner is not None and owner is not self:
            owner.remove(task)
        task.owner, task.changes = weakref.ref(self), self.changes
        self._tasks = [*others, task]
        self._allocated = False

    def _add_constraint(self, constraint: Constraint) -> None:
        others = [other for other in self._constraints if other is not constraint]
        self._constraints = [*others, constraint]
        self._allocated = False

    def remove(self, part: Task | Constraint) -> None:
        """Remove a task or a constraint from the QP; one that is not in use is no error.

        A motion of the task by ``move_to`` ends. From another thread, the part acts until the next tick.
        """
        self.changes.make(lambda: self._remove(part))

    def _remove(self, part: Task | Constraint) -> None:
        if isinstance(part, Task) and part in self._tasks:
            part.stop()
            part.owner = part.changes = None
        self._tasks = self._without(part)
        self._constraints = [
            constraint for constraint in self._constraints if constraint is not part
        ]
        self._allocated = False

    def _without(self, part: Task | Constraint) -> list[Task]:
        return [task for task in self._tasks if task is not part]

    # -- state --------------------------------------------------------------------------------------------------

    def reset(self, position: ArrayLike) -> None:
        """Set the state to rest at (17,) joint positions [rad], base at the origin; both own tasks have it as target.

        Raises:
            TargetError: Not 17 finite numbers; nothing changes.
        """
        position = finite_vector("a posture", position, len(self._robot.joint_names))
        with self.changes.tick():
            self._reset(position)

    def _reset(self, position: FloatArray) -> None:
        robot = self._robot
        self.posture.target = np.clip(position, robot.lower, robot.upper)
        self.posture.reference_velocity = np.zeros(len(position))
        self.posture.reference_acceleration = np.zeros(len(position))
        self.base_velocity.target = np.zeros(BASE)
        for task in self._tasks:
            task.stop()
        self.odometry.reset()
        self.dither.reset()
        self._q = self._before = self.model.configuration(position)
        self._v = np.zeros(self.model.nv)
        self._acceleration = np.zeros(self.model.nv)
        if self._feedback is not None:
            self._feedback.reset()
        self._outcome: QpStatus = "solved"
        self._active: list[tuple[Constraint, LinearInequality]] = []
        self.model.set_state(self._q, self._v)
        self._box.update(self._q, self._v, self._acceleration)

    @property
    def position(self) -> FloatArray:
        """(17,) integrated joint positions [rad], a copy."""
        return self.model.joints_of_configuration(self._q).copy()

    @property
    def velocity(self) -> FloatArray:
        """(17,) integrated joint velocities [rad/s], a copy."""
        return self.model.joints_of(self._v).copy()

    @property
    def base_pose(self) -> FloatArray:
        """(3,) integrated x [m], y [m], heading [rad] of the base since the last reset."""
        return self.model.base_pose(self._q)

    @property
    def lower(self) -> FloatArray:
        """(17,) lower position limits of the robot [rad]."""
        return self._robot.lower

    @property
    def upper(self) -> FloatArray:
        """(17,) upper position limits of the robot [rad]."""
        return self._robot.upper

    def stopping_position(self, stiffness: float, *, dither: bool = True) -> FloatArray:
        """Return (17,) positions [rad] in which joints come to rest without reversal, by tasks of a given stiffness.

        A critically damped joint at q with velocity v decays exponentially towards q + v / sqrt(stiffness).

        Args:
            stiffness: Stiffness of the tasks [1/s2].
            dither: False for joints that continue to oscillate about that position.
        """
        position, velocity = self.position, self.velocity
        if not dither:
            position, velocity = position - self.dither.position, velocity - self.dither.velocity
        rest: FloatArray = position + velocity / sqrt(stiffness)
        return np.clip(rest, self.lower, self.upper)

    def override_state(self, position: ArrayLike, base_twist: ArrayLike | None = None) -> None:
        """Continue from a command that the safety gate altered.

        The integrated joint positions become those that were sent. The velocities of the altered joints become those
        that lead there from the previous position, within the velocity limits. The base continues with the twist that
        was sent, from the pose to which it led.

        Args:
            position: (17,) as sent [rad].
            base_twist: (3,) as sent, vx [m/s], vy [m/s], wz [rad/s]; None if it was not altered.

        Raises:
            TargetError: Not 17, or not 3, finite numbers; nothing changes.
        """
        model = self.model
        position = finite_vector("a sent position", position, len(self._robot.joint_names))
        twist = None if base_twist is None else finite_vector("a sent twist", base_twist, BASE)
        changed = position != model.joints_of_configuration(self._q)
        limit = self._box.joint_velocity_limit
        before = model.joints_of_configuration(self._before)
        speed = np.clip((position - before) / self._dt, -limit, limit)
        v = self._v.copy()
        columns = model.joint_columns
        v[columns] = np.where(changed, speed, v[columns])
        q = self._q
        if twist is not None:
            v[:BASE] = twist
            displacement = np.zeros(model.nv)
            displacement[:BASE] = twist * self._dt
            q = model.integrate(self._before, displacement)
        self._q, self._v = model.with_joint_position(q, position), v
        model.set_state(self._q, self._v)

    # -- one cycle ----------------------------------------------------------------------------------------------

    def step(
        self, measurement: Measurement | None = None, answered: FloatArray | None = None
    ) -> Reference:
        """Solve and integrate one cycle.

        It never raises because of tasks or constraints. Rows that exclude each other are relaxed in the order of their
        priorities. Without a solution the robot brakes to rest within the limits.

        Args:
            measurement: Measurement of the robot, for odometry, and for tasks with ``feedback: joints``.
            answered: (17,) positions of the command that this measurement answers [rad]; by default the last ones.

        Returns:
            Position, velocity, acceleration and load torque at the end of the cycle, all at that instant.
        """
        with self.changes.tick():
            return self._step(measurement, answered)

    def _step(self, measurement: Measurement | None, answered: FloatArray | None) -> Reference:
        model, dt, q, v = self.model, self._dt, self._q, self._v
        self._before = q
        model.set_state(q, v)
        if measurement is not None:
            self.odometry.update(measurement.wheel_speed, dt)
            if self._feedback is not None:
                model.set_state(self._feedback.configuration(q, measurement, answered), v)
        superposed = None
        if self.dither.active:
            superposed = self.dither.step(model.joints_of_configuration(q) - self.dither.position)
        acceleration = self._solve(q, v, superposed)
        self._acceleration = acceleration
        velocity = np.empty_like(v)
        self._advance(v, acceleration, dt, self._displacement, velocity)
        self._q = q = model.integrate(q, self._displacement)
        self._v = v = velocity
        model.set_state(q, v)
        return Reference(
            position=model.joint_position,
            velocity=model.joint_velocity,
            acceleration=model.joints_of(acceleration),
            load_torque=model.load_torque(q, v, acceleration),
            base_twist=v[:BASE],
        )

    def _solve(self, q: FloatArray, v: FloatArray, superposed: Superposition | None) -> FloatArray:
        """Return (20,) accelerations."""
        model, program, box = self.model, self._program, self._box
        if not self._allocated or self.hold is not self._holding:
            self._allocate()
        if superposed is None:
            self._assemble()
        else:
            # Tasks are evaluated as if there were no oscillation, limits with it.
            seen = model.q, model.v
            model.set_state(*self._still(superposed))
            self._assemble()
            program.superpose(model.of_joints(superposed.acceleration))
            model.set_state(*seen)
        if self._constraints_need_kinematics:
            model.update_kinematics()
        box.update(q, v, self._acceleration)
        self._active = []
        waiting = self._lazy
        self._activate(self._eager)
        result = self._optimise(q, v)
        # Rows of lazy constraints are added when the accelerations violate them, and all others are checked again: a
        # solution with more rows may violate a constraint that the previous one satisfied.
        while waiting and result.outcome in ("solved", "relaxed"):
            a = result.acceleration
            broken = [c for c in waiting if not c.is_satisfied(model, self._braking_limits, a)]
            if not broken:
                break
            waiting = [c for c in waiting if c not in broken]
            if self._activate(broken):
                result = self._optimise(q, v)
        self._outcome = result.outcome
        if result.outcome in ("solved", "relaxed"):
            return result.acceleration
        braking: FloatArray = np.minimum(np.maximum(-v / self._dt, box.lower), box.upper)
        return braking

    def _assemble(self) -> None:
        """Form the cost at the state of the model."""
        if self._tasks_need_kinematics:
            self.model.update_kinematics()
        self._program.assemble(self.model, self._dt)

    def _still(self, superposed: Superposition) -> tuple[FloatArray, FloatArray]:
        """Return configuration and velocity of the model without a motion that is superposed."""
        model = self.model
        q = model.with_joint_position(model.q, model.joint_position - superposed.position)
        return q, model.v - model.of_joints(superposed.velocity)

    def _activate(self, constraints: Sequence[Constraint]) -> bool:
        """Add the rows of constraints; return True if there are any."""
        before = len(self._active)
        for constraint in constraints:
            rows = constraint.compute_inequality(self.model, self._braking_limits)
            if rows is None:
                continue
            plain = self._row_check.plain(rows)
            if plain is None:
                # The row of NaN makes the status name the faulty constraint; an error would end the tick.
                nothing = np.zeros((1, self.model.nv))
                plain = LinearInequality(nothing, np.array([np.nan]), (constraint.name,))
            self._active.append((constraint, plain))
        return len(self._active) > before

    def _optimise(self, q: FloatArray, v: FloatArray) -> QpResult:
        """Solve with the present rows."""
        box, program = self._box, self._program
        active = self._active
        groups = [(constraint.priority, rows) for constraint, rows in active] if active else ()
        result = program.solve(self._solver, box.lower, box.upper, groups)
        if result.outcome != "solved" and self._jerk_limited:
            # Joints that may not brake at once can violate limits that they share, which matter more than jerk.
            box.update(q, v, self._acceleration, jerk=False)
            result = program.solve(self._solver, box.lower, box.upper, groups)
        return result

    def _allocate(self) -> None:
        """Allocate rows for all tasks that act."""
        self._allocated, self._holding = True, self.hold
        own = (self.posture, self._base_hold)
        tasks: Sequence[Task] = own if self._holding else self._tasks
        self.base_velocity.relax(any(task.moves_base for task in tasks))
        self._program.allocate(tasks, self.model)
        self._lazy = [constraint for constraint in self._constraints if constraint.lazy]
        self._eager = [constraint for constraint in self._constraints if not constraint.lazy]
        self._tasks_need_kinematics = any(task.needs_kinematics for task in tasks)
        self._constraints_need_kinematics = any(c.needs_kinematics for c in self._constraints)

    # -- status -------------------------------------------------------------------------------------------------

    @property
    def status(self) -> ControllerStatus:
        """Status of the last cycle."""
        active: list[str] = []
        violated: list[str] = []
        for _, rows in self._active:
            for name, excess in zip(rows.names, self._excess(rows).tolist(), strict=True):
                if not excess <= VIOLATION_TOLERANCE:  # also for NaN
                    violated.append(name)
                elif excess >= -VIOLATION_TOLERANCE:
                    active.append(name)
        return ControllerStatus(
            solver=self._outcome,
            at_limit=self._box.binding(self._acceleration),
            active=tuple(dict.fromkeys(active)),
            violated=tuple(dict.fromkeys(violated)),
            relaxed=self._box.relaxed(self._acceleration),
        )

    def report(self) -> tuple[TaskReport, ...]:
        """Return the cost of every task in the last cycle, the most expensive first."""
        acceleration_errors = self._program.acceleration_errors(self._acceleration)
        total_cost = sum(cost for _, _, cost in acceleration_errors)
        reports = [
            TaskReport(
                name=task.name,
                error=task.error,
                acceleration_error=acceleration_error,
                cost=cost,
                cost_fraction=cost / total_cost if total_cost > 0 else 0.0,
            )
            for task, acceleration_error, cost in acceleration_errors
        ]
        return tuple(sorted(reports, key=lambda report: -report.cost))

    def explain(self) -> str:
        """Describe in a few lines which limits act on the motion."""
        return explain(self.status, self.report())

    def load_torque_parts(self) -> LoadTorque:
        """Return the parts of the load torque of the last reference, at its state: the end of the cycle."""
        return self.model.load_torque_parts(self._q, self._v, self._acceleration)

    def _excess(self, rows: LinearInequality) -> FloatArray:
        """Return the violation of each row by the accelerations, in units of its largest entry."""
        size = np.abs(rows.matrix).max(axis=1, initial=0.0)
        size[size <= 0.0] = 1.0
        excess: FloatArray = (rows.matrix @ self._acceleration - rows.bound) / size
        return excess


def check_part(part: Task | Constraint, robot: RobotConfig) -> None:
    """Check that a part can be added to the controller of a robot.

    Raises:
        PartError: It is neither a task nor a constraint.
        RobotMismatchError: The task was made for a robot with other joints or links.
    """
    if not isinstance(part, Task | Constraint):
        raise PartError(f"add takes a task or a constraint, got {shown(part)}")
    made_for = part.robot if isinstance(part, Task) else None
    if made_for is None or made_for is robot:
        return
    if (made_for.joint_names, made_for.links) != (robot.joint_names, robot.links):
        names = {*made_for.joint_names, *made_for.links} ^ {*robot.joint_names, *robot.links}
        raise RobotMismatchError(part.name, made_for.name, robot.name, sorted(names))


def _checked_cycle(dt: float) -> float:
    if not (is_number(dt) and 0.0 < dt < np.inf):
        raise GainError("dt", dt, "a cycle in seconds above 0")
    return float(dt)
