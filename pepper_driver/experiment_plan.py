"""Plans an experiment before anything moves: reflexes, postures on the way, pushes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.config import Experiment, MotionStep, RobotConfig, load_self_collision
from pepper_driver.config.experiment_steps import AnyPush, GrabInStep
from pepper_driver.config.lines import with_lines
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.robot import POSTURE_TOLERANCE
from pepper_driver.controller import RobotModel
from pepper_driver.controller.capsules import CapsuleDistances
from pepper_driver.motion_goals import Goal
from pepper_driver.pushing import Bounds, PushTooStrongError
from pepper_driver.scene import PlannedTouch
from pepper_driver.touch_planning import plan_stated

BOUNDS = Bounds(load=0.85, tipping=0.8)
"""Of pushes, as scenarios have them."""


@dataclass(frozen=True, kw_only=True)
class PlannedPushes:
    """What a simulated robot is pushed by.

    Attributes:
        at_begin: When the experiment begins.
        in_step: By number of the written step, each time it begins.
        skipped: Why they are left out; empty if they are not.
    """

    at_begin: tuple[PlannedTouch, ...] = ()
    in_step: dict[int, tuple[PlannedTouch, ...]]
    skipped: str = ""


def postures(
    experiment: Experiment, robot: RobotConfig, start: FloatArray | None = None
) -> Iterator[tuple[int, FloatArray]]:
    """Number of each written step as it is played, and (17,) where its joints shall be at its end [rad].

    Joints of which no step has said where they go are where they were at the ``start`` (17,), NaN without one. What
    tasks move counts as not moved.
    """
    n = len(robot.joint_names)
    target = np.full(n, np.nan) if start is None else start.copy()
    steps = experiment.motion.steps
    for number in experiment.order:
        step = steps[number]
        if step.posture is not None:
            target = robot.posture(step.posture)
        elif step.moves_joints:
            target = target.copy()
        for name, angle in {**step.joints, **step.hands}.items():
            target[robot.joint_index(name)] = angle
        yield number, target


@with_lines
def check_postures(
    experiment: Experiment, robot: RobotConfig, start: FloatArray | None = None
) -> None:
    """Refuse steps that send joints where they cannot be: beyond coupled limits, or into the robot itself.

    Args:
        experiment: Whose names and limits of single joints are checked already.
        robot: Its description.
        start: (17,) where the robot stands [rad]; None for unknown, then only what steps say is checked.

    Raises:
        ConfigError: The message names the step's key.
    """
    keys, steps = tuple(experiment.written), experiment.motion.steps
    collisions = _Collisions(robot)
    unknown = {
        number: np.any([Goal(task, robot).joints for _, task in step.tasks()], axis=0)
        for number, step in enumerate(steps)
        if any(True for _ in step.tasks())
    }
    seen: set[tuple[int, bytes]] = set()
    led = np.zeros(len(robot.joint_names), dtype=np.bool_)
    for number, target in postures(experiment, robot, start):
        step = steps[number]
        if step.posture is not None:
            led[:] = False
        for name in (*step.joints, *step.hands):
            led[robot.joint_index(name)] = False
        if number in unknown:
            led |= unknown[number]
        where = np.where(led, np.nan, target)
        if not step.moves_joints or (number, where.tobytes()) in seen:
            continue
        seen.add((number, where.tobytes()))
        problem = _beyond_coupled(where, robot) or collisions.problem(where)
        if problem:
            raise experiment.error(f"{keys[number]}.{_said_by(step)}", problem)


@with_lines
def plan_pushes(experiment: Experiment, robot: RobotConfig, backend: Backend) -> PlannedPushes:
    """The pushes of an experiment, for a robot at rest where the step leads when it is played first.

    Raises:
        ConfigError: A push that the robot could not take.
    """
    if not experiment.pushes:
        return PlannedPushes(in_step={})
    needed = {"push"} | ({"grab"} if _grabs(experiment) else set())
    if not needed <= backend.info.capabilities:
        return PlannedPushes(
            in_step={},
            skipped=f"pushes are left out: only a simulated robot can be pushed by software, and"
            f" '{backend.uri}' is none",
        )
    model = RobotModel(robot)
    targets = [target for _, target in postures(experiment, robot)]
    at_begin: list[PlannedTouch] = []
    in_step: dict[int, list[PlannedTouch]] = {}
    for number, push in enumerate(experiment.pushes):
        played = experiment.step_of(push)
        assert played is not None  # as checked
        beside = at_begin if push.step is None else in_step.setdefault(experiment.order[played], [])
        overlapping = [
            touch.planned
            for touch in beside
            if touch.delay < push.start + push.duration
            and push.start < touch.delay + touch.duration
        ]
        try:
            planned = plan_stated(
                model,
                robot,
                backend.plant,
                push,
                posture=targets[played],
                bounds=Bounds(load=BOUNDS.load, tipping=BOUNDS.tipping, saturating=push.saturating),
                beside=overlapping,
            )
        except PushTooStrongError as error:
            raise experiment.error(f"pushes.{number}", str(error)) from error
        beside.append(
            PlannedTouch(
                planned=planned,
                delay=push.start,
                duration=push.duration,
                moving=False,
                grab=push if isinstance(push, GrabInStep) else None,
            )
        )
    return PlannedPushes(
        at_begin=tuple(at_begin),
        in_step={number: tuple(touches) for number, touches in in_step.items()},
    )


def push_text(push: PlannedTouch) -> str:
    """A planned push, for people."""
    planned = push.planned
    how = "grabbed" if push.grab is not None else "pushed"
    felt = (
        ""
        if planned.joint is None
        else f", {planned.degrees:.1f} equivalent degrees on {planned.joint}"
    )
    return f"{how} with {planned.newtons:.1f} N for {push.duration:g} s{felt}"


def _grabs(experiment: Experiment) -> bool:
    pushes: tuple[AnyPush, ...] = experiment.pushes
    return any(isinstance(push, GrabInStep) for push in pushes)


def _said_by(step: MotionStep) -> str:
    """The key of a step that says where joints go."""
    return next(key for key in ("posture", "joints", "hands") if getattr(step, key))


def _beyond_coupled(target: FloatArray, robot: RobotConfig) -> str:
    """Which limit a posture breaks that depends on another joint; empty for none."""
    for limit in robot.limits.coupled:
        driver = float(target[robot.joint_index(limit.driver)])
        driven = float(target[robot.joint_index(limit.driven)])
        rows = np.array(limit.table)
        lower, upper = (float(np.interp(driver, rows[:, 0], rows[:, k])) for k in (1, 2))
        if driven < lower - POSTURE_TOLERANCE or driven > upper + POSTURE_TOLERANCE:  # NaN is not
            return (
                f"{limit.driven} at {driven:.3g} rad lies outside {lower:.3g} to {upper:.3g} rad, which are its limits"
                f" while {limit.driver} is at {driver:.3g} rad"
            )
    return ""


class _Collisions:
    """Which parts of the robot would touch in a posture."""

    def __init__(self, robot: RobotConfig) -> None:
        settings = load_self_collision(robot)
        self._model = RobotModel(robot)
        self._least = settings.security_distance
        self._capsules = CapsuleDistances(self._model, settings, margin=self._least)

    def problem(self, target: FloatArray) -> str:
        """The nearest pair of links, where it is too near; empty where none is, or a joint is not known."""
        model, capsules = self._model, self._capsules
        if not np.isfinite(target).all():
            return ""
        model.set_state(model.configuration(target), np.zeros(model.nv))
        model.update_kinematics()
        capsules.place(model.data)
        distances = capsules.distances()
        nearest = int(distances.argmin())
        if distances[nearest] >= self._least:
            return ""
        first, _, second = capsules.names[nearest].partition("-")
        how = (
            f"come within {1e3 * distances[nearest]:.0f} mm of one another"
            if distances[nearest] > 0
            else "run into one another"
        )
        return f"{first} and {second} would {how}; they must stay {1e3 * self._least:.0f} mm apart"
