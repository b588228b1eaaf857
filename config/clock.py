"""Clock: monotonic time, waiting and threads, an argument wherever time decides, so that tests can compute it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

POLL_PERIOD = 0.005
"""[s] between two checks of a condition."""


def start_thread(target: Callable[[], None], name: str) -> None:
    """Start a daemon thread."""
    threading.Thread(target=target, name=name, daemon=True).start()


@dataclass(frozen=True)
class Clock:
    """Monotonic time, waiting for it to pass, and threads that wait by it.

    Attributes:
        now: Returns the time [ns].
        sleep: Waits [s].
        start: Starts a daemon thread: ``start(target, name)``.
    """

    now: Callable[[], int] = time.perf_counter_ns
    sleep: Callable[[float], None] = time.sleep
    start: Callable[[Callable[[], None], str], None] = start_thread

    def seconds(self) -> float:
        """Return the time [s]."""
        return 1e-9 * self.now()

    def wait_for(self, condition: Callable[[], bool], timeout: float = math.inf) -> bool:
        """Wait until a condition holds, at most ``timeout`` [s]; return True if it does."""
        end = self.seconds() + timeout
        while not condition():
            left = end - self.seconds()
            if left <= 0:
                return False
            self.sleep(min(left, POLL_PERIOD))
        return True


SYSTEM_CLOCK = Clock()
"""The clock of this computer."""

MONOTONIC_CLOCK = Clock(now=time.monotonic_ns)
"""The same for all processes of a machine."""
