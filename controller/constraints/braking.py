"""Position limits kept by braking distance.

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
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray

BRAKE_SHARE = 0.9
"""Of the acceleration limit: what the braking distance is reckoned with."""


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
        step = np.tile(BRAKE_SHARE * acceleration * dt, 2)  # b dt, for both sides
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

    def highest_velocity(self, state: FloatArray) -> FloatArray:
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
