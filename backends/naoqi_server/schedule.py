"""Faults that somebody has to begin and to end at their times."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import RLock, Timer

from pepper_driver.backends.naoqi_server.faults import Fault
from pepper_driver.config import PepperError

logger = logging.getLogger("pepper_driver")


@dataclass(eq=False)
class _Entry:
    end: Callable[[], None]
    timers: list[Timer] = field(default_factory=list)
    begun: bool = False


class Schedule:
    """Begins each fault ``after`` some time, at once where that is 0, and ends it after its ``seconds``.

    One takes the place of another of the same name and the same texts, which ends. Safe to use from several threads.
    """

    def __init__(self) -> None:
        self._lock = RLock()
        self._entries: dict[tuple[str, ...], _Entry] = {}

    def set(self, fault: Fault, begin: Callable[[], None], end: Callable[[], None]) -> None:
        """Let a fault happen.

        Raises:
            PepperError: What ``begin`` raises, where that is called at once. Later it is only logged.
        """
        with self._lock:
            self._finish(fault.identity)
            entry = self._entries[fault.identity] = _Entry(end)
            if fault.after == 0.0:
                self._begin(entry, begin)
            else:
                self._later(entry, fault.after, lambda: self._begin(entry, begin))
            if math.isfinite(fault.seconds):
                at = fault.after + fault.seconds
                self._later(entry, at, lambda: self._finish(fault.identity))

    def clear(self) -> None:
        """End all that have begun; the others never begin."""
        with self._lock:
            for identity in list(self._entries):
                self._finish(identity)

    def close(self) -> None:
        """Leave everything as it is: nothing begins or ends any more."""
        with self._lock:
            for entry in self._entries.values():
                _cancel(entry)
            self._entries.clear()

    def _begin(self, entry: _Entry, begin: Callable[[], None]) -> None:
        begin()
        entry.begun = True

    def _finish(self, identity: tuple[str, ...]) -> None:
        entry = self._entries.pop(identity, None)
        if entry is not None:
            _cancel(entry)
            if entry.begun:
                entry.end()

    def _later(self, entry: _Entry, seconds: float, action: Callable[[], None]) -> None:
        def act() -> None:
            with self._lock:
                if timer not in entry.timers:
                    return  # cancelled while it waited for the lock
                try:
                    action()
                except PepperError as error:
                    logger.error("%s", error)

        timer = Timer(seconds, act)
        timer.daemon = True
        entry.timers.append(timer)
        timer.start()


def _cancel(entry: _Entry) -> None:
    for timer in entry.timers:
        timer.cancel()
    entry.timers.clear()
