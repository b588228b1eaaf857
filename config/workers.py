"""Jobs in worker processes that end with this one, however it ends."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib import import_module
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.parallel import LokyBackend

from pepper_driver.config.cluster import IN_FLIGHT, Cluster, ClusterBackend
from pepper_driver.config.signals import deferred_signals

T = TypeVar("T")

Workers = int | Cluster
"""Processes of this machine that work at the same time, -1 for one per core; or those of a cluster."""

ENDING = [getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]
"""Signals that a terminal, ``timeout`` or systemd sends to a command and to its workers."""

SENDING_TIME = 1.0
"""[s] in which jobs are sent to workers; microseconds unless something is broken."""

QUIET_TRACKER = "ignore:resource_tracker"
"""Option of ``-W``. What a tracker has to clean up after a program that was ended, a user cannot act on."""

WATCH_PERIOD = 0.5
"""[s] between two checks of a worker that the process that started it is alive."""


def run_jobs(
    jobs: Iterable[Callable[[], T]], *, workers: Workers = -1, ordered: bool = True
) -> Iterator[T]:
    """Yield the results of jobs that run in parallel. When the caller stops reading them, the jobs end too.

    Args:
        jobs: Functions that can be sent to another process, such as a ``functools.partial`` of one of a module.
        workers: Processes; -1 for one per core, 1 for this process itself, or a cluster.
        ordered: Results in the order of the jobs, and not as they come.

    Raises:
        LostClusterError: Jobs on a cluster that did not come back.
    """
    pool = Parallel(
        **(_on_cluster(workers) if isinstance(workers, Cluster) else _on_this_machine(workers)),
        return_as="generator" if ordered else "generator_unordered",
        batch_size=1,  # jobs take seconds
    )
    results: Generator[T] | None = None
    with warnings.catch_warnings():
        # Of workers replaced while jobs are long, and of results that are not read: a user cannot act on them.
        for message in ("A worker stopped", ".* adjusting the input task"):
            warnings.filterwarnings("ignore", message=message, category=UserWarning)
        try:
            with nullcontext() if isinstance(workers, Cluster) else _starting():
                results = pool(delayed(job)() for job in jobs)
            with one_core(workers):
                yield from results
        finally:
            if results is not None:
                results.close()


@contextmanager
def one_core(workers: Workers) -> Iterator[None]:
    """Keep linear algebra to one thread where one worker was asked for, which is this process: one core in all.

    The processes of several workers share the cores by joblib's own doing.
    """
    if workers != 1:
        yield
        return
    from threadpoolctl import threadpool_limits

    # It brings an algebra library of its own, which must be there to be limited.
    import_module("scipy.linalg")
    with threadpool_limits(limits=1):
        yield


def _on_this_machine(workers: int) -> dict[str, Any]:
    return {
        "n_jobs": workers,
        "backend": _Backend(),
        "initializer": end_with,
        "initargs": (os.getpid(),),
    }


def _on_cluster(cluster: Cluster) -> dict[str, Any]:
    # More of them may come than are there at the beginning.
    return {"n_jobs": -1, "backend": ClusterBackend(cluster), "pre_dispatch": IN_FLIGHT}


class _Backend(LokyBackend):  # type: ignore[misc]
    """joblib's own, broken off in order: loky's thread fails where workers end while it has jobs to send them."""

    def __init__(self) -> None:
        super().__init__()
        self._submitting = threading.RLock()
        self._unsent: list[Future[object]] = []
        self._ending = False

    def submit(self, func: Callable[..., object], callback: object = None) -> Future[object]:
        """Hand a job to loky's thread, which sends it to a worker; that thread also calls this, after each job."""
        with self._submitting:
            if self._ending:
                return Future()
            future: Future[object] = super().submit(func, callback)
            self._unsent = [other for other in (*self._unsent, future) if not _sent(other)]
            return future

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """End the workers, once they have been sent what was submitted."""
        with deferred_signals():
            with self._submitting:
                self._ending = True
            end = time.monotonic() + SENDING_TIME
            while not all(map(_sent, self._unsent)) and time.monotonic() < end:
                time.sleep(0.001)
            super().abort_everything(ensure_ready)


def _sent(future: Future[object]) -> bool:
    return future.running() or future.done()


@contextmanager
def _starting() -> Iterator[None]:
    """Start processes: an exception meanwhile would leave them running for ever."""
    with deferred_signals(), _deaf_processes():
        yield


@contextmanager
def _deaf_processes() -> Iterator[None]:
    """Block the signals that end this process in processes that start here, also while they import."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    sys.warnoptions.append(QUIET_TRACKER)  # which processes that start here take over
    try:
        for tracker in (resource_tracker, loky_tracker):
            tracker.ensure_running()  # which unblocks some signals where it has to be started
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        yield
    finally:
        sys.warnoptions.remove(QUIET_TRACKER)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with(parent: int) -> None:
    """Make this process, a worker, end soon after the process that started it, which alone handles signals.

    A worker that ended by itself would look like a crash, and a run in it would raise the signal as its result.
    """
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=partial(_watch, parent), name="parent", daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_PERIOD)
    os._exit(1)  # its result has no reader
