"""Keys of the terminal, read next to the tick: they stop the robot, or the space bar is a switch and q stops it."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, ClassVar, Self

from pepper_driver.config.errors import PepperError

POLL_PERIOD = 0.1
"""[s] between two checks of the stop flag."""


class NoTerminalError(PepperError, RuntimeError):
    """Keys are needed, and standard input is not a terminal."""

    def __init__(self) -> None:
        super().__init__(
            "labels by key need a terminal to press keys in: start it in one, or give another --label, such as head"
        )


class StopKey:
    """The space bar and q stop the robot, read on a thread of their own while the ``with`` block runs.

    Ctrl-C works as ever. Leaving the block restores the terminal. Without a terminal, no key is read.

    >>> with StopKey(pepper.emergency_stop), pepper:
    ...     pepper.run(10.0)

    Args:
        stop: Called with what happened, on the thread that reads, at each press.

    Attributes:
        listening: True if there is a terminal to read.
    """

    HELP = "the space bar or q stops the robot"
    KEYS: ClassVar[tuple[tuple[bytes, str], ...]] = ((b" ", "the space bar"), (b"q", "q"))
    """Keys that stop the robot, and their names."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        self.listening = False
        self._stop_robot = stop
        self._stop = threading.Event()

    def __enter__(self) -> Self:
        try:
            import termios
            import tty
        except ImportError:  # Windows
            return self
        if sys.stdin is None or not sys.stdin.isatty():
            return self
        self._file = sys.stdin.fileno()
        self._settings: list[Any] = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        self.listening = True
        self._thread = threading.Thread(
            target=self._run, name="pepper_driver.recording.terminal_keys", daemon=True
        )
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if not self.listening:
            return
        import termios

        self.listening = False
        self._stop.set()
        self._thread.join()
        with suppress(termios.error):  # a terminal that was closed
            termios.tcsetattr(self._file, termios.TCSADRAIN, self._settings)

    def _take(self, data: bytes) -> None:
        """Handle typed text, on the thread that reads."""
        for key, name in self.KEYS:
            if key in data.lower():
                self._stop_robot(f"{name} was pressed")

    def _run(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._file], [], [], POLL_PERIOD)
            if not ready:
                continue
            try:
                data = os.read(self._file, 1024)
            except OSError:  # the terminal was closed
                return
            if not data:
                return
            self._take(data)


class SpaceBar(StopKey):
    """A switch that each press of the space bar turns; q alone stops the robot.

    Raises:
        NoTerminalError: On entering: standard input is not a terminal.
    """

    HELP = "q stops the robot"
    KEYS = ((b"q", "q"),)

    def __init__(self, stop: Callable[[str], None]) -> None:
        super().__init__(stop)
        self._presses = 0

    @property
    def on(self) -> bool:
        """True if the key was pressed an odd number of times."""
        return self._presses % 2 == 1

    def forget(self) -> None:
        """Turn it off."""
        self._presses = 0

    def __enter__(self) -> Self:
        super().__enter__()
        if not self.listening:
            raise NoTerminalError
        return self

    def _take(self, data: bytes) -> None:
        self._presses += data.count(b" ")
        super()._take(data)
