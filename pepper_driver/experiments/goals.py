"""The tasks of steps, made before anything moves, and how near they came to their targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.task_specs import (
    LOOKING_LINK,
    AnyTask,
    BaseSpec,
    ComSpec,
    LookAtSpec,
    OrientationSpec,
    PoseSpec,
    PositionSpec,
    TaskSpec,
)
from pepper_driver.controller import (
    BasePoseTask,
    ComTask,
    FrameTask,
    LookAtTask,
    OrientationTask,
    PositionTask,
    RobotModel,
    WholeBodyController,
)
from pepper_driver.controller.tasks.task import TaskRows
from pepper_driver.experiments.reports import GoalDeviation
from pepper_driver.reflexes import Arbiter

Targeted = PositionTask | OrientationTask | FrameTask | LookAtTask | ComTask | BasePoseTask

NONE = slice(0, 0)
FIRST = slice(0, 3)


class Goal:
    """One task of a step with its target.

    Args:
        spec: As the motion has it.
        robot: Its description.

    Attributes:
        name: As the motion calls it.
        task: For the controller.
        keep: Whether it outlives its step.
        joints: (17,) which joints may move for it.

    Raises:
        PepperError: The robot has no such part.
    """

    def __init__(self, spec: AnyTask, robot: RobotConfig) -> None:
        self.name, self.keep = spec.label, spec.keep
        self._spec = spec
        self.task, self._twin = _make_task(spec, robot), _make_task(spec, robot)
        self._metres, self._radians = _units(spec)
        self._goal: FloatArray = np.zeros(0)  # known once it begins
        self.joints: BoolArray = np.zeros(len(robot.joint_names), dtype=np.bool_)
        if isinstance(spec, TaskSpec):
            moving = expand(spec, robot) or robot.joint_names
            self.joints[[robot.joint_index(name) for name in moving]] = True

    def begin(self, arbiter: Arbiter, duration: float | None) -> None:
        """Send the task to its target, in a time [s] or as fast as possible, and request it.

        Raises:
            TargetError: The task refuses its target, and stays out.
        """
        self._goal = _target(self._spec, arbiter.controller)
        if duration is None:
            self.task.target = self._goal
        else:
            self.task.move_to(self._goal, duration)
        arbiter.add(self.task)

    def go_on(self, duration: float) -> None:
        """Restart from the present state to the same target, in a new time [s]."""
        self.task.move_to(self._goal, duration)

    def miss(self) -> GoalDeviation:
        """Return the distance of the controller's own state from the target."""
        return self._miss(self.task.error)

    def measured_miss(self, model: RobotModel) -> GoalDeviation:
        """Return the distance of a robot from it in a model at its measured state, with its kinematics."""
        task, rows = self._twin, TaskRows.empty(self._twin.rows, model.nv)
        task.attach(model, rows)
        task.target = self._goal
        task.compute(model, rows)
        return self._miss(task.error)

    def _miss(self, error: FloatArray) -> GoalDeviation:
        offset, turn = error[self._metres], error[self._radians]
        return GoalDeviation(
            metres=float(np.linalg.norm(offset)) if len(offset) else None,
            radians=float(np.linalg.norm(turn)) if len(turn) else None,
        )


@dataclass(frozen=True, kw_only=True)
class PostureGoal:
    """Joints of a step: (17,) ``target`` [rad], and which of them the step ``named``."""

    target: FloatArray
    named: BoolArray

    def miss(self, position: FloatArray) -> GoalDeviation:
        """Return the distance of (17,) joints [rad] from it: the largest of those that the step named."""
        return GoalDeviation(radians=float(np.abs(position - self.target)[self.named].max()))

    def reached(self, controller: WholeBodyController, tolerance: float) -> bool:
        """Return True where the joints that the step named are within a tolerance [rad] and at rest."""
        rest = tolerance * max(np.sqrt(controller.posture.stiffness), 1.0)
        near = np.abs(controller.position - controller.dither.position - self.target) <= tolerance
        slow = np.abs(controller.velocity - controller.dither.velocity) <= rest
        return bool((near & slow)[self.named].all())


class MeasuredModel:
    """A model of the robot as it measures itself, apart from the controller's own."""

    def __init__(self, robot: RobotConfig) -> None:
        self._model = RobotModel(robot)

    def at(self, measurement: Measurement, controller: WholeBodyController) -> RobotModel:
        """Return the model at the measured joints, the base where the wheels have rolled to; at rest."""
        model = self._model
        q = model.configuration(measurement.position)
        model.set_state(model.with_base_pose(q, controller.odometry.pose), np.zeros(model.nv))
        model.update_kinematics()
        return model


def expand(spec: TaskSpec, robot: RobotConfig) -> tuple[str, ...] | None:
    """Return the joints that a task names, chains replaced by their joints; None for all."""
    if spec.joints is None:
        return None
    names = (joint for name in spec.joints for joint in robot.chains.get(name, (name,)))
    return tuple(dict.fromkeys(names))


def _make_task(spec: AnyTask, robot: RobotConfig) -> Targeted:
    task: Targeted
    if isinstance(spec, BaseSpec):
        task = BasePoseTask()
    else:
        common: dict[str, Any] = {
            "joints": expand(spec, robot),
            "base": spec.base,
            "name": spec.label,
            "robot": robot,
        }
        if isinstance(spec, LookAtSpec):
            task = LookAtTask(LOOKING_LINK, target_link=spec.link, **common)
        elif isinstance(spec, ComSpec):
            task = ComTask(root=spec.root, **common)
        elif isinstance(spec, OrientationSpec):
            task = OrientationTask(spec.link, root=spec.root, **common)
        else:
            kind = PositionTask if isinstance(spec, PositionSpec) else FrameTask
            task = kind(spec.link, spec.point, root=spec.root, **common)
    if spec.stiffness is not None:
        task.stiffness = spec.stiffness
    if spec.weight is not None:
        task.weight = spec.weight
    return task


def _target(spec: AnyTask, controller: WholeBodyController) -> FloatArray:
    """Return the target of the task; coordinates of the base that a motion leaves open keep their present values."""
    if isinstance(spec, BaseSpec):
        given = (spec.x, spec.y, spec.heading)
        now = controller.base_pose.tolist()
        return np.array([b if a is None else a for a, b in zip(given, now, strict=True)])
    if isinstance(spec, LookAtSpec):
        return np.array(spec.point or (0.0, 0.0, 0.0))  # of a link, its origin
    if isinstance(spec, OrientationSpec):
        return np.array(spec.quaternion)
    if isinstance(spec, PoseSpec):
        return np.array([*spec.position, *spec.quaternion])
    return np.array(spec.target)


def _units(spec: AnyTask) -> tuple[slice, slice]:
    """Return the rows of the error in metres, and those in radians."""
    if isinstance(spec, PositionSpec | ComSpec):
        return FIRST, NONE
    if isinstance(spec, PoseSpec):
        return FIRST, slice(3, 6)
    if isinstance(spec, BaseSpec):
        return slice(0, 2), slice(2, 3)
    return NONE, FIRST
