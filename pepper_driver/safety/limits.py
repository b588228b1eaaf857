"""Limits of single joints on what is sent: position, speed and acceleration of one command after the other.

With s the step of a command from the one before it and A the largest change of that step (acceleration times cycle
squared), a joint that brakes takes the steps s - A, s - 2 A, ... to rest. Of the room D to its limit it needs

    T(s) = n s - A n (n - 1) / 2,   n = ceil(s / A),

so that the largest step it may take is, with n = ceil((sqrt(1 + 8 D / A) - 1) / 2),

    s(D) = D / n + A (n - 1) / 2.

After a step with T(s) <= D the next one can be s - A: T(s - A) = T(s) - s <= D - s. A command inside these limits
therefore always has a successor inside them, whatever is asked for.
"""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray

ROUNDING = 1e-9
"""[rad] A reference may lie this far beyond a limit: what rounding does."""


class JointLimits:
    """What n joints may be told next, after what they were told last.

    Args:
        lower, upper: (n,) position limits [rad].
        speed: (n,) limits [rad/s].
        acceleration: (n,) limits [rad/s2].
        cycle: Time between two commands [s].

    Attributes:
        position: (n,) last command [rad]; replaced, never changed in place.
    """

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        speed: FloatArray,
        acceleration: FloatArray,
        cycle: float,
    ) -> None:
        n = len(lower)
        self._n = n
        self._lower, self._upper = lower, upper
        self._largest_step = speed * cycle
        self._largest_change = acceleration * cycle**2
        self._half_inverse = 0.5 / self._largest_change
        # Of the change of the step, then of the step: one comparison serves both.
        self._most = np.concatenate([self._largest_change, self._largest_step]) + ROUNDING
        self._sizes = np.zeros(2 * n)
        self._kept = np.zeros(2 * n, dtype=np.bool_)
        self._step, self._rest = np.zeros(n), np.zeros(n)
        self._change, self._size = self._sizes[:n], self._sizes[n:]
        self._low_kept, self._high_kept = self._kept[:n], self._kept[n:]
        self.start(np.zeros(n))

    def start(self, position: FloatArray) -> None:
        """Stand at (n,) positions [rad], or at the limits they are beyond."""
        self.position = np.clip(position, self._lower, self._upper)
        self._last_step = np.zeros(self._n)

    def keep(self, wanted: FloatArray) -> bool:
        """Whether (n,) wanted positions [rad] are surely within all limits; they are then the last command.

        Some that are within may be taken for outside near position limits; NaN never passes.
        """
        step, rest, every = self._step, self._rest, 2 * self._n
        np.subtract(wanted, self.position, step)
        np.subtract(step, self._last_step, self._change)
        np.abs(self._change, self._change)
        np.abs(step, self._size)
        np.less_equal(self._sizes, self._most, self._kept)
        if np.count_nonzero(self._kept) != every:
            return False
        # Where braking ends, no less far out than in truth: s^2 / (2 A) >= T(s) - s.
        np.multiply(step, self._size, rest)
        rest *= self._half_inverse
        rest += wanted
        np.less_equal(self._lower, rest, self._low_kept)
        np.less_equal(rest, self._upper, self._high_kept)
        if np.count_nonzero(self._kept) != every:
            return False
        self.position = wanted.copy()  # no one else's
        self._step, self._last_step = self._last_step, step
        return True

    def clamp(self, wanted: FloatArray) -> BoolArray:
        """Go as near to (n,) finite positions [rad] as the limits allow; returns (n,) where that is not there."""
        before, last = self.position, self._last_step
        wanted_step = wanted - before
        change = self._largest_change
        low = np.maximum(last - change, -self._largest_step)
        high = np.minimum(last + change, self._largest_step)
        # Position counts most: it is the last to be asked.
        np.minimum(high, _reach(self._upper - before, change), out=high)
        np.maximum(low, -_reach(before - self._lower, change), out=low)
        changed: BoolArray = (wanted_step > high + ROUNDING) | (wanted_step < low - ROUNDING)
        changed |= (wanted < self._lower - ROUNDING) | (wanted > self._upper + ROUNDING)
        sent = np.where(changed, before + np.minimum(np.maximum(wanted_step, low), high), wanted)
        self.position = np.clip(sent, self._lower, self._upper)
        self._last_step = self.position - before
        return changed

    def freeze(self) -> None:
        """The last command stands from now on: joints have no speed any more."""
        self._last_step = np.zeros(self._n)


def _reach(room: FloatArray, change: FloatArray) -> FloatArray:
    """(n,) largest steps towards limits that are ``room`` away, from which joints can still stop: s(D)."""
    room = np.maximum(room, 0.0)
    n = np.maximum(np.ceil((np.sqrt(1.0 + 8.0 * room / change) - 1.0) / 2.0), 1.0)
    reach: FloatArray = room / n + change * (n - 1.0) / 2.0
    return reach
