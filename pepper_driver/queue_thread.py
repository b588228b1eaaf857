"""A thread that takes what others put into its queue, and can be waited for and closed."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")


class Deadline:
    """One limit for several waits, ``timeout`` [s] from now; None for none."""

    def __init__(self, timeout: float | None) -> None:
        self._end = None if timeout is None else time.monotonic() + timeout

    def remaining(self) -> float | None:
        """[s], not below 0; None for ever."""
        return None if self._end is None else max(0.0, self._end - time.monotonic())


class Mark:
    """Travels through a queue behind the entries that somebody waits for.

    Attributes:
        passed: Set when it has left the queue.
        handled: Whether all entries before it were handled, and not lost.
    """

    def __init__(self) -> None:
        self.passed = threading.Event()
        self.handled = False


class QueueThread(ABC, Generic[T]):
    """Handles one entry after the other until it is closed. Starts at once.

    Args:
        name: Of the thread.
    """

    def __init__(self, name: str) -> None:
        # May be used from signal handlers, and costs those who put less than a condition. None ends the thread.
        self._queue: SimpleQueue[T | Mark | None] = SimpleQueue()
        self._lock = threading.RLock()  # of those who put and lose; entries are handled without it
        self._accepted = self._taken = 0
        self._closed = self._abandoned = False
        self._over = threading.Event()  # nothing more will be handled
        # A daemon: what never returns does not keep the program alive.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @abstractmethod
    def handle(self, entry: T) -> None:
        """Handle an entry, on the thread; must not raise."""

    @abstractmethod
    def lose(self, entry: T) -> None:
        """Count an entry that will not be handled, on any thread."""

    @property
    def current(self) -> bool:
        """Whether the caller is on this thread."""
        return self._thread is threading.current_thread()

    def put(self, entry: T, limit: int) -> None:
        """Queue an entry; lose it where ``limit`` wait already, or when closed. Never blocks."""
        with self._lock:
            if self._closed or self._accepted - self._taken >= limit:
                self.lose(entry)
                return
            self._accepted += 1
            self._queue.put(entry)

    def mark(self) -> Mark | None:
        """Put a mark behind the entries so far; None when closed, where the end of the thread is the mark."""
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
        """Take no more entries; the thread ends behind those that wait."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._queue.put(None)

    def join(self, deadline: Deadline) -> bool:
        """Whether the thread, once closed, has ended within the time; else the entries that still wait are lost."""
        self._thread.join(deadline.remaining())
        if not self._thread.is_alive():
            return True
        with self._lock:
            self._abandoned = True
            with suppress(Empty):
                while True:
                    self._discard(self._queue.get_nowait())
            self._queue.put(None)  # it was among these
        self._over.set()
        return False

    def _run(self) -> None:
        while (entry := self._queue.get()) is not None:
            if isinstance(entry, Mark):
                entry.handled = True
                entry.passed.set()
                continue
            self._taken += 1
            if self._abandoned:
                self.lose(entry)
            else:
                self.handle(entry)
        self._over.set()

    def _discard(self, entry: T | Mark | None) -> None:
        if isinstance(entry, Mark):
            entry.passed.set()
        elif entry is not None:
            self.lose(entry)
