"""Where the robot is on its way to rest, after some cycles of braking or all.

Each joint brakes as the box allows, from the end of this cycle on, and those that move fast brake longest: the way to
rest is curved. A limit kept at its end alone can be broken on the way. After n more cycles a joint that enters them
with v+ has gone, with t = n dt or the time it takes to stop, whichever is less,

    s(v+) = sign(v+) (|v+| t - b (t^2 - dt^2) / 2),

which for n without end is the stopping distance of ``braking.py``. It is linearised in the acceleration of this cycle
about the velocity now: s is convex on each side, so that falls short by at most (a dt)^2 / (2 b), a millimetre or a
milliradian; margins are wider.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import FloatArray


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
