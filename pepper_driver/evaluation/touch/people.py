"""People who touch a simulated robot: each act is a kind of touch, made at the robot as it stands at that moment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.touch_suites import Act, PlacePoint, PlannedAct, TouchSuites
from pepper_driver.controller import RobotModel
from pepper_driver.controller.support_polygon import SupportPolygon
from pepper_driver.robot import Pepper
from pepper_driver.steady_hand import SteadyHand

HAND_PERIOD = 0.048
"""[s] between two moves of a hand: four ticks."""

MAX_HAND_FORCE = 40.0
"""[N] of a hand that holds."""

MIN_TIPPING = 0.05
"""Ratio to what would tip the robot, of a push during others that leave it no more."""

PULL = 0.04
"""[m] Way of a hand that grips and pulls."""

FADING = 0.2
"""[s] in which the force of a hand that opens ends."""

SHAKE, SHAKES = 0.03, 2.0
"""[m], [1/s] of a handshake."""

LEAD = 0.25
"""[m] Way on which a robot is led by its hand."""

QUICK_TAPS, BETWEEN_TAPS = 3, 0.4
"""Number of quick taps, and the time from one to the next [s]."""

Wait = Iterator[float]
"""An act in progress: it yields the times [s] that pass before it continues."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MadeTouch:
    """A touch that a person makes.

    Attributes:
        act: The act it is part of.
        place: Where, as the suites call it.
        point: Where.
        rise: [s]; None for a hand that holds on.
        row: Number of ticks before it began.
    """

    act: PlannedAct
    place: str
    point: PlacePoint
    rise: float | None
    row: int


class Person:
    """A person at a simulated robot.

    Args:
        pepper: The robot, which is running.
        suites: Places, and bounds of what people do.
        generator: Of all that is drawn.
        ticks: Number of ticks so far.

    Attributes:
        touches: All so far.
    """

    def __init__(
        self,
        pepper: Pepper,
        suites: TouchSuites,
        generator: np.random.Generator,
        ticks: Callable[[], int],
    ) -> None:
        self._ticks = ticks
        self._pepper, self._suites, self._generator = pepper, suites, generator
        self._model = RobotModel(pepper.config)
        self._polygon = SupportPolygon.from_robot(pepper.config)
        self.touches: list[MadeTouch] = []
        self._acting: list[tuple[float, float]] = []  # end [s], ratio to what would tip the robot

    def perform(self, act: PlannedAct) -> Wait:
        """Make a touch; the times that it yields must pass before it continues."""
        return ACTS[act.row.act](self, act)

    def spot(self, place: str, side: bool | None = None) -> PlacePoint:
        """Draw a point of a place; ``side`` True for the right one, None for either."""
        points = self.points(place)
        point = points[int(self._generator.integers(len(points)))]
        right = bool(self._generator.integers(2)) if side is None else side
        return point.mirrored if right else point

    def points(self, place: str) -> tuple[PlacePoint, ...]:
        """Return the points of a place, those of the left side."""
        return self._suites.places[place].points

    def side(self) -> bool:
        """Draw a side: True for the right one."""
        return bool(self._generator.integers(2))

    def direction(self, point: PlacePoint, act: PlannedAct) -> FloatArray:
        """Draw the direction of a force, (3,) in the axes of the link.

        Even over the half-space that pushes on the point, without those along the axis of the place; or even over
        those along it, both ways.
        """
        axis = np.array(self._suites.places[act.place].axis)
        axis /= np.linalg.norm(axis)
        near = math.cos(math.radians(self._suites.along_axis))
        outward = np.array(point.outward)
        while True:
            vector = self._generator.normal(size=3)
            vector /= np.linalg.norm(vector)
            along = abs(float(vector @ axis)) > near
            if act.row.direction == "axis":
                if along:
                    return vector
            elif not along and float(vector @ outward) < 0.0:
                return vector

    def push(
        self,
        act: PlannedAct,
        point: PlacePoint,
        *,
        place: str | None = None,
        direction: FloatArray | None = None,
        world: bool = False,
    ) -> float:
        """Begin a push now, as strong as the act says, or weaker where that would tip the robot; return its time [s].

        Args:
            act: The act it is part of.
            point: Where.
            place: Where, as the suites call it; None for the place of the act.
            direction: (3,) in the axes of the link, or of the world; None to draw one.
            world: True if ``direction`` is in the axes of the world.
        """
        assert act.force is not None
        unit = self.direction(point, act) if direction is None else direction
        row = act.row
        size = self._firm(act.force, point, unit, world, row.duration)
        self._pepper.push(
            point.link,
            size * unit,
            point.xyz,
            row.duration,
            frame="world" if world else "link",
            rise=row.rise,
        )
        rise = min(row.rise, row.duration / 3)
        self._add(act, place, point, rise)
        return row.duration

    def _add(
        self, act: PlannedAct, place: str | None, point: PlacePoint, rise: float | None
    ) -> None:
        made = MadeTouch(
            act=act, place=place or act.place, point=point, rise=rise, row=self._ticks()
        )
        self.touches.append(made)

    def _firm(
        self, force: float, point: PlacePoint, unit: FloatArray, world: bool, duration: float
    ) -> float:
        """Return the force [N], or the largest one with which the robot still stands firmly, given the other pushes."""
        posture = np.asarray(self._pepper.position, dtype=np.float64)
        pose = self._model.link_pose(point.link, posture)
        if world:
            yaw = float(self._pepper.backend.truth.base[2])
            in_base = _turned(unit, -yaw)
        else:
            in_base = pose[:3, :3] @ unit
        where = pose[:3, :3] @ np.array(point.xyz) + pose[:3, 3]
        ratio = self._polygon.tipping_ratio(posture, where, force * in_base)
        now = self._pepper.time
        self._acting = [(end, other) for end, other in self._acting if end > now]
        left = self._suites.max_tipping - sum(other for _, other in self._acting)
        fraction = min(1.0, max(left, MIN_TIPPING) / ratio) if ratio > 0.0 else 1.0
        self._acting.append((now + duration, fraction * ratio))
        return fraction * force

    def take(self, act: PlannedAct, point: PlacePoint) -> SteadyHand:
        """Close a hand at a point."""
        assert act.stiffness is not None
        hand = self._pepper.take_hand(
            point.link, point.xyz, stiffness=act.stiffness, max_force=MAX_HAND_FORCE
        )
        self._add(act, None, point, None)
        return hand

    def where(self, point: PlacePoint) -> FloatArray:
        """(3,) place of a point in the world, as the person sees it [m]."""
        pose = self._pepper.backend.truth.link_pose(point.link)
        place: FloatArray = pose[:3, :3] @ np.array(point.xyz) + pose[:3, 3]
        return place

    def forward(self, size: float) -> FloatArray:
        """(3,) way of ``size`` [m] to where the robot looks, in the world."""
        return _turned(np.array([size, 0.0, 0.0]), float(self._pepper.backend.truth.base[2]))

    def sphere(self) -> FloatArray:
        """(3,) direction, even over the sphere."""
        vector = self._generator.normal(size=3)
        unit: FloatArray = vector / np.linalg.norm(vector)
        return unit


