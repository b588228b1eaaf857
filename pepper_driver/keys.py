"""The space bar of the terminal, read beside the tick."""

from __future__ import annotations

import os
import select
import sys
import threading
from types import TracebackType
from typing import Any, Self

from pepper_driver.labelling import LabelError

PATIENCE = 0.1
"""[s] between two looks at whether to stop."""

_REFUSAL = "labels by key need a terminal to press keys in: start it in one, or give another --label, such as head"


class SpaceBar:
    """A switch that each press of the space bar turns, read on a thread of its own; Ctrl-C works as ever.

    Use it as a context manager: leaving it gives the terminal back as it was.

    Raises:
        LabelError: On entering: standard input is not a terminal.
    """

    def __init__(self) -> None:
        self._presses = 0
        self._stop = threading.Event()

    @property
    def on(self) -> bool:
        """Whether it was pressed an odd number of times."""
        return self._presses % 2 == 1

    def forget(self) -> None:
        """Turn it off."""
        self._presses = 0

    def __enter__(self) -> Self:
        try:
            import termios
            import tty
        except ImportError as error:  # Windows
            raise LabelError(_REFUSAL) from error
        if sys.stdin is None or not sys.stdin.isatty():
            raise LabelError(_REFUSAL)
        self._file = sys.stdin.fileno()
        self._settings: list[Any] = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        self._thread = threading.Thread(target=self._run, name="pepper_driver.keys", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        import termios

        self._stop.set()
        self._thread.join()
        termios.tcsetattr(self._file, termios.TCSADRAIN, self._settings)

    def _run(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._file], [], [], PATIENCE)
            if not ready:
                continue
            try:
                data = os.read(self._file, 1024)
            except OSError:  # the terminal is gone
                return
            if not data:
                return
            self._presses += data.count(b" ")
