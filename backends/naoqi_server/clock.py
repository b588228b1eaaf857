"""The clock of the DCM: milliseconds in 32 bits with a sign, which roll over every 49.7 days.

The driver's ``naoqi.clock`` has the same arithmetic, apart on purpose: shared, no test would see a mistake in it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

SPAN = 1 << 32
"""[ms] after which the clock shows the same again."""

_HALF = SPAN >> 1


def wrapped(milliseconds: int) -> int:
    """Any count of milliseconds as the clock shows it: -2^31 to 2^31 - 1."""
    return (milliseconds + _HALF) % SPAN - _HALF


def unwrapped(shown: int, near: int) -> int:
    """The count of milliseconds that the clock shows as ``shown``, at most 2^31 ms from ``near``."""
    return near + wrapped(shown - near)


@dataclass(frozen=True, kw_only=True, slots=True)
class DcmClock:
    """Counts milliseconds from ``origin`` on, beginning when the monotonic clock shows ``begin`` [ns].

    The count does not roll over; what the robot shows of it does. All processes of one machine share the monotonic
    clock, so each can tell the robot's time without asking.
    """

    begin: int
    origin: int

    @property
    def count(self) -> int:
        """Milliseconds now."""
        return self.origin + (time.monotonic_ns() - self.begin) // 1_000_000

    @property
    def shown(self) -> int:
        """What the robot's clock shows now."""
        return wrapped(self.count)
