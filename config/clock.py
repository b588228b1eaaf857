"""Clock: monotonic time and waiting, an argument wherever time decides, so that tests can compute it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Clock:
    """Monotonic time, and waiting for it to pass.

    Attributes:
        now: Returns the time [ns].
        sleep: Waits [s].
    """

    now: Callable[[], int] = time.perf_counter_ns
    sleep: Callable[[float], None] = time.sleep

    def seconds(self) -> float:
        """Return the time [s]."""
        return 1e-9 * self.now()


SYSTEM_CLOCK = Clock()
"""The clock of this computer."""