def _turned(vector: FloatArray, yaw: float) -> FloatArray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y, z = vector
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def _push(person: Person, act: PlannedAct) -> Wait:
    """Push once."""
    yield person.push(act, person.spot(act.place))


def _taps(person: Person, act: PlannedAct) -> Wait:
    """Tap quickly at one point."""
    point = person.spot(act.place)
    for _ in range(QUICK_TAPS):
        person.push(act, point)
        yield BETWEEN_TAPS


def _move(
    person: Person, act: PlannedAct, goal: Callable[[float, FloatArray, PlacePoint], FloatArray]
) -> Wait:
    """Close a hand, move it to ``goal`` of (time, place where it closed, point), and open it."""
    point = person.spot(act.place)
    hand = person.take(act, point)
    start = person.where(point)
    for step in range(max(1, round(act.row.duration / HAND_PERIOD))):
        hand.move(goal(step * HAND_PERIOD, start, point))
        yield HAND_PERIOD
    hand.release()
    yield FADING


def _grip(person: Person, act: PlannedAct) -> Wait:
    """Hold on where the hand closed, while the robot moves."""
    yield from _move(person, act, lambda time, start, point: start)


def _pull(person: Person, act: PlannedAct) -> Wait:
    """Grip and pull for a second, in any direction."""
    way = PULL * person.sphere()
    yield from _move(person, act, lambda time, start, point: start + min(time, 1.0) * way)


def _follow(person: Person, act: PlannedAct) -> Wait:
    """Hold on and go with the robot."""
    yield from _move(person, act, lambda time, start, point: person.where(point))


def _handshake(person: Person, act: PlannedAct) -> Wait:
    """Shake a hand up and down."""

    def goal(time: float, start: FloatArray, point: PlacePoint) -> FloatArray:
        return start + SHAKE * math.sin(2.0 * math.pi * SHAKES * time) * np.array([0.0, 0.0, 1.0])

    yield from _move(person, act, goal)


def _lead(person: Person, act: PlannedAct) -> Wait:
    """Lead the robot forward by its hand."""
    way = person.forward(LEAD)
    last = 0.75 * act.row.duration
    yield from _move(person, act, lambda time, start, point: start + min(time / last, 1.0) * way)


def _hug(person: Person, act: PlannedAct) -> Wait:
    """Press both upper arms and the back at once, each arm towards the body."""
    side = next(point for point in person.points(act.place) if point.outward[1] > 0.0)
    for point in (side, side.mirrored):
        person.push(act, point, direction=-np.array(point.outward))
    back = next(point for point in person.points("trunk") if point.outward[0] < 0.0)
    yield person.push(act, back, place="trunk", direction=np.array([1.0, 0.0, 0.0]))


def _weight(person: Person, act: PlannedAct) -> Wait:
    """Put an object into the hand: its weight, without its inertia."""
    down = np.array([0.0, 0.0, -1.0])
    yield person.push(act, person.spot(act.place), direction=down, world=True)


def _pair(person: Person, act: PlannedAct) -> Wait:
    """Push hand and upper arm of one side, the second a little later."""
    right = person.side()
    person.push(act, person.spot(act.place, right))
    yield 0.2
    yield person.push(act, person.spot("upper arm", right), place="upper arm")


def _both(person: Person, act: PlannedAct) -> Wait:
    """Push the same place of both sides, the second a little later."""
    right = person.side()
    person.push(act, person.spot(act.place, right))
    yield 0.2
    yield person.push(act, person.spot(act.place, not right))


def _table(person: Person, act: PlannedAct) -> Wait:
    """Wait: the robot meets a table by itself."""
    yield act.row.duration


ACTS: dict[Act, Callable[[Person, PlannedAct], Wait]] = {
    "push": _push,
    "taps": _taps,
    "grip": _grip,
    "pull": _pull,
    "follow": _follow,
    "handshake": _handshake,
    "lead": _lead,
    "hug": _hug,
    "weight": _weight,
    "pair": _pair,
    "both": _both,
    "before": _push,
    "table": _table,
}
"""By kind. Of ``before`` the robot has its first tick while the push lasts."""
