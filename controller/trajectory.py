"""Reference motions of tasks: quintic splines, sampled once, then read off cycle by cycle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]


class Trajectory:
    """Targets with velocities and accelerations, one of each for every cycle to come.

    Args:
        targets: (n, ...) as the task keeps them.
        velocities: (n, rows).
        accelerations: (n, rows).
    """

    def __init__(
        self, targets: FloatArray, velocities: FloatArray, accelerations: FloatArray
    ) -> None:
        self._samples = (targets, velocities, accelerations)
        self._next = 0

    def next(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Target, velocity and acceleration of the next cycle; None when the motion is over."""
        index = self._next
        targets, velocities, accelerations = self._samples
        if index == len(targets):
            return None
        self._next += 1
        return targets[index], velocities[index], accelerations[index]


def spline(
    points: FloatArray, velocity: FloatArray, durations: Sequence[float], dt: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A quintic spline through points, sampled every ``dt`` [s] from one cycle after its start to its end.

    It starts with a given velocity, ends at rest, and has no acceleration at either end: between two points and from
    rest, the motion of least jerk.

    Args:
        points: (m + 1, n) start and m points to pass.
        velocity: (n,) at the start.
        durations: m times [s] from point to point.
        dt: Cycle [s].

    Returns:
        Positions, velocities, accelerations, each (samples, n); the last sample is the last point at rest.
    """
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    still = np.zeros_like(velocity)
    ends: Any = ([(1, velocity), (2, still)], [(1, still), (2, still)])  # SciPy's types know less
    curve = make_interp_spline(knots, points, k=5, bc_type=ends)
    samples = max(1, round(knots[-1] / dt))
    times = np.minimum(np.arange(1, samples + 1) * dt, knots[-1])
    times[-1] = knots[-1]
    return curve(times), curve(times, 1), curve(times, 2)


def vector_trajectory(
    points: FloatArray, velocity: FloatArray, durations: Sequence[float], dt: float
) -> Trajectory:
    """Trajectory of a task whose target is a vector; arguments as for :func:`spline`."""
    return Trajectory(*spline(points, velocity, durations, dt))


def rotation_samples(
    rotations: Sequence[FloatArray], velocity: FloatArray, durations: Sequence[float], dt: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotations along a spline of rotation vectors, R(t) = exp(phi(t)) R(0), phi in the fixed axes.

    Between two rotations and from rest it is the shortest way about a fixed axis.

    Args:
        rotations: Start and the rotations to pass, each (3, 3), none half a turn or more from the start.
        velocity: (3,) angular velocity at the start in the fixed axes [rad/s].
        durations: Times [s] between them.
        dt: Cycle [s].

    Returns:
        Rotations (n, 3, 3), angular velocities (n, 3) [rad/s] and accelerations (n, 3) [rad/s2] in the fixed axes.
    """
    start = Rotation.from_matrix(rotations[0])
    vectors = np.array([(Rotation.from_matrix(r) * start.inv()).as_rotvec() for r in rotations])
    phi, rate, _ = spline(vectors, velocity, durations, dt)
    matrices = (Rotation.from_rotvec(phi) * start).as_matrix()
    angular = _left_jacobian_times(phi, rate)
    padded = np.concatenate([velocity[None], angular, np.zeros((1, 3))])
    return matrices, angular, (padded[2:] - padded[:-2]) / (2 * dt)


def _left_jacobian_times(phi: FloatArray, rate: FloatArray) -> FloatArray:
    """(n, 3) angular velocity of exp(phi) in the fixed axes, for phi and its rate, each (n, 3)."""
    angle = np.linalg.norm(phi, axis=1, keepdims=True)
    safe = np.maximum(angle, 1e-4)
    first = np.where(angle > 1e-4, (1 - np.cos(safe)) / safe**2, 0.5)
    second = np.where(angle > 1e-4, (safe - np.sin(safe)) / safe**3, 1 / 6)
    once = np.cross(phi, rate)
    result: FloatArray = rate + first * once + second * np.cross(phi, once)
    return result
