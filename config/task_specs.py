"""Kinds of task a step can give the controller. Places in [m], angles in [rad]; x forward, y left, z up.

The world is where base_link was when the robot was activated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT
from pepper_driver.config.parts import Positive, TaskStiffness

MAX_DISTANCE = 100.0
"""[m] No place in a motion may be farther off."""

UNIT = 1e-3
"""How far the norm of a quaternion or the axes of a rotation matrix may be from 1: rounding, not a mistake."""

LOOKING_LINK = "Head"
"""Its x axis is the line of sight."""

Metres = Annotated[float, Field(ge=-MAX_DISTANCE, le=MAX_DISTANCE)]
Heading = Annotated[float, Field(ge=-math.tau, le=math.tau)]
# \P{Cc}, no control character, is known to the regular expressions of pydantic, but not to Python's `re`.
Label = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^\P{Cc}+$")]
Place = tuple[Metres, Metres, Metres]
Quaternion = tuple[float, float, float, float]

NamedKind = Literal["joint", "joint or chain", "link", "posture", "hand"]
Named = tuple[str, NamedKind, str]
"""A name that the robot must know: key where it stands, what it names, the name."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TaskSpec:
    """Common fields of the tasks of a step.

    Attributes:
        name: By default the kind, and the link where there is one. Takes the place of a kept task of that name.
        joints: Joints or chains that may move for it; by default all joints.
        base: Whether the base may move for it too.
        stiffness: [1/s2]; None for the usual one of its kind.
        weight: In the cost; None for the usual one of its kind.
        keep: Act on after the step, until the motion ends or a later step gives a task of that name.
    """

    name: Label | None = None
    joints: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    base: bool = False
    stiffness: TaskStiffness | None = None
    weight: Positive | None = None
    keep: bool = False

    @property
    def label(self) -> str:
        """Its name, or what it is called without one."""
        return self.name or self.usual_name

    @property
    def usual_name(self) -> str:
        """Default name of the task."""
        raise NotImplementedError

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield from (("joints", "joint or chain", name) for name in self.joints or ())


@dataclass(frozen=True, kw_only=True, config=STRICT)
class FrameSpec(TaskSpec):
    """``link``, with targets in the link ``root``; None for the world."""

    link: str
    root: str | None = None

    def __post_init__(self) -> None:
        if self.root == self.link:
            raise ValueError(f"'root': {self.link} cannot be the root of its own target")

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield from super().names()
        yield "link", "link", self.link
        if self.root is not None:
            yield "root", "link", self.root


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PositionSpec(FrameSpec):
    """``point`` in the link moves to ``target``."""

    target: Place
    point: Place | None = None

    @property
    def usual_name(self) -> str:
        """Kind and link."""
        return f"position {self.link}"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class OrientationSpec(FrameSpec):
    """The link takes an orientation, a unit quaternion (x, y, z, w)."""

    quaternion: Quaternion

    def __post_init__(self) -> None:
        super().__post_init__()
        check_quaternion(self.quaternion)

    @property
    def usual_name(self) -> str:
        """Kind and link."""
        return f"orientation {self.link}"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PoseSpec(FrameSpec):
    """A frame at ``point`` in the link moves to ``position`` and an orientation (x, y, z, w)."""

    position: Place
    quaternion: Quaternion
    point: Place | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_quaternion(self.quaternion)

    @property
    def usual_name(self) -> str:
        """Kind and link."""
        return f"pose {self.link}"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class LookAtSpec(TaskSpec):
    """The head looks at ``point`` in the world, or at ``link``, which may move; by default with the head's joints."""

    joints: Annotated[tuple[str, ...], Field(min_length=1)] | None = ("head",)
    point: Place | None = None
    link: str | None = None

    def __post_init__(self) -> None:
        if (self.point is None) == (self.link is None):
            raise ValueError("look_at gives either 'point' or 'link'")
        if self.link == LOOKING_LINK:
            raise ValueError(f"'link': {LOOKING_LINK} cannot look at itself")

    @property
    def usual_name(self) -> str:
        """There is one head."""
        return "look at"

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield from super().names()
        if self.link is not None:
            yield "link", "link", self.link


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ComSpec(TaskSpec):
    """The centre of mass moves to ``target``, in the world or in base_link."""

    target: Place
    root: Literal["base_link"] | None = None

    @property
    def usual_name(self) -> str:
        """There is one robot."""
        return "com"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BaseSpec:
    """The base moves to a place and heading in the world; omitted parts stay as they are when the step begins.

    ``stiffness`` [1/s2], ``weight`` and ``keep`` as in :class:`TaskSpec`.
    """

    x: Metres | None = None
    y: Metres | None = None
    heading: Heading | None = None
    stiffness: TaskStiffness | None = None
    weight: Positive | None = None
    keep: bool = False

    def __post_init__(self) -> None:
        if self.x is None and self.y is None and self.heading is None:
            raise ValueError("base gives 'x', 'y' or 'heading'")

    @property
    def label(self) -> str:
        """There is one base."""
        return "base"


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BaseVelocitySpec:
    """The base moves on at ``vx``, ``vy`` [m/s], ``wz`` [rad/s] in its own axes, until the step ends."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0


AnyTask = PositionSpec | OrientationSpec | PoseSpec | LookAtSpec | ComSpec | BaseSpec


def check_quaternion(quaternion: Quaternion) -> None:
    """Raise a ValueError unless a quaternion has unit length."""
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > UNIT:
        raise ValueError(f"'quaternion' (x, y, z, w) must have length 1, got {norm:.4g}")
