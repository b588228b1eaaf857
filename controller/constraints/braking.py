"""Laws of rest before a limit: braking distance, braking path, velocity damper.

With d the distance to the limit now, v+ the velocity after this cycle and b the deceleration, the distance after this
cycle is d+ = d - (v + v+) dt / 2, and it must be enough

    to stop,          v+^2 / (2 b) <= d+ - b dt^2 / 2    where v+ is above b dt,
    to arrive,        v+ dt <= d+                        below.

The two meet at v+ = b dt with one tangent. Solved for v+, with w = (d - v dt / 2) / (1.5 dt):

    v+ <= w  for w <= b dt,   v+ <= sqrt(3 b dt w - 3/4 (b dt)^2) - b dt / 2  above.

The stopping distance alone gives v+ = 2 d / dt - v close to the limit: the velocity would change its sign in every
cycle while a task pulls beyond the limit. With the second condition the velocity falls to a third in each cycle, and
v <= sqrt(2 b d) stays true. With the velocity damper of older controllers, joints as fast as those of Pepper exceed
their limits at 12 ms.

Braking path. Each joint brakes as its bounds allow, from the end of this cycle on, and fast joints brake longest: the
path to rest is curved. A limit that holds at its end may be violated before. A joint that enters the next n cycles with
v+ moves, with t = n dt or its time to stop, whichever is less, by

    s(v+) = sign(v+) (|v+| t - b (t^2 - dt^2) / 2),

which for infinite n is the stopping distance above. It is linearised in the acceleration of this cycle about the
present velocity. s is convex on each side, so the error is at most (a dt)^2 / (2 b), a millimetre or a milliradian;
margins are wider.

Velocity damper. d is the distance to a limit, d_i = 0.1 and d_s = 0.01 of the range, xi_off = 0.5 1/s (values of
mc_pepper). For d < d_i, the velocity towards the limit after this cycle is at most xi (d - d_s) / (d_i - d_s). xi is
frozen when the joint enters that zone at speed |v|: xi = |(d_i - d_s) / (d - d_s) v| + xi_off (jrl-umi3218/tasks,
QPConstr.h).

At 12 ms this is not safe at the speeds of Pepper's URDF: a joint can cross the zone in one cycle, and the discrete gain
exceeds 1. It exists for comparison; the braking distance is the default. One thing differs from those controllers: the
velocity back is at most the velocity limit. Otherwise a joint beyond its limit would oscillate with growing amplitude.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records

BRAKE_RATIO = 0.9
"""Fraction of the acceleration limit with which the braking distance is computed."""


class PositionLimit:
    """Position limits of one joint, and how hard it brakes.

    Attributes:
        lower: [rad].
        upper: [rad].
        brake: b [rad/s2].
    """

    lower: float
    upper: float
    brake: float


@kernel
def _speed_to_rest(distance: float, velocity: float, brake: float, dt: float) -> float:
    """Return the largest v+ towards a limit at a distance [rad], for the velocity towards it [rad/s]."""
    w = (distance - velocity * dt / 2) / (1.5 * dt)
    step = brake * dt
    stop = np.sqrt(max(3 * step * w - 0.75 * step**2, 2.25 * step**2)) - step / 2
    speed: float = np.maximum(np.minimum(w, stop), -step / 2)
    return speed


@kernel
def _braking_speeds(
    position: FloatArray,
    velocity: FloatArray,
    limits: Records[PositionLimit],
    dt: float,
    towards: Out[Matrix[FloatArray]],
) -> None:
    for i in range(len(limits)):
        limit, q, v = limits[i], position[i], velocity[i]
        towards[0, i] = _speed_to_rest(limit.upper - q, v, limit.brake, dt)
        towards[1, i] = _speed_to_rest(q - limit.lower, -v, limit.brake, dt)


class BrakingDistance:
    """Largest velocities towards position limits from which joints can still stop.

    A joint that starts beyond a limit returns at b dt / 2, a few hundredths of a radian per second.

    Args:
        lower: (n,) limits [rad].
        upper: (n,) limits [rad].
        acceleration: (n,) acceleration limits [rad/s2].
        dt: Cycle [s].
    """

    def __init__(
        self, lower: FloatArray, upper: FloatArray, acceleration: FloatArray, dt: float
    ) -> None:
        brake = BRAKE_RATIO * acceleration
        self._limits = make_records(
            PositionLimit, len(lower), lower=lower, upper=upper, brake=brake
        )
        self._dt, self._towards = dt, np.zeros((2, len(lower)))
        self._speeds = _braking_speeds.load()

    def max_velocity(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return (2, n) velocities after this cycle towards the upper, then the lower limits [rad/s].

        Args:
            position: (n,) [rad].
            velocity: (n,) [rad/s].
        """
        self._speeds(position, velocity, self._limits, self._dt, self._towards)
        return self._towards


