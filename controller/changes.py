"""Changes from any thread between two ticks, alone or as a group."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from pepper_driver.controller.errors import ChangesError

Change = Callable[[], None]
"""It must be quick: the next tick waits for it."""

GIVE_WAY_TIME = 20e-6
"""[s] between two checks whether other threads have made their changes."""

MAX_GIVE_WAY_TIME = 1e-3
"""[s] Longest delay of a tick by threads that make one change after the other."""


class Changes:
    """Changes under one lock, which a tick holds from its beginning to its end, and a change while it is made.

    The lock is re-entrant: inside a tick, its own thread makes changes at once. The changes of a thread inside
    :meth:`together` wait until the block ends, and the thread cannot tick before that.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._waiting: deque[None] = (
            deque()
        )  # one for each thread that makes a change or waits for it
        self._thread = _Thread()

    def tick(self) -> AbstractContextManager[bool]:
        """Return the lock: ``with changes.tick():`` keeps every other thread's changes out of the block.

        Raises:
            ChangesError: The calling thread is inside ``with changes.together()``.
        """
        if self._thread.group is not None:
            raise ChangesError(
                "the robot cannot run inside a group of changes: end the block first"
            )
        return self._lock

    def make(self, change: Change) -> None:
        """Make a change between two ticks: at once, or as soon as the tick of another thread is over.

        Inside :meth:`together` the change waits for the end of the block, and so does what it raises. Check values
        before.
        """
        group = self._thread.group
        if group is not None:
            group.append(change)
            return
        # Append and pop of a deque are atomic, so no second lock is required.
        self._waiting.append(None)
        try:
            with self._lock:
                change()
        finally:
            self._waiting.pop()

    def give_way(self) -> None:
        """Let threads with waiting changes go first: a lock is not fair, and ticks without a pause would keep it."""
        end = time.perf_counter() + MAX_GIVE_WAY_TIME
        while self._waiting and time.perf_counter() < end:
            time.sleep(GIVE_WAY_TIME)

    @contextmanager
    def together(self) -> Iterator[None]:
        """Collect the changes of the calling thread, and make them between the same two ticks at the end of the block.

        Changes are made in their order. If the block raises, none is made. A block inside another one joins it. If a
        change is refused at the end, the others are still made, and the first refusal is raised.
        """
        thread, group = self._thread, list[Change]()
        outer, thread.group = thread.group, group
        try:
            yield
        finally:
            thread.group = outer

        def change_all() -> None:
            refused: Exception | None = None
            for change in group:
                try:
                    change()
                except Exception as error:
                    refused = refused or error
            if refused is not None:
                raise refused

        self.make(change_all)  # a part of the outer block's, where there is one


class _Thread(threading.local):
    """State of one thread: the group that it collects, or None."""

    group: list[Change] | None = None
