"""What makes ticks punctual: no garbage collector, a quick interpreter, priority where it is permitted."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

logger = logging.getLogger("pepper_driver")

PRIORITY = 40
"""Of SCHED_FIFO: above all usual threads, below those that serve interrupts (50)."""

SWITCH_INTERVAL = 50e-6
"""[s] after which a thread that computes hands the interpreter to the tick.

Each of the simulation's steps lets go of the interpreter, and so does a sleep; the tick then waits as long as this for
each. With Python's own 5 ms, one computing callback costs two ticks of three; below 20 us, switching costs more.
"""

PYTHONS_OWN = 1000
"""Frozen objects, at most, that are Python's own: 3.12 starts with some hundred. Whoever freezes has thousands."""


@contextmanager
def realtime() -> Iterator[None]:
    """Set up the process, and the thread that enters, for ticks in real time; all is put back at the end.

    The collector of reference cycles leaves alone what is there, and does not run; what came since is collected at the
    end. Threads switch more often. The thread gets real-time priority, or a message says once what permits it. Threads
    that it starts do not inherit that. Blocks may be nested, and entered by several threads.
    """
    _process.enter()
    try:
        before = _raise_priority()
        try:
            yield
        finally:
            if before is not None:
                _set_scheduler(*before)
    finally:
        _process.leave()


class _Process:
    """What all threads share: set by the first block that begins, put back by the last that ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._blocks = 0

    def enter(self) -> None:
        with self._lock:
            self._blocks += 1
            if self._blocks > 1:
                return
            self._switch_interval = sys.getswitchinterval()
            self._collecting = gc.isenabled()
            self._frozen = gc.get_freeze_count() > PYTHONS_OWN  # by the user: stays so
            sys.setswitchinterval(min(SWITCH_INTERVAL, self._switch_interval))
            gc.freeze()
            gc.disable()

    def leave(self) -> None:
        with self._lock:
            self._blocks -= 1
            if self._blocks:
                return
            sys.setswitchinterval(self._switch_interval)
            if self._collecting:
                gc.collect()  # quick: what is frozen is not looked at
                gc.enable()
            if not self._frozen:
                gc.unfreeze()


_process = _Process()
_said: set[str] = set()


def priority_obstacle() -> str:
    """Why this thread cannot have real-time priority, and what permits it; empty when it can."""
    try:
        before = _try_to_raise()
    except _RefusedError as error:
        return str(error)
    if before is not None:
        _set_scheduler(*before)
    return ""


class _RefusedError(Exception):
    """The system gives no real-time priority, for the reason given."""


def _raise_priority() -> tuple[int, int] | None:
    """Give this thread real-time priority; returns scheduler and priority before, None where nothing has changed."""
    try:
        return _try_to_raise()
    except _RefusedError as error:
        _say(str(error))
        return None


def _try_to_raise() -> tuple[int, int] | None:
    if not hasattr(os, "sched_setscheduler"):
        raise _RefusedError("this system knows no real-time priority")
    before, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    if before & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
        return None  # given from outside, such as by chrt
    try:
        _set_scheduler(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, PRIORITY)
    except OSError as error:  # a container may refuse with other errors than PermissionError
        raise _RefusedError(
            "real-time priority is not permitted; a line like '@realtime - rtprio 50' in "
            "/etc/security/limits.d/pepper.conf permits it to the group realtime"
        ) from error
    return before, priority


def _set_scheduler(scheduler: int, priority: int) -> None:
    """Of this thread; 0 is the thread that calls."""
    try:
        os.sched_setscheduler(0, scheduler, os.sched_param(priority))
    except PermissionError:
        if scheduler & os.SCHED_RESET_ON_FORK:
            raise
        # Only root may take this flag away again; without a priority above others it means nothing.
        scheduler |= os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, scheduler, os.sched_param(priority))


def _say(what: str) -> None:
    """Once in the life of the process."""
    if what not in _said:
        _said.add(what)
        logger.warning("ticks run at normal priority and may come late: %s", what)
