"""Kinds of contact a scenario can ask for. Points in the link's frame [m]; times [s] from the end of the settling.

Every contact names the joint it is meant for, and the link and point where the hand is. ``saturating`` marks contacts
that may take a motor board beyond what its current limit can hold; no other may.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, WrapValidator
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT
from pepper_driver.config.parts import NotNegative, Positive, Vector3
from pepper_driver.config.scenario_motion import Joints, Name, check_bounds

Axes = Literal["world", "link"]
Degrees = Annotated[float, Field(gt=0, le=90)]

STRONGEST_HAND = 1000.0
"""[N] No contact may be stronger, not even one that is meant to saturate."""

SOFTEST_HAND, STIFFEST_HAND = 500.0, 3000.0
"""[N/m] of a hand that grabs."""

FARTHEST_PULL = 1.0
"""[m]"""


@dataclass(frozen=True, kw_only=True)
class Hand:
    """A link that a contact may hold between ``begin`` and ``end`` [s]; ``key`` is where the file says so."""

    key: str
    link: str
    begin: float
    end: float


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Touch:
    """What one contact of known place and time says: ``joint`` it is meant for, ``link`` and point, ``start`` [s]."""

    joint: str
    link: str
    xyz: Vector3
    start: NotNegative
    saturating: bool = False

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        yield "joint", "joint", self.joint
        yield "link", "link", self.link


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Push(Touch):
    """A force [N] in the axes of the world or of the link."""

    kind: Literal["push"]
    force: Vector3
    frame: Axes = "world"
    duration: Positive

    def __post_init__(self) -> None:
        _check_vector("force", self.force, STRONGEST_HAND, "N")

    @property
    def largest(self) -> Vector3:
        """The force at its largest [N]."""
        return self.force


@dataclass(frozen=True, kw_only=True, config=STRICT)
class JointPush(Touch):
    """The smallest force that puts ``degrees`` equivalent degrees on ``joint``.

    Equivalent degrees: torque on the joint divided by its proportional stiffness. ``direction`` is the torque's sign.
    """

    kind: Literal["joint_push"]
    degrees: Degrees
    direction: Literal[-1, 1]
    duration: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Grab(Touch):
    """A springy hand that takes hold of a point, moves by ``pull`` [m] in ``rise``, stays for ``hold``, lets go.

    Its spring has ``stiffness`` [N/m], gives ``largest_force`` [N] at most, and fades over ``release``. Times in [s].
    """

    kind: Literal["grab"]
    pull: Vector3
    frame: Axes = "world"
    stiffness: Annotated[float, Field(ge=SOFTEST_HAND, le=STIFFEST_HAND)] = 1000.0
    largest_force: Annotated[float, Field(gt=0, le=STRONGEST_HAND)] = 100.0
    rise: Positive = 0.5
    hold: NotNegative = 1.0
    release: Positive = 0.1

    def __post_init__(self) -> None:
        _check_vector("pull", self.pull, FARTHEST_PULL, "m")

    @property
    def duration(self) -> float:
        """From taking hold to letting go [s]."""
        return self.rise + self.hold + self.release

    @property
    def largest(self) -> Vector3:
        """The force at its largest [N]: while the link does not give way."""
        way = math.hypot(*self.pull)
        force = min(self.stiffness * way, self.largest_force)
        x, y, z = (force / way * part for part in self.pull)
        return x, y, z


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PushPoint:
    """A point of a link, ``xyz`` [m] in the link's frame."""

    link: str
    xyz: Vector3


_Places = Annotated[tuple[PushPoint, ...], Field(min_length=1, max_length=100)]


def _one_or_more(value: object, _: object) -> tuple[PushPoint, ...]:
    """A single place stands for a list of one."""
    if isinstance(value, tuple):
        return value
    text = json.dumps([value] if isinstance(value, dict) else value)
    # Through JSON, as in the loader: there strict mode takes lists for tuples.
    return TypeAdapter(_Places).validate_json(text, strict=True)


