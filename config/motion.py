"""Motions: what the robot does step by step, written in YAML and checked to the last name before anything moves."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, WrapValidator
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, named_file, parse, read_yaml, shipped_names
from pepper_driver.config.motion_tasks import (
    AnyTask,
    BaseSpec,
    BaseVelocitySpec,
    ComSpec,
    Label,
    LookAtSpec,
    Named,
    OrientationSpec,
    PoseSpec,
    PositionSpec,
)
from pepper_driver.config.parts import Positive, TaskStiffness
from pepper_driver.config.robot import RobotConfig

SHORTEST = 1e-3
"""[s] of a way: the least that tasks take."""

LONGEST = 3600.0
"""[s] of one step or hold."""

Duration = Annotated[float, Field(ge=SHORTEST, le=LONGEST)]
Pause = Annotated[float, Field(ge=0, le=LONGEST)]


def _one_or_more(cls: Any) -> WrapValidator:  # noqa: ANN401 a class, of which mypy makes no tuple[cls, ...]
    """One mapping, or a list of them, becomes a tuple; errors carry a number only where there is a list."""

    def build(value: object, _: object) -> object:
        if isinstance(value, tuple):
            if not all(isinstance(part, cls) for part in value):
                raise ValueError(f"takes {cls.__name__} only")
            return value
        # Through JSON, as in the loader: there strict mode takes lists for tuples.
        if isinstance(value, list):
            many = TypeAdapter(tuple[cls, ...])
            return many.validate_json(json.dumps(value), strict=True)
        return (TypeAdapter(cls).validate_json(json.dumps(value), strict=True),)

    return WrapValidator(build)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MotionStep:
    """What the robot does at one time; all parts of a step begin together.

    Attributes:
        name: For reports.
        duration: Everything gets to its target along a spline within this time [s]; without one, as fast as stiffness
            and limits allow.
        until: ``reached``: go on only when every task is within ``tolerance`` and at rest, or, in a step without
            tasks, every joint that it names.
        tolerance: [m] and [rad].
        timeout: Since the step began [s]; then the motion goes on without having reached.
        hold: Stay this long afterwards [s].
        posture, joints, hands: Posture by name; joints with angles [rad]; hands with apertures, 0 closed to 1 open.
            The latter win over the former; what is not named stays.
        stiffness: Of the posture task [1/s2], from here on.
        position, orientation, pose, look_at, com, base: Tasks, one or a list of each.
        base_velocity: Of the base while the step lasts.
    """

    name: Label | None = None
    duration: Duration | None = None
    until: Literal["reached"] | None = None
    tolerance: Positive | None = None
    timeout: Duration | None = None
    hold: Pause = 0.0
    posture: str | None = None
    joints: dict[str, float] = field(default_factory=dict)
    hands: dict[str, float] = field(default_factory=dict)
    stiffness: TaskStiffness | None = None
    position: Annotated[tuple[PositionSpec, ...], _one_or_more(PositionSpec)] = ()
    orientation: Annotated[tuple[OrientationSpec, ...], _one_or_more(OrientationSpec)] = ()
    pose: Annotated[tuple[PoseSpec, ...], _one_or_more(PoseSpec)] = ()
    look_at: LookAtSpec | None = None
    com: ComSpec | None = None
    base: BaseSpec | None = None
    base_velocity: BaseVelocitySpec | None = None

    def __post_init__(self) -> None:
        if self.duration is None and self.until is None and self.hold == 0.0:
            raise ValueError("a step takes time: give 'duration', 'until: reached' or 'hold'")
        if self.until is None and (self.tolerance is not None or self.timeout is not None):
            raise ValueError("'tolerance' and 'timeout' belong to 'until: reached'")
        if self.until is not None:
            if self.timeout is None:
                raise ValueError("'until: reached' needs a 'timeout' [s]")
            if self.duration is not None and self.timeout < self.duration:
                raise ValueError(
                    f"'timeout' {self.timeout:g} s ends before 'duration', {self.duration:g} s"
                )
            if not self.moves_joints and not any(True for _ in self.tasks()):
                raise ValueError("'until: reached' needs a task or a posture to reach")
        if self.base is not None and self.base_velocity is not None:
            raise ValueError("a step gives 'base' or 'base_velocity', not both")
        labels = [task.label for _, task in self.tasks()]
        for number, label in enumerate(labels):
            if label == "posture":
                raise ValueError("a task cannot be called 'posture', which is that of all joints")
            if label in labels[:number]:
                raise ValueError(f"two tasks are called '{label}'; give one another 'name'")

    @property
    def moves_joints(self) -> bool:
        """Whether it says where joints go, be it by a posture or by hands."""
        return self.posture is not None or bool(self.joints or self.hands)

    @property
    def longest(self) -> float:
        """It is over after this time at the latest [s], unless a reflex holds the robot."""
        return (self.timeout or self.duration or 0.0) + self.hold

    def tasks(self) -> Iterator[tuple[str, AnyTask]]:
        """All its tasks, each with its key."""
        for key in ("position", "orientation", "pose"):
            many = getattr(self, key)
            for number, task in enumerate(many):
                yield key if len(many) == 1 else f"{key}.{number}", task
        for key in ("look_at", "com", "base"):
            if (task := getattr(self, key)) is not None:
                yield key, task

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        if self.posture is not None:
            yield "posture", "posture", self.posture
        yield from ((f"joints.{joint}", "joint", joint) for joint in self.joints)
        yield from ((f"hands.{hand}", "hand", hand) for hand in self.hands)
        for key, task in self.tasks():
            if not isinstance(task, BaseSpec):
                yield from ((f"{key}.{inner}", kind, name) for inner, kind, name in task.names())


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Motion:
    """Steps one after the other, the whole ``repeat`` times; ``source`` is the file it came from, for messages."""

    schema: Literal[1]
    name: Label
    description: str = ""
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    steps: Annotated[tuple[MotionStep, ...], Field(min_length=1)]
    source: str = ""

    @property
    def longest(self) -> float:
        """It is over after this time at the latest [s], unless a reflex holds the robot."""
        return self.repeat * sum(step.longest for step in self.steps)


def motion_names() -> tuple[str, ...]:
    """Names of the motions shipped with the package."""
    return shipped_names("motions")


@with_lines
def load_motion(name: str | Path, robot: RobotConfig) -> Motion:
    """Load a motion by name, or from a path that ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped motion has this name.
        ConfigError: The file is wrong; the message names file, key and cure.
    """
    path = named_file("motion", name, "motions")
    source = str(path)
    motion = parse(Motion, {**read_yaml(path), "source": source}, source)
    check_motion(motion, robot)
    return motion


def check_motion(motion: Motion, robot: RobotConfig) -> None:
    """Refuse a motion that the robot cannot play.

    Raises:
        ConfigError: An unknown name, or a value beyond a limit of the robot; the message names the key.
    """
    for number, step in enumerate(motion.steps):
        check_step(step, robot, f"{motion.source or motion.name}: key 'steps.{number}")


def check_step(step: MotionStep, robot: RobotConfig, where: str) -> None:
    """Refuse a step that the robot cannot play; ``where`` is how the message begins, up to the step's key."""
    known = {
        "joint": robot.joint_names,
        "joint or chain": (*robot.chains, *robot.joint_names),
        "link": robot.links,
        "posture": tuple(robot.postures),
        "hand": robot.hands.joints,
    }
    for key, kind, name in step.names():
        if name not in known[kind]:
            raise ConfigError(
                f"{where}.{key}': unknown {kind} '{name}'{suggestion(name, known[kind])}"
            )
    for name, angle in step.joints.items():
        joint = robot.joints[robot.joint_index(name)]
        unit = "" if name in robot.hands.joints else " rad"
        _check_range(f"{where}.joints.{name}'", angle, joint.lower, joint.upper, unit)
    for name, aperture in step.hands.items():
        _check_range(f"{where}.hands.{name}'", aperture, 0.0, 1.0, "")
    if (twist := step.base_velocity) is not None:
        fastest, turn = robot.limits.base.linear_velocity, robot.limits.base.angular_velocity
        _check_range(f"{where}.base_velocity.vx'", twist.vx, -fastest, fastest, " m/s")
        _check_range(f"{where}.base_velocity.vy'", twist.vy, -fastest, fastest, " m/s")
        _check_range(f"{where}.base_velocity.wz'", twist.wz, -turn, turn, " rad/s")


def _check_range(where: str, value: float, lower: float, upper: float, unit: str) -> None:
    if not lower <= value <= upper:
        raise ConfigError(f"{where}: {value:g}{unit} lies outside {lower:g} to {upper:g}{unit}")
