"""The whole-body controller: one quadratic program a cycle gives accelerations, integration gives the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import Measurement
from pepper_driver.config import ControllerSettings, RobotConfig, load_controller_settings
from pepper_driver.controller.constraints import AccelerationBox, Constraint
from pepper_driver.controller.model import BASE, RobotModel
from pepper_driver.controller.reference import Reference
from pepper_driver.controller.solvers import make_solver
from pepper_driver.controller.solvers.solver import Status
from pepper_driver.controller.tasks import BaseVelocityTask, PostureTask, Task
from pepper_driver.controller.tasks.task import finite_vector

FloatArray = NDArray[np.float64]

LEAST_COST = 1e-4
"""Of the largest diagonal entry of the cost: an acceleration that tasks care less for is regularised as this one."""

REST_RATE = 4.0
"""[1/s] How fast a movement that no task asks for dies out. Regularised, not wanted: any task outweighs it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ControllerStatus:
    """How the last cycle went.

    Attributes:
        solver: Whether the QP was solved; otherwise the controller braked.
        at_limit: Joints at a bound of their acceleration box.
        unmet: Names of the constraints that the accelerations break: those that braking could not keep.
        relaxed: Limits of the box that could not be kept, as ``"LHand acceleration"``: one that matters more prevailed,
            or the joint was beyond it.
    """

    solver: Status
    at_limit: tuple[str, ...]
    unmet: tuple[str, ...]
    relaxed: tuple[str, ...]


