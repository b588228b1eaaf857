"""Contacts that an experiment gives a simulated robot. Points in the link's frame [m]; times [s].

Each names the joint it is meant for, and the link and point where the hand is. ``saturating`` marks contacts that may
take a motor board beyond what its current limit can hold; no other may.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.loading import STRICT, one_or_more
from pepper_driver.config.parts import NonNegative, Positive, Vector3, check_bounds
from pepper_driver.config.task_specs import Label, Named

Axes = Literal["world", "link"]
Degrees = Annotated[float, Field(gt=0, le=90)]

MAX_HAND_FORCE = 1000.0
"""[N] No contact may be stronger, not even one that is meant to saturate."""

SOFTEST_HAND, STIFFEST_HAND = 300.0, 3000.0
"""[N/m] of a hand that grabs."""

FARTHEST_PULL = 1.0
"""[m]"""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Touch:
    """One contact of known place and time.

    Attributes:
        joint: Joint it is meant for.
        link, xyz: Where the hand is.
        start: Since the beginning of ``step``, each time it is played; without one, of the experiment [s].
        step: Name of a step.
    """

    joint: str
    link: str
    xyz: Vector3
    start: NonNegative
    step: Label | None = None
    saturating: bool = False

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield "joint", "joint", self.joint
        yield "link", "link", self.link


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PushSpec(Touch):
    """A force [N] in the axes of the world or of the link."""

    kind: Literal["push"]
    force: Vector3
    frame: Axes = "world"
    duration: Positive

    def __post_init__(self) -> None:
        _check_vector("force", self.force, MAX_HAND_FORCE, "N")

    @property
    def largest(self) -> Vector3:
        """The force at its largest [N]."""
        return self.force


@dataclass(frozen=True, kw_only=True, config=STRICT)
class JointPushSpec(Touch):
    """The smallest force that puts ``degrees`` equivalent degrees on ``joint``.

    Equivalent degrees: torque on the joint divided by its proportional stiffness. ``direction`` is the torque's sign.
    """

    kind: Literal["joint_push"]
    degrees: Degrees
    direction: Literal[-1, 1]
    duration: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class GrabSpec(Touch):
    """A hand, as a spring, that grabs a point, moves by ``pull`` [m] in ``rise``, stays for ``hold``, releases it.

    Its spring has ``stiffness`` [N/m], gives ``max_force`` [N] at most, and fades over ``release``. Times in [s].
    """

    kind: Literal["grab"]
    pull: Vector3
    frame: Axes = "world"
    stiffness: Annotated[float, Field(ge=SOFTEST_HAND, le=STIFFEST_HAND)] = 1000.0
    max_force: Annotated[float, Field(gt=0, le=MAX_HAND_FORCE)] = 100.0
    rise: Positive = 0.5
    hold: NonNegative = 1.0
    release: Positive = 0.1

    def __post_init__(self) -> None:
        _check_vector("pull", self.pull, FARTHEST_PULL, "m")

    @property
    def duration(self) -> float:
        """From grab to release [s]."""
        return self.rise + self.hold + self.release

    @property
    def largest(self) -> Vector3:
        """Largest force [N]: while the link stays in place."""
        way = math.hypot(*self.pull)
        # A joint that yields shortens the distance from hand to point, and so reduces the force.
        force = min(self.stiffness * way, self.max_force)
        x, y, z = (force / way * part for part in self.pull)
        return x, y, z


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PushPoint:
    """A point of a link, ``xyz`` [m] in the link's frame."""

    link: str
    xyz: Vector3


Points = Annotated[tuple[PushPoint, ...], one_or_more(PushPoint)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomTouch:
    """Contacts of random place, size and direction, at these ``times`` after each new goal of a step with random goals.

    Attributes:
        step: Name of the step; may be left out where there is one such step.
        times: [s] after the goal was set.
        after: Goals set before this time since the step settled have no contact [s]: the robot moves freely first.
        jitter: Each time differs by half of this at most, in both directions [s].
        duration: Shortest and longest push [s].
        rise: Shortest and longest time in which a push rises, and falls [s]; None for that of the backend.
        in_motion: Planned for where the joints will be when the push has risen, and possible until its end. Without
            it, planned for the goal, which a push in motion does not find the robot in.
        saturating: As for all contacts; without it, sizes that would saturate a board are drawn again.
    """

    step: Label | None = None
    times: Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=1000)]
    after: NonNegative = 0.0
    jitter: NonNegative = 0.0
    duration: tuple[Positive, Positive]
    rise: tuple[Positive, Positive] | None = None
    in_motion: bool = False
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
    def latest(self) -> float:
        """Latest end of the last push, after the goal was set [s]."""
        return max(self.times) + self.jitter / 2 + self.duration[1]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomPushes(RandomTouch):
    """Pushes on random joints.

    Attributes:
        joints: Drawn from, each as often.
        balanced: A size that does not fit is drawn again for the same joint; without it another joint is drawn too, and
            those that can take little are pushed less often.
        degrees: Smallest and largest equivalent degrees; log-uniform.
        points: Where each joint is pushed: one place, or several that are tried in random order.
        max_force: No hand pushes harder [N].
        max_distal_ratio: Largest torque on a joint further out in the chain, in equivalent degrees, as a ratio to
            those on the joint that is meant; less than half its friction is always allowed. None for any.
    """

    kind: Literal["random_pushes"]
    joints: Annotated[tuple[str, ...], Field(min_length=1)]
    balanced: bool = False
    degrees: tuple[Degrees, Degrees]
    points: dict[str, Points]
    max_force: Annotated[float, Field(gt=0, le=MAX_HAND_FORCE)] = MAX_HAND_FORCE
    max_distal_ratio: NonNegative | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bounds("degrees", self.degrees)
        for joint in self.joints:
            if joint not in self.points:
                raise ValueError(f"'points' has no entry for joint {joint}")

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield from (("joints", "joint", joint) for joint in self.joints)
        for joint, points in self.points.items():
            yield "points", "joint", joint
            yield from ((f"points.{joint}.link", "link", point.link) for point in points)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomForces(RandomTouch):
    """Horizontal forces of random direction on trunk or base, which no arm or head joint carries.

    Attributes:
        newtons: Smallest and largest force [N]; log-uniform.
        points: Drawn from, each as often.
    """

    kind: Literal["random_forces"]
    newtons: tuple[Positive, Annotated[float, Field(gt=0, le=MAX_HAND_FORCE)]]
    points: Points

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bounds("newtons", self.newtons)

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield from ((f"points.{n}.link", "link", p.link) for n, p in enumerate(self.points))


StatedContact = PushSpec | JointPushSpec | GrabSpec
AnyContact = StatedContact | RandomPushes | RandomForces


def _check_vector(key: str, vector: Vector3, largest: float, unit: str) -> None:
    size = math.hypot(*vector)
    if not 0 < size <= largest:
        raise ValueError(
            f"'{key}' must be longer than 0, and {largest:g} {unit} at most, not {size:g}"
        )