@kernel
def _braking_path(
    velocity: FloatArray,
    brake: FloatArray,
    dt: float,
    max_time: float,
    distance: Out[FloatArray],
    gain: Out[FloatArray],
) -> float:
    """Write s(v+) and its change per acceleration about v+ = v; return the longest time until that point [s]."""
    longest = 0.0
    for i in range(len(velocity)):
        v, b = velocity[i], brake[i]
        time = np.minimum(np.maximum(abs(v) / b, dt), max_time)
        braked = (abs(v) - b / 2 * time) * time + b / 2 * dt**2
        distance[i] = v * dt + np.copysign(braked, v)
        gain[i] = dt**2 / 2 + time * dt
        longest = max(longest, time)
    return longest


class BrakingPath:
    """One point of the path to rest.

    Args:
        count: Number of velocities, n.
        cycles: Cycles of braking, one at least; infinity for rest.

    Attributes:
        distance: (n,) distance to that point with the present velocity in this cycle [m], [rad].
        gain: (n,) its change per acceleration in this cycle [s2].
        max_time: Longest braking time of a joint until that point [s].
    """

    def __init__(self, count: int, cycles: float) -> None:
        self._cycles = cycles
        self.distance, self.gain = np.zeros((2, count))
        self.max_time = 0.0
        self._path = _braking_path.load()

    def update(self, velocity: FloatArray, brake: FloatArray, dt: float) -> None:
        """Compute distance and gain.

        Args:
            velocity: (n,) at the start of the cycle [m/s], [rad/s].
            brake: (n,) deceleration [m/s2], [rad/s2].
            dt: Cycle [s].
        """
        self.max_time = self._path(velocity, brake, dt, self._cycles * dt, self.distance, self.gain)


INTERACTION_RATIO, SECURITY_RATIO = 0.1, 0.01
"""Fractions of the range of a joint: distance where damping begins, and distance where the velocity shall be zero."""

XI_OFFSET = 0.5
"""[rad/s] xi_off."""


class DampedLimit:
    """Limits of one joint for the damper.

    Attributes:
        lower: [rad].
        upper: [rad].
        speed: Velocity limit [rad/s].
    """

    lower: float
    upper: float
    speed: float


@kernel
def _damped_speeds(
    position: FloatArray,
    velocity: FloatArray,
    limits: Records[DampedLimit],
    xi: Out[Matrix[FloatArray]],
    towards: Out[Matrix[FloatArray]],
) -> None:
    """Write the largest velocities; xi is 0 outside the zone."""
    for i in range(len(limits)):
        limit = limits[i]
        interaction = INTERACTION_RATIO * (limit.upper - limit.lower)
        security = SECURITY_RATIO * (limit.upper - limit.lower)
        width = interaction - security
        for side in range(2):
            distance = limit.upper - position[i] if side == 0 else position[i] - limit.lower
            if not distance < interaction:
                xi[side, i], towards[side, i] = 0.0, np.inf
                continue
            beyond = distance - security
            if xi[side, i] == 0.0:
                # A joint that enters at or beyond the security distance gets xi as at a fifth of the zone.
                ahead = beyond if beyond > 0 else 0.2 * width
                xi[side, i] = abs(width / ahead * velocity[i]) + XI_OFFSET
            towards[side, i] = np.maximum(xi[side, i] * beyond / width, -limit.speed)


class VelocityDamper:
    """Largest velocities towards position limits by the damper.

    Args:
        lower: (n,) limits [rad].
        upper: (n,) limits [rad].
        speed: (n,) velocity limits [rad/s].
    """

    def __init__(self, lower: FloatArray, upper: FloatArray, speed: FloatArray) -> None:
        self._limits = make_records(DampedLimit, len(lower), lower=lower, upper=upper, speed=speed)
        self._xi, self._towards = np.zeros((2, 2, len(lower)))
        self._speeds = _damped_speeds.load()

    def max_velocity(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return (2, n) velocities after this cycle towards the upper, then the lower limits [rad/s].

        Args:
            position: (n,) [rad].
            velocity: (n,) [rad/s].
        """
        self._speeds(position, velocity, self._limits, self._xi, self._towards)
        return self._towards
