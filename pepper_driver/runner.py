"""Who runs the robot: one thread at a time, and never from inside a tick."""

from __future__ import annotations

import threading
from types import TracebackType

from pepper_driver.backends import BackendError


class Runner:
    """A context manager around the ticks of a run. Its home is the thread that made it."""

    def __init__(self) -> None:
        self._home = threading.current_thread()
        self._running: threading.Thread | None = None
        self._lock = threading.RLock()

    def check_free(self) -> None:
        """Refuse to run a robot that runs.

        Raises:
            BackendError: Another thread runs it, or this one is inside a tick.
        """
        running = self._running
        if running is threading.current_thread():
            raise BackendError("this is inside a tick: it cannot wait for further ticks")
        if running is not None:
            raise BackendError(
                f"thread '{running.name}' runs the robot already: only one can do so at a time"
            )

    def is_mine(self) -> bool:
        """Whether this thread is the one to run the robot: its home, while no other thread runs it.

        Raises:
            BackendError: This thread is inside a tick.
        """
        running = self._running
        if running is threading.current_thread():
            self.check_free()
        return running is None and self._home is threading.current_thread()

    def __enter__(self) -> None:
        with self._lock:
            self.check_free()
            self._running = threading.current_thread()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._running = None
