"""Ways to come to rest before a limit: braking distance, braking path, velocity damper.

With d the distance to the limit now, v+ the velocity after this cycle and b the deceleration, the distance after this
cycle is d+ = d - (v + v+) dt / 2, and it must leave room

    to stop,          v+^2 / (2 b) <= d+ - b dt^2 / 2    where v+ is above b dt,
    to arrive,        v+ dt <= d+                        below.

The two meet at v+ = b dt with one tangent. Solved for v+, with w = (d - v dt / 2) / (1.5 dt):

    v+ <= w  for w <= b dt,   v+ <= sqrt(3 b dt w - 3/4 (b dt)^2) - b dt / 2  above.

The stopping distance alone, with no room to arrive, asks for v+ = 2 d / dt - v close to the limit: the velocity turns
round in every cycle for as long as a task pulls beyond the limit. With it the velocity goes down to a third in each
cycle, and v <= sqrt(2 b d) stays true. The velocity damper of older controllers (``damper.py``) lets joints as fast as
Pepper's run past their limits at 12 ms.

Each joint brakes as the box allows, from the end of this cycle on, and those that move fast brake longest: the way to
rest is curved. A limit kept at its end alone can be broken on the way. After n more cycles a joint that enters them
with v+ has gone, with t = n dt or the time it takes to stop, whichever is less,

    s(v+) = sign(v+) (|v+| t - b (t^2 - dt^2) / 2),

which for n without end is the stopping distance of ``braking.py``. It is linearised in the acceleration of this cycle
about the velocity now: s is convex on each side, so that falls short by at most (a dt)^2 / (2 b), a millimetre or a
milliradian; margins are wider.

With d the distance to a limit, d_i = 0.1 and d_s = 0.01 of the range and xi_off = 0.5 1/s (mc_pepper's values): where
d < d_i, the velocity towards the limit after this cycle is at most xi (d - d_s) / (d_i - d_s), with xi frozen when the
joint enters that zone at speed |v|: xi = |(d_i - d_s) / (d - d_s) v| + xi_off (jrl-umi3218/tasks, QPConstr.h).

At 12 ms this is not safe at the speeds of Pepper's URDF: a joint can cross the zone in one cycle, and the discrete gain
exceeds 1. It is here for parity; ``braking.py`` is the default. One thing differs from those controllers: it asks for
no more than the velocity limit, else a joint thrown over its limit comes back faster each time, without end.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray

BRAKE_RATIO = 0.9
"""Of the acceleration limit: the braking distance is computed with it."""


class BrakingDistance:
    """Highest velocities towards position limits from which joints can still stop.

    A joint that starts beyond a limit is brought back at b dt / 2, a few hundredths of a radian a second.

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
        self._least = 2.25 * step**2
        # w of both sides, then 3 b dt w - 3/4 (b dt)^2 of both, linear in (position, velocity): one product for all.
        distance, velocity = 1 / (1.5 * dt) * np.eye(n), np.eye(n) / 3
        w = np.block([[-distance, -velocity], [distance, velocity]])
        constant = np.concatenate([upper, -lower]) / (1.5 * dt)
        self._matrix = np.concatenate([w, 3 * step[:, None] * w])
        self._constant = np.concatenate([constant, 3 * step * constant - 0.75 * step**2])
        self._result = np.zeros(4 * n)
        self._w, self._stop = self._result[: 2 * n], self._result[2 * n :]

    def max_velocity(self, state: FloatArray) -> FloatArray:
        """(2 n,) velocity after this cycle towards the upper, then towards the lower limits [rad/s].

        Args:
            state: (2 n,) positions [rad], then velocities [rad/s].
        """
        w, stop, floor = self._w, self._stop, self._floor
        self._matrix.dot(state, self._result)
        self._result += self._constant
        np.maximum(stop, self._least, out=stop)
        np.sqrt(stop, stop)
        stop += floor
        np.minimum(w, stop, out=stop)
        np.maximum(stop, floor, out=stop)
        return stop


class BrakingPath:
    """One place on the way to rest.

    Args:
        brake: (n,) deceleration [m/s2], [rad/s2].
        dt: Cycle [s].
        cycles: After how many cycles of braking, one at least; infinity for rest.

    Attributes:
        way: (n,) from here to that place when the velocity stays as it is in this cycle [m], [rad].
        gain: (n,) by how much an acceleration in this cycle changes it [s2].
    """

    def __init__(self, brake: FloatArray, dt: float, cycles: float) -> None:
        n = len(brake)
        # Arrays all of one shape: NumPy is quickest with them.
        self._dt, self._longest = np.full(n, dt), np.full(n, cycles * dt)
        self._half, self._inverse = brake / 2, 1 / brake
        self._shift = self._half * dt**2
        self._first = np.full(n, dt**2 / 2)
        self._speed, self._time = np.zeros(n), np.zeros(n)
        self.way, self.gain = np.zeros(n), np.zeros(n)

    def update(self, velocity: FloatArray) -> None:
        """Compute way and gain for (n,) velocities at the start of the cycle."""
        speed, time, way, gain, dt = self._speed, self._time, self.way, self.gain, self._dt
        np.abs(velocity, speed)
        np.multiply(speed, self._inverse, time)
        np.maximum(time, dt, out=time)
        np.minimum(time, self._longest, out=time)
        np.multiply(self._half, time, way)
        np.subtract(speed, way, way)
        way *= time
        way += self._shift
        np.copysign(way, velocity, way)
        np.multiply(velocity, dt, speed)
        way += speed
        np.multiply(time, dt, gain)
        gain += self._first

    @property
    def longest(self) -> float:
        """For how long the joint that brakes longest does so, as far as that place [s]."""
        return float(self._time.max())


INTERACTION_SHARE, SECURITY_SHARE = 0.1, 0.01
"""Of a joint's range: where damping begins, and where the velocity towards the limit is to be zero."""

OFFSET = 0.5
"""[rad/s] xi_off."""


class VelocityDamper:
    """Highest velocities towards position limits by the damper.

    Args:
        lower: (n,) limits [rad].
        upper: (n,) limits [rad].
        speed: (n,) velocity limits [rad/s].
    """

    def __init__(self, lower: FloatArray, upper: FloatArray, speed: FloatArray) -> None:
        self._lower, self._upper, self._least = lower, upper, -speed
        self._interaction = INTERACTION_SHARE * (upper - lower)
        self._security = SECURITY_SHARE * (upper - lower)
        self._width = self._interaction - self._security
        self._xi = np.zeros((2, len(lower)))  # 0 outside the zone

    def max_velocity(self, state: FloatArray) -> FloatArray:
        """(2 n,) velocity after this cycle towards the upper, then towards the lower limits [rad/s].

        Args:
            state: (2 n,) positions [rad], then velocities [rad/s].
        """
        position, velocity = state[: len(self._lower)], state[len(self._lower) :]
        distance = np.stack([self._upper - position, position - self._lower])
        inside = distance < self._interaction
        entered = inside & (self._xi == 0.0)
        beyond = distance - self._security
        # Entered at or behind the security distance: xi as a fifth of the way into the zone.
        ahead = np.where(beyond > 0, beyond, 0.2 * self._width)
        xi = np.abs(self._width / ahead * velocity) + OFFSET
        self._xi = np.where(inside, np.where(entered, xi, self._xi), 0.0)
        limit = np.where(inside, self._xi * beyond / self._width, np.inf)
        np.maximum(limit, self._least, out=limit)
        return limit.ravel()