Points = Annotated[tuple[PushPoint, ...], WrapValidator(_one_or_more)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomTouch:
    """What all contacts of random place, size and direction say, at these ``times`` after each new goal of the motion.

    Attributes:
        times: [s] after the goal was set.
        after: Goals set before this time have no contact [s]: the robot moves freely first.
        jitter: Each time is off by half of this at most, either way [s].
        duration: Shortest and longest push [s].
        rise: Shortest and longest time in which a push rises, and falls [s]; None for that of the backend.
        on_the_way: Planned for where the joints will be when the push has risen, and possible until its end. Without
            it, planned for the goal, which a push in motion does not find the robot in.
        saturating: As for all contacts; without it, sizes that would saturate a board are drawn again.
    """

    times: Annotated[tuple[NotNegative, ...], Field(min_length=1, max_length=1000)]
    after: NotNegative = 0.0
    jitter: NotNegative = 0.0
    duration: tuple[Positive, Positive]
    rise: tuple[Positive, Positive] | None = None
    on_the_way: bool = False
    saturating: bool = False

    def __post_init__(self) -> None:
        check_bounds("duration", self.duration)
        if self.rise is not None:
            check_bounds("rise", self.rise)
        if min(self.times) < self.jitter / 2:
            raise ValueError(
                "'jitter' takes a push to before its goal: no time may be below half of it"
            )

    @property
    def links(self) -> tuple[str, ...]:
        """Where hands may be, in order of the alphabet."""
        raise NotImplementedError

    def hands(self, key: str) -> Iterator[Hand]:
        """Where hands may be, and when at the widest, after a goal at time 0."""
        half = self.jitter / 2
        for number, time in enumerate(self.times):
            for link in self.links:
                yield Hand(
                    key=f"{key}.times.{number}",
                    link=link,
                    begin=time - half,
                    end=time + half + self.duration[1],
                )


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomPushes(RandomTouch):
    """Pushes on random joints.

    Attributes:
        joints: Drawn from, each as often.
        evenly: A size that does not fit is drawn again for the same joint; without it another joint is drawn too, and
            those that can take little are pushed less often.
        degrees: Smallest and largest equivalent degrees; log-uniform.
        points: Where each joint is pushed: one place, or several that are tried in random order.
        largest_force: No hand pushes harder [N].
        further_out: Largest torque on a joint further out in the chain, in equivalent degrees, as a share of those on
            the joint that is meant; less than half its friction is always allowed. None for any.
    """

    kind: Literal["random_pushes"]
    joints: Joints
    evenly: bool = False
    degrees: tuple[Degrees, Degrees]
    points: dict[str, Points]
    largest_force: Annotated[float, Field(gt=0, le=STRONGEST_HAND)] = STRONGEST_HAND
    further_out: NotNegative | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bounds("degrees", self.degrees)
        for joint in self.joints:
            if joint not in self.points:
                raise ValueError(f"'points' has no entry for joint {joint}")

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        yield from (("joints", "joint", joint) for joint in self.joints)
        for joint, points in self.points.items():
            yield "points", "joint", joint
            yield from ((f"points.{joint}.link", "link", point.link) for point in points)

    @property
    def links(self) -> tuple[str, ...]:
        """Where hands may be, in order of the alphabet."""
        return tuple(sorted({point.link for joint in self.joints for point in self.points[joint]}))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomForces(RandomTouch):
    """Horizontal forces of random direction on trunk or base, which no arm or head joint carries.

    Attributes:
        newtons: Smallest and largest force [N]; log-uniform.
        points: Drawn from, each as often.
    """

    kind: Literal["random_forces"]
    newtons: tuple[Positive, Annotated[float, Field(gt=0, le=STRONGEST_HAND)]]
    points: Points

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bounds("newtons", self.newtons)

    def names(self) -> Iterator[Name]:
        """Names the robot must know."""
        yield from ((f"points.{n}.link", "link", p.link) for n, p in enumerate(self.points))

    @property
    def links(self) -> tuple[str, ...]:
        """Where hands may be, in order of the alphabet."""
        return tuple(sorted({point.link for point in self.points}))


AnyContact = Push | JointPush | Grab | RandomPushes | RandomForces


def _check_vector(key: str, vector: Vector3, largest: float, unit: str) -> None:
    size = math.hypot(*vector)
    if not 0 < size <= largest:
        raise ValueError(
            f"'{key}' must be longer than 0, and {largest:g} {unit} at most, not {size:g}"
        )
