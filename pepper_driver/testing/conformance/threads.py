"""Threads that do not know of each other: calls wait, or are refused, and none is left hanging."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from pepper_driver.backends import Backend, Command, CommandError, Measurement, NotConnectedError
from pepper_driver.config import PepperError
from pepper_driver.testing.conformance.driving import LATEST, BackendSuite, cycles, hold

CALL_PERIOD = 0.001
"""[s] Between two calls of a worker: a recording would end too soon otherwise."""


class Worker(threading.Thread):
    """Calls again and again what it is given, until that is refused or it shall stop."""

    def __init__(self, call: Callable[[], object]) -> None:
        super().__init__(daemon=True)
        self._call = call
        self.done = threading.Event()
        self.begun = threading.Event()
        self.calls = 0
        self.error: BaseException | None = None
        self.start()

    def run(self) -> None:
        try:
            while not self.done.is_set():
                self._call()
                self.calls += 1
                self.begun.set()
                self.done.wait(CALL_PERIOD)
        except BaseException as error:
            self.error = error
        self.begun.set()

    def has_made(self, calls: int) -> bool:
        """Wait until it has made so many calls; False where it does not."""
        end = time.monotonic() + LATEST
        while self.calls < calls and self.error is None and time.monotonic() < end:
            time.sleep(CALL_PERIOD)
        return self.calls >= calls

    def end(self) -> None:
        self.done.set()
        self.join(LATEST)
        assert not self.is_alive(), "a call hangs"


def paced(backend: Backend, held: Command) -> Callable[[], Measurement]:
    def exchange() -> Measurement:
        (measurement,) = cycles(backend, held, 1)
        return measurement

    return exchange


def all_at_once(backend: Backend, held: Command) -> None:
    wrong, force = hold(backend.read()), np.array([1.0, 0.0, 0.0])
    wrong.position[:] = np.nan

    def write_wrongly() -> None:
        with pytest.raises(CommandError):
            backend.write(wrong)

    calls = [paced(backend, held), backend.read, lambda: backend.write(held), write_wrongly]
    if "push" in backend.info.capabilities:
        calls.append(lambda: backend.push("LForeArm", force, duration=0.02))
    working = [Worker(call) for call in calls]
    asking = [Worker(backend.request), Worker(lambda: backend.phase_error(0))]
    assert all(worker.has_made(6) for worker in (*asking, *working))
    within(backend.close)
    for worker in working:
        worker.join(LATEST)
        assert not worker.is_alive(), "a call hangs"
        assert isinstance(worker.error, NotConnectedError), worker.error
    for worker in asking:
        worker.end()
        assert worker.error is None, "these are never refused"


def within(call: Callable[[], object]) -> None:
    """Make a call in a thread of its own, so that a test ends even if the call hangs."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(2 * LATEST)
    assert not thread.is_alive(), "it hangs"


class ThreadTests(BackendSuite):
    """Threads that do not know of each other: calls wait, or are refused, and none is left hanging."""

    def test_two_threads_that_read_wait_for_each_other(self, backend: Backend) -> None:
        first = backend.open()
        held = hold(first)
        seen: list[list[int]] = [[], []]
        workers = [
            Worker(lambda ticks=ticks: ticks.append(paced(backend, held)().tick))  # type: ignore[misc]
            for ticks in seen
        ]
        while min(worker.calls for worker in workers) < 40:
            assert all(worker.error is None for worker in workers), (
                workers[0].error or workers[1].error
            )
            threading.Event().wait(0.01)
        for worker in workers:
            worker.end()
            assert worker.error is None
        for ticks in seen:
            assert ticks == sorted(ticks)
        if not backend.real_time:
            both = sorted(seen[0] + seen[1])
            assert both == list(range(both[0], both[0] + len(both))), "each cycle was had once"
            assert both[0] == first.tick + 1

    @pytest.mark.parametrize("active", [False, True])
    def test_it_can_be_closed_while_another_thread_runs_it(
        self, backend: Backend, active: bool
    ) -> None:
        for _ in range(1 if backend.real_time else 5):
            first = backend.open()
            held = hold(backend.activate() if active else first)
            worker = Worker(paced(backend, held))
            assert worker.begun.wait(LATEST)
            within(backend.close)
            worker.join(LATEST)
            assert not worker.is_alive(), "a call hangs"
            assert isinstance(worker.error, NotConnectedError)
            with pytest.raises(NotConnectedError):
                backend.read()
        assert backend.open().tick == first.tick

    def test_it_can_be_closed_while_another_thread_activates(self, backend: Backend) -> None:
        backend.open()
        worker = Worker(backend.activate)
        threading.Event().wait(0.01)
        within(backend.close)
        worker.join(LATEST)
        assert not worker.is_alive()
        assert isinstance(worker.error, PepperError), "the second activation, if not the first"
        with pytest.raises(NotConnectedError):
            backend.activate()

    def test_of_many_that_open_one_does(self, backend: Backend) -> None:
        barrier, errors = threading.Barrier(4), []

        def open_once() -> None:
            barrier.wait()
            try:
                backend.open()
            except PepperError as error:
                errors.append(error)

        threads = [threading.Thread(target=open_once, daemon=True) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(2 * LATEST)
            assert not thread.is_alive()
        assert len(errors) == 3
        assert backend.read().tick >= 0

    @pytest.mark.parametrize("active", [False, True])
    def test_threads_may_read_write_push_and_close_at_once(
        self, backend: Backend, active: bool
    ) -> None:
        """Each call does its work, or is refused as of a closed robot; none hangs, and it can be opened again."""
        for _ in range(1 if backend.real_time else 3):
            first = backend.open()
            all_at_once(backend, hold(backend.activate() if active else first))
        assert backend.open().tick == first.tick

    def test_other_threads_may_ask_and_push_while_it_runs(self, backend: Backend) -> None:
        held = hold(backend.open())
        running = Worker(paced(backend, held))
        calls: list[Callable[[], object]] = [
            lambda: backend.info.capabilities,
            lambda: backend.services.say("hello"),
        ]
        if "push" in backend.info.capabilities:
            calls.append(lambda: backend.push("LForeArm", np.array([1.0, 0, 0]), duration=0.02))
        others = [Worker(call) for call in calls]
        assert running.has_made(6)
        assert all(worker.begun.wait(LATEST) for worker in others)
        for worker in (*others, running):
            worker.end()
            assert worker.error is None
