"""Reference motions of tasks: quintic splines, sampled some cycles ahead and read cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Block, Matrix, Out, kernel

Motion = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from (n,) rising times [s] to (n, ...) targets, as a task stores them, and (n, rows) velocities."""

SAMPLED_CYCLES = 128
"""Cycles sampled at once: few enough that the start of a motion of an hour fits into a cycle."""


class Trajectory:
    """Targets with velocities and accelerations, one of each for every cycle from the start to the end.

    The acceleration is the mean of the next cycle: held for the cycle it leads exactly to the next velocity.

    Args:
        motion: Motion from the state in the first cycle to rest.
        duration: Duration of the motion [s].
        dt: Cycle [s].
    """

    def __init__(self, motion: Motion, duration: float, dt: float) -> None:
        self._motion, self._duration, self._dt = motion, duration, dt
        self._cycle, self._last = 0, max(1, round(duration / dt))
        self._sampled = 0
        self._samples: tuple[FloatArray, FloatArray, FloatArray]

    @property
    def over(self) -> bool:
        """True when the last sample has been read."""
        return self._cycle > self._last

    def next(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return target, velocity and acceleration of the next cycle; the last are those of the end at rest."""
        if self._cycle == self._sampled:
            self._sample()
        index = self._cycle % SAMPLED_CYCLES
        self._cycle += 1
        targets, velocities, accelerations = self._samples
        return targets[index], velocities[index], accelerations[index]

    def _sample(self) -> None:
        first, dt = self._sampled, self._dt
        self._sampled = first + SAMPLED_CYCLES
        cycles = np.arange(first, self._sampled + 1)
        times = np.minimum(cycles * dt, self._duration)
        times[cycles >= self._last] = self._duration
        targets, velocities = self._motion(times)
        self._samples = targets[:-1], velocities[:-1], np.diff(velocities, axis=0) / dt


@kernel
def _fit(
    points: Matrix[FloatArray],
    velocity: FloatArray,
    durations: FloatArray,
    rates: Out[Block[FloatArray]],
    factors: Out[Block[FloatArray]],
    polynomials: Out[Block[FloatArray]],
) -> None:
    """Write the polynomials of a quintic spline.

    Between two points it follows from positions, velocities v and accelerations a of both. At each point on the way,
    those are such that the third and the fourth derivative are continuous:

        L (v, a) of the point before + D (v, a) + U (v, a) of the point after = r.

    The matrices are 2 by 2. Each point in turn is eliminated from the next equation. No pivots are required: the
    equations are those of the least integral of the squared third derivative, so they are positive definite.

    Args:
        points: (m + 1, n) start and points to pass.
        velocity: (n,) at the start.
        durations: (m,) from point to point.
        rates: (m + 1, 2, n) for (v, a) of the points.
        factors: (m + 1, 2, 2) for the effect of (v, a) of the point after.
        polynomials: (m, 6, n) to write: coefficients from the constant one up, over the time after the end of each, in
            fractions of its duration; so the points are passed exactly.
    """
    m, n = len(durations), len(velocity)
    rates[:] = 0.0
    factors[:] = 0.0
    rates[0, 0] = velocity
    for p in range(1, m):
        h, k = durations[p - 1], durations[p]
        before, after = factors[p - 1], factors[p]
        # First the equation of the fourth derivative, then that of the third.
        l00, l01, l10, l11 = 168 / h**3, 24 / h**2, -24 / h**2, -3 / h
        d00, d01 = 192 / h**3 + 192 / k**3, 36 / k**2 - 36 / h**2
        d10, d11 = 36 / k**2 - 36 / h**2, 9 / h + 9 / k
        u00, u01, u10, u11 = 168 / k**3, -24 / k**2, 24 / k**2, -3 / k
        # (v, a) of the point before are its rates - factors (v, a) of this one.
        d00 -= l00 * before[0, 0] + l01 * before[1, 0]
        d01 -= l00 * before[0, 1] + l01 * before[1, 1]
        d10 -= l10 * before[0, 0] + l11 * before[1, 0]
        d11 -= l10 * before[0, 1] + l11 * before[1, 1]
        determinant = d00 * d11 - d01 * d10
        for i in range(n):
            left, right = points[p, i] - points[p - 1, i], points[p + 1, i] - points[p, i]
            v, a = rates[p - 1, 0, i], rates[p - 1, 1, i]
            r0 = 360 * right / k**4 + 360 * left / h**4 - l00 * v - l01 * a
            r1 = 60 * right / k**3 - 60 * left / h**3 - l10 * v - l11 * a
            rates[p, 0, i] = (d11 * r0 - d01 * r1) / determinant
            rates[p, 1, i] = (d00 * r1 - d10 * r0) / determinant
        if p + 1 < m:  # the last point is at rest
            after[0, 0] = (d11 * u00 - d01 * u10) / determinant
            after[0, 1] = (d11 * u01 - d01 * u11) / determinant
            after[1, 0] = (d00 * u10 - d10 * u00) / determinant
            after[1, 1] = (d00 * u11 - d10 * u01) / determinant
    for p in range(m - 2, 0, -1):
        for i in range(n):
            v, a = rates[p + 1, 0, i], rates[p + 1, 1, i]
            rates[p, 0, i] -= factors[p, 0, 0] * v + factors[p, 0, 1] * a
            rates[p, 1, i] -= factors[p, 1, 0] * v + factors[p, 1, 1] * a
    for p in range(m):
        h, c = durations[p], polynomials[p]
        for i in range(n):
            way = points[p + 1, i] - points[p, i]
            v0, a0 = rates[p, 0, i] * h, rates[p, 1, i] * h**2
            v1, a1 = rates[p + 1, 0, i] * h, rates[p + 1, 1, i] * h**2
            c[0, i], c[1, i], c[2, i] = points[p + 1, i], v1, a1 / 2
            c[3, i] = 10 * way - 6 * v1 - 4 * v0 + 1.5 * a1 - 0.5 * a0
            c[4, i] = 15 * way - 8 * v1 - 7 * v0 + 1.5 * a1 - a0
            c[5, i] = 6 * way - 3 * v1 - 3 * v0 + 0.5 * a1 - 0.5 * a0


@kernel
def _follow(
    times: FloatArray,
    durations: FloatArray,
    polynomials: Block[FloatArray],
    positions: Out[Matrix[FloatArray]],
    velocities: Out[Matrix[FloatArray]],
) -> None:
    """Write (times, n) positions and velocities of what :func:`_fit` wrote, at rising times from the start [s]."""
    p, end = 0, durations[0]
    for t in range(len(times)):
        while p + 1 < len(durations) and times[t] > end:
            p += 1
            end += durations[p]
        h, c = durations[p], polynomials[p]
        s = (times[t] - end) / h
        for i in range(positions.shape[1]):
            c1, c2, c3, c4, c5 = c[1, i], c[2, i], c[3, i], c[4, i], c[5, i]
            positions[t, i] = c[0, i] + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
            velocities[t, i] = (c1 + s * (2 * c2 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h


def load_splines() -> None:
    """Compile what motions need, which begin inside a tick."""
    _fit.load()
    _follow.load()


def spline(points: FloatArray, velocity: FloatArray, durations: Sequence[float]) -> Motion:
    """Return a quintic spline through points.

    It starts with a given velocity, ends at rest, and has no acceleration at either end: between two points and from
    rest, the minimum-jerk motion.

    Args:
        points: (m + 1, n) start and m points to pass.
        velocity: (n,) velocity at the start.
        durations: m times [s] from point to point.
    """
    m, n = len(durations), len(velocity)
    polynomials, parts = np.empty((m, 6, n)), np.array(durations, dtype=np.float64)
    _fit(points, velocity, parts, np.empty((m + 1, 2, n)), np.empty((m + 1, 2, 2)), polynomials)

    def motion(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        positions, velocities = np.empty((2, len(times), n))
        _follow(times, parts, polynomials, positions, velocities)
        return positions, velocities

    return motion


def vector_trajectory(
    points: FloatArray, velocity: FloatArray, durations: Sequence[float], dt: float
) -> Trajectory:
    """Return the trajectory of a vector target; arguments as for :func:`spline`, and the cycle [s]."""
    return Trajectory(spline(points, velocity, durations), sum(durations), dt)


def rotation_spline(
    rotations: Sequence[FloatArray], velocity: FloatArray, durations: Sequence[float]
) -> Motion:
    """Return rotations along a spline of rotation vectors, R(t) = exp(phi(t)) R(0), phi in the fixed axes.

    Between two rotations and from rest it is the shorter turn about a fixed axis. Targets are (n, 3, 3), velocities
    angular, in the fixed axes.

    Args:
        rotations: Start and the rotations to pass, each (3, 3), each less than half a turn from the one before.
        velocity: (3,) angular velocity at the start in the fixed axes [rad/s].
        durations: Times [s] between them.
    """
    start = rotations[0].copy()
    vectors = [np.zeros(3)]
    for rotation in rotations[1:]:
        turn = pin.AngleAxis(rotation @ start.T)  # near half a turn more precise than pin.log3
        vectors.append(_nearest(turn.angle * turn.axis, vectors[-1]))
    curve = spline(np.array(vectors), velocity, durations)

    def motion(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        phi, rate = curve(times)
        turned = np.array([pin.exp3(vector) for vector in phi]) @ start
        return turned, _angular_velocity(phi, rate)

    return motion


def _nearest(vector: FloatArray, before: FloatArray) -> FloatArray:
    """Return the rotation vector nearest to ``before`` among those of the same rotation."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-9:
        return vector
    turns = np.round((before @ vector / angle - angle) / (2 * np.pi))
    nearest: FloatArray = vector * (1 + 2 * np.pi * turns / angle)
    return nearest


def _angular_velocity(phi: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the (n, 3) angular velocity of exp(phi) in the fixed axes [rad/s], for phi and its rate, each (n, 3)."""
    angle = np.linalg.norm(phi, axis=1, keepdims=True)
    # For smaller angles the closed form loses its digits; the first term of its series is precise enough.
    safe = np.maximum(angle, 1e-4)
    first = np.where(angle > 1e-4, (1 - np.cos(safe)) / safe**2, 0.5)
    second = np.where(angle > 1e-4, (safe - np.sin(safe)) / safe**3, 1 / 6)
    once = np.cross(phi, rate)
    velocity: FloatArray = rate + first * once + second * np.cross(phi, once)
    return velocity
