"""Position limits kept by the velocity damper of the JRL controllers, for comparison with them.

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

    def highest_velocity(self, state: FloatArray) -> FloatArray:
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
