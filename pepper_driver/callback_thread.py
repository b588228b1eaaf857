"""One user callback with its own queue and its own thread: slow or broken, it harms only itself."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from pepper_driver.events import Event

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


class Deadline:
    """One limit for several waits, ``timeout`` [s] from now; None for none."""

    def __init__(self, timeout: float | None) -> None:
        self._end = None if timeout is None else time.monotonic() + timeout

    def remaining(self) -> float | None:
        """[s], not below 0; None for ever."""
        return None if self._end is None else max(0.0, self._end - time.monotonic())


class Mark:
    """Travels through a queue behind the events that somebody waits for.

    Attributes:
        passed: Set when it has left the queue.
        handled: Whether all events before it were handled, and not dropped.
    """

    def __init__(self) -> None:
        self.passed = threading.Event()
        self.handled = False


class CallbackThread:
    """Calls one callback, one event after the other, until it is closed.

    Args:
        callback: Takes an event.

    Attributes:
        callback: The same.
    """

    def __init__(self, callback: Callable[[Any], object]) -> None:
        self.callback = callback
        self._name = getattr(callback, "__qualname__", None) or type(callback).__name__
        # May be used from signal handlers, and costs the publisher less than a condition. None ends the thread.
        self._queue: SimpleQueue[Event | Mark | None] = SimpleQueue()
        self._lock = threading.RLock()  # of those that put in and drop; calls are made without it
        self._accepted = self._taken = self._dropped = 0
        self._closed = self._abandoned = self._warned = False
        self._over = threading.Event()  # nothing more will be handled
        self._calls = self._failures = 0
        self._total_time = self._longest_time = 0.0
        # A daemon: a callback that never returns does not keep the program alive.
        self._thread = threading.Thread(
            target=self._run, name=f"callback {self._name}", daemon=True
        )
        self._thread.start()

    @property
    def current(self) -> bool:
        """Whether the caller is the callback itself."""
        return self._thread is threading.current_thread()

    def put(self, event: Event, limit: int) -> None:
        """Queue an event; drop and count it where ``limit`` wait already, or when closed. Never blocks."""
        with self._lock:
            if self._closed or self._accepted - self._taken >= limit:
                self._dropped += 1
                return
            self._accepted += 1
            self._queue.put(event)

    def mark(self) -> Mark | None:
        """Put a mark behind the events so far; None when closed, where the end of the thread is the mark."""
        with self._lock:
            if self._closed:
                return None
            mark = Mark()
            self._queue.put(mark)
            return mark

    def wait_for(self, mark: Mark | None, deadline: Deadline) -> bool:
        """Whether all before a mark was handled within the time."""
        if mark is None:
            return self._over.wait(deadline.remaining()) and not self._abandoned
        mark.passed.wait(deadline.remaining())
        return mark.handled

    def close(self) -> None:
        """Take no more events; the thread ends behind those that wait."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._queue.put(None)

    def join(self, deadline: Deadline) -> bool:
        """Whether the thread, once closed, has ended within the time; else the events that still wait are dropped."""
        self._thread.join(deadline.remaining())
        if not self._thread.is_alive():
            return True
        with self._lock:
            self._abandoned = True
            with suppress(Empty):
                while True:
                    self._drop(self._queue.get_nowait())
            self._queue.put(None)  # it was among these
        self._over.set()
        return False

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

    def _run(self) -> None:
        while (entry := self._queue.get()) is not None:
            if isinstance(entry, Mark):
                entry.handled = True
                entry.passed.set()
                continue
            self._taken += 1
            if self._abandoned:
                with self._lock:
                    self._drop(entry)
            else:
                self._call(entry)
        self._over.set()

    def _call(self, event: Event) -> None:
        """Call the callback; what it raises goes to the logging."""
        start = time.perf_counter()
        self._calls += 1
        try:
            try:
                self.callback(event)
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

    def _drop(self, entry: Event | Mark | None) -> None:
        if isinstance(entry, Mark):
            entry.passed.set()
        elif entry is not None:
            self._dropped += 1
