"""Jobs in worker processes that end with this one, however it ends."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from typing import TypeVar

from joblib import Parallel, delayed

T = TypeVar("T")

WATCH_PERIOD = 0.5
"""[s] between two looks of a worker at whether the process that started it is still there."""


def run_jobs(
    jobs: Iterable[Callable[[], T]], *, workers: int = -1, ordered: bool = True
) -> Iterator[T]:
    """Yield the results of jobs that run in parallel. Once nobody takes them any more, the jobs end too.

    Args:
        jobs: Functions that can be sent to another process, such as a ``functools.partial`` of one of a module.
        workers: Processes; -1 for one per core, 1 for this process itself.
        ordered: Results in the order of the jobs, and not as they come.
    """
    pool = Parallel(
        n_jobs=workers,
        return_as="generator" if ordered else "generator_unordered",
        batch_size=1,  # jobs take seconds
        initializer=end_with,
        initargs=(os.getpid(),),
    )
    results: Generator[T] | None = None
    with warnings.catch_warnings():
        # Of workers replaced while jobs are long, and of results that nobody takes: nothing a user could act on.
        for message in ("A worker stopped", ".* adjusting the input task"):
            warnings.filterwarnings("ignore", message=message, category=UserWarning)
        try:
            with _deaf_processes():
                results = pool(delayed(job)() for job in jobs)
            yield from results
        finally:
            if results is not None:
                results.close()


@contextmanager
def _deaf_processes() -> Iterator[None]:
    """Let processes that start here not hear Ctrl-C, not even while they import; it is not lost to this one."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # which unblocks signals where it has to be started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with(parent: int) -> None:
    """Let this process, a worker, end soon after the process that started it; Ctrl-C is for that one alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=partial(_watch, parent), name="parent", daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_PERIOD)
    os._exit(1)  # whatever it computes is for nobody
