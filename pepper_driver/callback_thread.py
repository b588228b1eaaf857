"""One user callback with its own queue and its own thread: slow or broken, it harms only itself."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pepper_driver.events import Event
from pepper_driver.queue_thread import QueueThread

logger = logging.getLogger("pepper_driver")


@dataclass(frozen=True, kw_only=True)
class CallbackStatistics:
    """What one callback has cost and lost so far.

    Attributes:
        name: Its qualified name.
        calls: How often it was called.
        failures: How many of these calls raised.
        dropped: Events it will never see: too many waited for it, or it was closed before it came to them.
        total_time: Time spent in it [s].
        longest_time: Longest single call [s].
    """

    name: str
    calls: int
    failures: int
    dropped: int
    total_time: float
    longest_time: float


class CallbackThread(QueueThread[Event]):
    """Calls one callback, one event after the other.

    Args:
        callback: Takes an event.

    Attributes:
        callback: The same.
    """

    def __init__(self, callback: Callable[[Any], object]) -> None:
        self.callback = callback
        self._name = getattr(callback, "__qualname__", None) or type(callback).__name__
        self._calls = self._failures = self._dropped = 0
        self._total_time = self._longest_time = 0.0
        self._warned = False
        super().__init__(f"callback {self._name}")

    def handle(self, entry: Event) -> None:
        """Call the callback; what it raises goes to the logging."""
        start = time.perf_counter()
        self._calls += 1
        try:
            try:
                self.callback(entry)
            finally:
                elapsed = time.perf_counter() - start
                self._total_time += elapsed
                self._longest_time = max(self._longest_time, elapsed)
        except BaseException:  # SystemExit too: it would end the thread
            self._failures += 1
            logger.exception("callback %s failed", self._name)
        if self._dropped and not self._warned:
            self._warned = True
            logger.warning("callback %s is too slow: it has lost events", self._name)

    def lose(self, entry: Event) -> None:
        """Count an event that it will not see."""
        with self._lock:
            self._dropped += 1

    def statistics(self) -> CallbackStatistics:
        """Counts and times so far."""
        return CallbackStatistics(
            name=self._name,
            calls=self._calls,
            failures=self._failures,
            dropped=self._dropped,
            total_time=self._total_time,
            longest_time=self._longest_time,
        )