class WholeBodyController:
    """Acceleration-resolved, weighted multi-objective QP on the 3 base and 17 joint degrees of freedom.

    In each cycle the tasks' costs are minimised over the accelerations inside the box of limits and the rows of the
    constraints; the accelerations are integrated, q+ = q + v dt + a dt^2 / 2 and v+ = v + a dt. The state is the
    controller's own: no measurement enters it, so that the tracking error keeps the whole effect of a touch (the
    paper's controller runs in the same way).

    Args:
        robot: Its description.
        settings: Gains, limits, solver; by default those of ``controller.yaml``.
        dt: Cycle [s], by default the robot's.

    Raises:
        UnknownNameError: No such solver.
    """

    def __init__(
        self,
        robot: RobotConfig,
        settings: ControllerSettings | None = None,
        *,
        dt: float | None = None,
    ) -> None:
        settings = settings or load_controller_settings(robot)
        self._robot = robot
        self._dt = dt if dt is not None else robot.cycle
        self.model = RobotModel(robot)
        self._box = AccelerationBox(robot, settings, self.model, self._dt)
        self._solver = make_solver(settings.solver)
        self._share = settings.regularisation
        self._hessian = np.zeros((self.model.nv, self.model.nv))
        self._gradient = np.zeros(self.model.nv)
        self.posture = PostureTask(
            robot, stiffness=settings.posture.stiffness, weight=settings.posture.weight
        )
        self.base_velocity = BaseVelocityTask(
            stiffness=settings.base.stiffness, weight=settings.base.weight
        )
        self._tasks: list[Task] = [self.posture, self.base_velocity]
        self._constraints: list[Constraint] = []
        self._allocate()
        self.reset((robot.lower + robot.upper) / 2)

    # -- tasks and constraints ----------------------------------------------------------------------------------

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks in use."""
        return tuple(self._tasks)

    def add(self, part: Task | Constraint) -> None:
        """Take a task or a constraint into the QP from the next cycle on; one already there stays once."""
        if isinstance(part, Task) and part not in self._tasks:
            self._tasks.append(part)
        elif isinstance(part, Constraint) and part not in self._constraints:
            self._constraints.append(part)
        self._allocate()

    def remove(self, part: Task | Constraint) -> None:
        """Take a task or a constraint out of the QP; one that is not there is no error."""
        self._tasks = [task for task in self._tasks if task is not part]
        self._constraints = [
            constraint for constraint in self._constraints if constraint is not part
        ]
        self._allocate()

    # -- state --------------------------------------------------------------------------------------------------

    def reset(self, position: FloatArray) -> None:
        """Stand still at (17,) joint positions [rad], the base at the origin; both own tasks want to stay there.

        Raises:
            TargetError: Not 17 finite numbers; nothing changes.
        """
        self.posture.target = np.clip(position, self._robot.lower, self._robot.upper)
        self.posture.velocity = self.posture.acceleration = np.zeros(len(position))
        self.base_velocity.target = np.zeros(BASE)
        self._q = self.model.configuration(position)
        self._v = np.zeros(self.model.nv)
        self._before = position.copy()
        self._status: Status = "solved"
        self._acceleration = np.zeros(self.model.nv)
        self.model.set_state(self._q, self._v)
        self._box.update(self.model)

    @property
    def position(self) -> FloatArray:
        """(17,) integrated joint positions [rad], a copy."""
        self.model.set_state(self._q, self._v)
        return self.model.joint_position

    @property
    def velocity(self) -> FloatArray:
        """(17,) integrated joint velocities [rad/s], a copy."""
        self.model.set_state(self._q, self._v)
        return self.model.joint_velocity

    @property
    def lower(self) -> FloatArray:
        """(17,) lower position limits of the robot [rad]."""
        return self._robot.lower

    @property
    def upper(self) -> FloatArray:
        """(17,) upper position limits of the robot [rad]."""
        return self._robot.upper

    @property
    def status(self) -> ControllerStatus:
        """How the last cycle went."""
        box, a = self._box, self._acceleration
        met = (a <= box.lower + 1e-9) | (a >= box.upper - 1e-9)
        joints = met[self.model.joint_columns]
        names = tuple(n for n, at in zip(self._robot.joint_names, joints, strict=True) if at)
        return ControllerStatus(
            solver=self._status, at_limit=names, unmet=self._unmet(), relaxed=box.relaxed()
        )

    def accept(self, position: FloatArray) -> None:
        """Go on from a command that the safety gate changed.

        The integrated joint positions become what was sent, the velocities of the joints concerned those that lead
        there from the position before, within the velocity limits.

        Args:
            position: (17,) as really sent [rad].

        Raises:
            TargetError: Not 17 finite numbers; nothing changes.
        """
        position = finite_vector("a sent position", position, len(self._before))
        self.model.set_state(self._q, self._v)
        changed = position != self.model.joint_position
        limit = self._box.joint_velocity_limit
        speed = np.clip((position - self._before) / self._dt, -limit, limit)
        columns = self.model.joint_columns
        self._v[columns] = np.where(changed, speed, self._v[columns])
        self._q = self.model.with_joint_position(self._q, position)
        self.model.set_state(self._q, self._v)

    # -- one cycle ----------------------------------------------------------------------------------------------

    def step(self, measurement: Measurement | None = None) -> Reference:
        """Solve and integrate one cycle.

        Never raises for what tasks want: a problem without solution brakes to rest within the limits.

        Args:
            measurement: What the robot measured; tasks of later versions may use it, the integration does not.

        Returns:
            Position, velocity, acceleration and load torque at the end of the cycle, all of that one instant.
        """
        model, dt = self.model, self._dt
        model.set_state(self._q, self._v)
        self._before = model.joint_position
        if self._needs_kinematics:
            model.update_kinematics()
        acceleration = self._solve()
        self._acceleration = acceleration
        self._q = model.integrate(self._q, (self._v + acceleration * (dt / 2)) * dt)
        self._v = self._v + acceleration * dt
        model.set_state(self._q, self._v)
        return Reference(
            position=model.joint_position,
            velocity=model.joint_velocity,
            acceleration=acceleration[model.joint_columns],
            load_torque=model.load_torque(self._q, self._v, acceleration),
            base_twist=self._v[:BASE].copy(),
        )

    def _unmet(self) -> tuple[str, ...]:
        """Names of the constraints that the accelerations of the last cycle break."""
        broken = self._matrix @ self._acceleration > self._bound + 1e-6
        names, start = [], 0
        for constraint in self._constraints:
            if broken[start : start + constraint.rows].any():
                names.append(constraint.name)
            start += constraint.rows
        return tuple(names)

    def _allocate(self) -> None:
        """Room for the rows of all tasks and constraints."""
        nv = self.model.nv
        rows = sum(task.rows for task in self._tasks)
        bounds = sum(constraint.rows for constraint in self._constraints)
        self._jacobian, self._wanted = np.zeros((rows, nv)), np.zeros(rows)
        self._scale, self._weighted = np.zeros((rows, 1)), np.zeros((rows, nv))
        self._matrix, self._bound = np.zeros((bounds, nv)), np.zeros(bounds)
        parts: list[Task | Constraint] = [*self._tasks, *self._constraints]
        self._needs_kinematics = any(part.needs_kinematics for part in parts)

    def _solve(self) -> FloatArray:
        """(20,) accelerations."""
        model, dt = self.model, self._dt
        start = 0
        for task in self._tasks:
            rows = slice(start, start + task.rows)
            task.write(model, self._jacobian[rows], self._wanted[rows])
            np.multiply(task.weight, task.dim_weight, out=self._scale[rows, 0])
            start += task.rows
        start = 0
        for constraint in self._constraints:
            rows = slice(start, start + constraint.rows)
            constraint.write(model, dt, self._matrix[rows], self._bound[rows])
            start += constraint.rows
        self._box.update(model)
        lower, upper = self._box.lower, self._box.upper
        H, g, weighted = self._hessian, self._gradient, self._weighted
        np.multiply(self._jacobian, self._scale, out=weighted)
        np.dot(weighted.T, self._jacobian, out=H)
        np.dot(self._wanted, weighted, out=g)
        diagonal = H.ravel()[:: model.nv + 1]
        regularisation = self._regularisation(diagonal)
        diagonal += regularisation
        regularisation *= REST_RATE * self._v
        np.negative(g, out=g)
        g += regularisation
        solution = self._solver.solve(H, g, lower, upper, self._matrix, self._bound)
        self._status = solution.status
        if solution.status == "solved":
            return solution.x
        braking: FloatArray = np.minimum(np.maximum(-self._v / dt, lower), upper)
        return braking

    def _regularisation(self, cost: FloatArray) -> FloatArray:
        """(20,) to be added to the diagonal of the cost, a share of it: the unit of the weights cancels out."""
        least = LEAST_COST * float(cost.max())
        return self._share * (np.maximum(cost, least) if least > 0 else np.ones_like(cost))
