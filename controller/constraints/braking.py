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

BRAKE_RATIO = 0.9
"""Fraction of the acceleration limit with which the braking distance is computed."""


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
        n = len(lower)
        step = np.tile(BRAKE_RATIO * acceleration * dt, 2)  # b dt, for both sides
        self._floor = -step / 2
        self._lowest = 2.25 * step**2
        # w of both sides, then 3 b dt w - 3/4 (b dt)^2 of both: linear in (position, velocity), so one product.
        distance, velocity = 1 / (1.5 * dt) * np.eye(n), np.eye(n) / 3
        w = np.block([[-distance, -velocity], [distance, velocity]])
        constant = np.concatenate([upper, -lower]) / (1.5 * dt)
        self._matrix = np.concatenate([w, 3 * step[:, None] * w])
        self._constant = np.concatenate([constant, 3 * step * constant - 0.75 * step**2])
        self._result = np.zeros(4 * n)
        self._w, self._stop = self._result[: 2 * n], self._result[2 * n :]

    def max_velocity(self, state: FloatArray) -> FloatArray:
        """Return (2 n,) velocities after this cycle towards the upper, then the lower limits [rad/s].

        Args:
            state: (2 n,) positions [rad], then velocities [rad/s].
        """
        w, stop, floor = self._w, self._stop, self._floor
        self._matrix.dot(state, self._result)
        self._result += self._constant
        np.maximum(stop, self._lowest, out=stop)
        np.sqrt(stop, stop)
        stop += floor
        np.minimum(w, stop, out=stop)
        np.maximum(stop, floor, out=stop)
        return stop


class BrakingPath:
    """One point of the path to rest.

    Args:
        brake: (n,) deceleration [m/s2], [rad/s2].
        dt: Cycle [s].
        cycles: Cycles of braking, one at least; infinity for rest.

    Attributes:
        distance: (n,) distance to that point with the present velocity in this cycle [m], [rad].
        gain: (n,) its change per acceleration in this cycle [s2].
    """

    def __init__(self, brake: FloatArray, dt: float, cycles: float) -> None:
        n = len(brake)
        # Arrays of one shape: NumPy is fastest with them.
        self._dt, self._max_time = np.full(n, dt), np.full(n, cycles * dt)
        self._half, self._inverse = brake / 2, 1 / brake
        self._shift = self._half * dt**2
        self._first = np.full(n, dt**2 / 2)
        self._speed, self._time = np.zeros(n), np.zeros(n)
        self.distance, self.gain = np.zeros(n), np.zeros(n)

    def update(self, velocity: FloatArray) -> None:
        """Compute distance and gain for (n,) velocities at the start of the cycle."""
        speed, time, distance, gain, dt = (
            self._speed,
            self._time,
            self.distance,
            self.gain,
            self._dt,
        )
        np.abs(velocity, speed)
        np.multiply(speed, self._inverse, time)
        np.maximum(time, dt, out=time)
        np.minimum(time, self._max_time, out=time)
        np.multiply(self._half, time, distance)
        np.subtract(speed, distance, distance)
        distance *= time
        distance += self._shift
        np.copysign(distance, velocity, distance)
        np.multiply(velocity, dt, speed)
        distance += speed
        np.multiply(time, dt, gain)
        gain += self._first

    @property
    def max_time(self) -> float:
        """Longest braking time of a joint until that point [s]."""
        return float(self._time.max())


INTERACTION_RATIO, SECURITY_RATIO = 0.1, 0.01
"""Fractions of the range of a joint: distance where damping begins, and distance where the velocity shall be zero."""

XI_OFFSET = 0.5
"""[rad/s] xi_off."""


class VelocityDamper:
    """Largest velocities towards position limits by the damper.

    Args:
        lower: (n,) limits [rad].
        upper: (n,) limits [rad].
        speed: (n,) velocity limits [rad/s].
    """

    def __init__(self, lower: FloatArray, upper: FloatArray, speed: FloatArray) -> None:
        self._lower, self._upper, self._lowest = lower, upper, -speed
        self._interaction = INTERACTION_RATIO * (upper - lower)
        self._security = SECURITY_RATIO * (upper - lower)
        self._width = self._interaction - self._security
        self._xi = np.zeros((2, len(lower)))  # 0 outside the zone

    def max_velocity(self, state: FloatArray) -> FloatArray:
        """Return (2 n,) velocities after this cycle towards the upper, then the lower limits [rad/s].

        Args:
            state: (2 n,) positions [rad], then velocities [rad/s].
        """
        position, velocity = state[: len(self._lower)], state[len(self._lower) :]
        distance = np.stack([self._upper - position, position - self._lower])
        inside = distance < self._interaction
        entered = inside & (self._xi == 0.0)
        beyond = distance - self._security
        # A joint that enters at or beyond the security distance gets xi as at a fifth of the zone.
        ahead = np.where(beyond > 0, beyond, 0.2 * self._width)
        xi = np.abs(self._width / ahead * velocity) + XI_OFFSET
        self._xi = np.where(inside, np.where(entered, xi, self._xi), 0.0)
        limit = np.where(inside, self._xi * beyond / self._width, np.inf)
        np.maximum(limit, self._lowest, out=limit)
        return limit.ravel()
