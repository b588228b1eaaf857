"""Reference motions of tasks: quintic splines, sampled some cycles ahead and read cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from pepper_driver.config.arrays import FloatArray

Motion = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function from (n,) times [s] to (n, ...) targets, as a task stores them, and (n, rows) velocities."""

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


def spline(points: FloatArray, velocity: FloatArray, durations: Sequence[float]) -> Motion:
    """Return a quintic spline through points.

    It starts with a given velocity, ends at rest, and has no acceleration at either end: between two points and from
    rest, the minimum-jerk motion.

    Args:
        points: (m + 1, n) start and m points to pass.
        velocity: (n,) velocity at the start.
        durations: m times [s] from point to point.
    """
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    still = np.zeros_like(velocity)
    ends: Any = (
        [(1, velocity), (2, still)],
        [(1, still), (2, still)],
    )  # more general than SciPy's types
    curve = make_interp_spline(knots, points, k=5, bc_type=ends)
    rate = curve.derivative()

    def motion(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        return curve(times), rate(times)

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
    start = Rotation.from_matrix(rotations[0])
    vectors = [np.zeros(3)]
    for rotation in rotations[1:]:
        vector = (Rotation.from_matrix(rotation) * start.inv()).as_rotvec()
        vectors.append(_nearest(vector, vectors[-1]))
    curve = spline(np.array(vectors), velocity, durations)

    def motion(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        phi, rate = curve(times)
        return (Rotation.from_rotvec(phi) * start).as_matrix(), _angular_velocity(phi, rate)

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
