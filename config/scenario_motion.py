"""Kinds of motion a scenario can ask for. Angles in [rad], times in [s] from the end of the settling."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT
from pepper_driver.config.parts import NotNegative, Positive

Share = Annotated[float, Field(ge=0, le=1)]
PartOfRange = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1, le=10_000)]
Joints = Annotated[tuple[str, ...], Field(min_length=1)]

NameKind = Literal["joint", "link", "posture"]
Name = tuple[str, NameKind, str]
"""A name that the robot must know: key where it stands, what it names, the name."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Sweeps:
    """Free motion of one joint after the other, as in Sec. IV of the contact observer paper.

    The joint plays a random sequence, its neighbours move to new set-points, it plays the sequence again.

    Attributes:
        joints: Each plays sequences of its own.
        estimation_stiffness: Of the posture task [1/s2] in the runs a model is estimated from; the scenario's own
            stiffness is that of the test run.
        sweeps: Moves from near one limit to near the other.
        largest_offset: Share of the joint's range: how far from the limit a sweep may end.
        setpoints: Random set-points anywhere in the range, after the sweeps.
        dwell: Shortest and longest stay of the command at one target [s].
        neighbour_range: Share of their range, around its middle, where the joints before and after may go.
        ranges: Of joints that must not go everywhere: share of the way from the first posture to either limit that
            stands for their range.
    """

    kind: Literal["sweeps"]
    joints: Joints
    estimation_stiffness: Annotated[tuple[Positive, ...], Field(min_length=1)]
    sweeps: Count
    largest_offset: Annotated[float, Field(ge=0, lt=0.5)]
    setpoints: Count
    dwell: tuple[Positive, Positive]
    neighbour_range: Share
    ranges: dict[str, PartOfRange] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_bounds("dwell", self.dwell)

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        yield from (("joints", "joint", joint) for joint in self.joints)
        yield from ((f"ranges.{joint}", "joint", joint) for joint in self.ranges)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BaseMotion:
    """With each new goal the base gets a random twist: up to ``linear`` [m/s] in any direction, ``angular`` [rad/s].

    That happens with probability ``share``; else the base stops.
    """

    linear: NotNegative
    angular: NotNegative
    share: Share


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Setpoints:
    """Random set-points, at once, one every ``period`` [s].

    They lie in the middle share ``range`` of the range of ``joints``, and ``also_range`` of that of ``also_move``;
    ``ranges`` gives single joints another share.
    """

    kind: Literal["setpoints"]
    joints: Joints
    also_move: tuple[str, ...] = ()
    range: Share
    also_range: Share = 0.0
    ranges: dict[str, Share] = field(default_factory=dict)
    base: BaseMotion | None = None
    period: Positive
    count: Count

    def __post_init__(self) -> None:
        for joint in self.ranges:
            if joint not in (*self.joints, *self.also_move):
                raise ValueError(f"'ranges': {joint} is not among the joints that move")

    @property
    def length(self) -> float:
        """Of the motion [s]."""
        return self.count * self.period

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        yield from (("joints", "joint", joint) for joint in self.joints)
        yield from (("also_move", "joint", joint) for joint in self.also_move)
        yield from ((f"ranges.{joint}", "joint", joint) for joint in self.ranges)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Holds:
    """Random goals in the middle share ``range`` of the joints' ranges.

    Each is reached on a minimum-jerk way in ``move`` [s] and held for ``hold`` [s].
    """

    kind: Literal["holds"]
    joints: Joints
    range: Share
    move: Positive
    hold: NotNegative
    count: Count

    @property
    def period(self) -> float:
        """From one goal to the next [s]."""
        return self.move + self.hold

    @property
    def length(self) -> float:
        """Of the motion [s]."""
        return self.count * self.period

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        yield from (("joints", "joint", joint) for joint in self.joints)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Step:
    """At ``time`` [s] the robot is told a posture by name, or some joints with angles [rad].

    From then on the posture task has ``stiffness`` [1/s2], or the one it had.
    """

    time: NotNegative
    posture: str | None = None
    joints: dict[str, float] = field(default_factory=dict)
    stiffness: Positive | None = None

    def __post_init__(self) -> None:
        if (self.posture is None) == (not self.joints):
            raise ValueError("a step gives either 'posture' or 'joints'")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Script:
    """Steps one after the other, over after ``length`` [s]."""

    kind: Literal["script"]
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]
    length: Positive

    def __post_init__(self) -> None:
        times = [step.time for step in self.steps]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("the times of 'steps' must rise")
        if times[-1] >= self.length:
            raise ValueError(f"a step at {times[-1]:g} s comes after 'length', {self.length:g} s")

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        for number, step in enumerate(self.steps):
            if step.posture is not None:
                yield f"steps.{number}.posture", "posture", step.posture
            yield from ((f"steps.{number}.joints", "joint", joint) for joint in step.joints)


Motion = Sweeps | Setpoints | Holds | Script


def check_bounds(key: str, bounds: tuple[float, float]) -> None:
    """Raise a ValueError unless the first bound is the smaller one."""
    if bounds[0] > bounds[1]:
        raise ValueError(
            f"'{key}': the lower bound {bounds[0]:g} is above the upper, {bounds[1]:g}"
        )
