"""Priority of what has to do with ticks: one that begins in time is worth nothing when its messages wait."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

logger = logging.getLogger("pepper_driver")

THREADS = ("EventLoop", "MainEventLoop")
"""How the names of libqi's threads begin, which send and receive."""

PRIORITY = 39
"""Of SCHED_FIFO: just below that of ticks."""


def prefer_messages(prefer: bool) -> None:
    """Give libqi's threads of this process real-time priority, or take it from them, where that is permitted.

    At normal priority they waited up to 50 ms for a processor when other programs kept both busy. Callbacks that a
    program has called by ``qi`` run on them too, and should be short.
    """
    if not Path("/proc/self/task").is_dir():
        return
    for task in Path("/proc/self/task").iterdir():
        try:
            if (task / "comm").read_text().startswith(THREADS):
                scheduler = os.SCHED_FIFO if prefer else os.SCHED_OTHER
                param = os.sched_param(PRIORITY if prefer else 0)
                os.sched_setscheduler(int(task.name), scheduler, param)
        except OSError as error:  # not permitted; or the thread has ended meanwhile
            logger.debug("priority of libqi's thread %s: %s", task.name, error)


@contextmanager
def preferred() -> Iterator[None]:
    """Give this thread real-time priority as well, where that is permitted: what it measures, ticks will find."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (OSError, AttributeError) as error:
        logger.debug("priority of measurements: %s", error)
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)
