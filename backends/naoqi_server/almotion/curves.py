"""Curves of joints: splines, Bezier curves and the approach to a target."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, sqrt

CLOSE = 1e-4
"""[rad] A target this near is reached in one step."""


class Spline:
    """A cubic spline from a start through timed points, at rest at its end; between two points it stays in their range.

    Args:
        start: Value at time 0, and its slope there.
        times: Of the points, rising, after 0 [s].
        values: Of the points.
    """

    def __init__(
        self, start: tuple[float, float], times: Sequence[float], values: Sequence[float]
    ) -> None:
        self._times = [0.0, *times]
        self._values = [start[0], *values]
        steps = [b - a for a, b in pairwise(self._times)]
        rises = [b - a for a, b in pairwise(self._values)]
        rates = [rise / step for rise, step in zip(rises, steps, strict=True)]
        # Inner slopes are harmonic means (Fritsch and Butland 1984), which keeps the curve monotone between points.
        inner = [2 * a * b / (a + b) if a * b > 0 else 0.0 for a, b in pairwise(rates)]
        self._slopes = [start[1], *inner, 0.0]

    @property
    def duration(self) -> float:
        """Its end [s]."""
        return self._times[-1]

    def at(self, time: float) -> float:
        """Value at a time; at the end after it."""
        if time >= self.duration:
            return self._values[-1]
        index = max(bisect_right(self._times, time) - 1, 0)
        step = self._times[index + 1] - self._times[index]
        fraction = max(time - self._times[index], 0.0) / step
        left, right = self._values[index], self._values[index + 1]
        slope, next_slope = self._slopes[index] * step, self._slopes[index + 1] * step
        rise = right - left
        return left + fraction * (
            slope
            + fraction
            * (3 * rise - 2 * slope - next_slope + fraction * (slope + next_slope - 2 * rise))
        )


@dataclass(frozen=True, kw_only=True)
class Point:
    """A point of a Bezier curve: handles are (time, value) relative to it, before and after."""

    time: float
    value: float
    before: tuple[float, float] = (0.0, 0.0)
    after: tuple[float, float] = (0.0, 0.0)


class Bezier:
    """A curve of timed Bezier segments from ``start`` at time 0, as Choregraphe's timelines are exported."""

    def __init__(self, start: float, points: Sequence[Point]) -> None:
        self._points = [Point(time=0.0, value=start), *points]
        self._times = [point.time for point in self._points]

    @property
    def duration(self) -> float:
        """Its end [s]."""
        return self._times[-1]

    def at(self, time: float) -> float:
        """Value at a time; at the end after it."""
        if time >= self.duration:
            return self._points[-1].value
        index = max(bisect_right(self._times, time) - 1, 0)
        left, right = self._points[index], self._points[index + 1]
        times = self._ordered(left, right)
        values = (
            left.value,
            left.value + left.after[1],
            right.value + right.before[1],
            right.value,
        )
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = (low + high) / 2
            if _cubic(times, middle) < time:
                low = middle
            else:
                high = middle
        return _cubic(values, low)

    @staticmethod
    def _ordered(left: Point, right: Point) -> tuple[float, float, float, float]:
        """Return the times of a segment's four points; handles beyond the other end are cut."""
        after = min(max(left.time + left.after[0], left.time), right.time)
        before = max(min(right.time + right.before[0], right.time), left.time)
        return left.time, after, before, right.time


def _cubic(points: tuple[float, float, float, float], fraction: float) -> float:
    a, b, c, d = points
    rest = 1 - fraction
    return rest**3 * a + 3 * rest**2 * fraction * b + 3 * rest * fraction**2 * c + fraction**3 * d


def approach(
    position: float, velocity: float, target: float, *, speed: float, acceleration: float, dt: float
) -> tuple[float, float]:
    """One step towards a target that may change: (position, velocity) after it.

    The speed stays within ``speed`` and changes by ``acceleration * dt`` at most, and is never more than can be braked
    away before the target.
    """
    gap = target - position
    brakes = acceleration * (sqrt(dt * dt + 2 * abs(gap) / acceleration) - dt)
    goal = copysign(min(speed, brakes), gap)
    change = acceleration * dt
    if abs(gap) < CLOSE and abs(velocity) <= change:
        return target, 0.0
    velocity += min(max(goal - velocity, -change), change)
    return position + velocity * dt, velocity
