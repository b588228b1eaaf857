"""Sessions on a backend without physics, and a clock that stands until a test lets time pass."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import Backend
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.controller import Tick
from pepper_driver.controller.changes import Changes
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.realtime import Pacer, RealTimePacer
from pepper_driver.reflexes import Reflex, prepare_reflexes
from pepper_driver.robot import Pepper
from pepper_driver.session import Session
from support.waiting import PATIENCE

ROBOT = load_robot()
CYCLE = 12_000_000
"""[ns]"""


class SteppedTime:
    """A clock that moves only when the test says so: threads that sleep by it are woken one by one, in order.

    Attributes:
        now: [ns].
    """

    def __init__(self) -> None:
        self.now = 0
        self._sleepers: dict[threading.Thread, int] = {}  # and when each wakes up
        self._flowing = 0  # blocks
        self._home = threading.current_thread()
        self._changed = threading.Condition()

    def clock(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        """Sleep until the test lets that time pass. When the thread of the test sleeps, time passes."""
        with self._changed:
            thread, end = threading.current_thread(), self.now + round(seconds * 1e9)
            if thread is self._home and not self._flowing:
                self._pass(end)
                return
            self._sleepers[thread] = end
            self._changed.notify_all()
            while self.now < end and not self._flowing:
                assert self._changed.wait(PATIENCE)
            self.now = max(self.now, end)
            del self._sleepers[thread]
            self._changed.notify_all()

    def advance(self, seconds: float) -> None:
        """Let time pass, and all that happens in it happen: threads tick, and sleep again or end."""
        with self._changed:
            self._pass(self.now + round(seconds * 1e9))

    @property
    def sleeping(self) -> bool:
        """True if a thread sleeps."""
        return bool(self._sleepers)

    def wait_for_sleeper(self) -> None:
        """Wait until a thread sleeps."""
        with self._changed:
            assert self._changed.wait_for(lambda: self._sleepers, PATIENCE)

    @contextmanager
    def flowing(self) -> Iterator[None]:
        """Let no thread wait inside this block: time passes as fast as threads sleep."""
        with self._changed:
            self._flowing += 1
            self._changed.notify_all()
        try:
            yield
        finally:
            with self._changed:
                self._flowing -= 1

    def pacer(
        self, cycle: float, backend: Backend, *, clock: Clock = SYSTEM_CLOCK
    ) -> RealTimePacer:
        """A pacer by this clock, which becomes that of the backend."""
        backend.clock = Clock(self.clock, self.sleep)
        return RealTimePacer(cycle, backend, clock=backend.clock)

    def _pass(self, end: int) -> None:
        while due := {at: thread for thread, at in self._sleepers.items() if at <= end}:
            at = min(due)
            self.now = max(self.now, at)
            self._changed.notify_all()
            patience = monotonic() + PATIENCE
            while self._sleepers.get(due[at], at) == at and due[at].is_alive():
                assert monotonic() < patience
                self._changed.wait(0.01)
        self.now = max(self.now, end)


class Scripted(Observer):
    """Detects what a test requests, in ticks; counts them from the start of each run."""

    def __init__(self, script: dict[int, tuple[Contact, ...]] | None = None) -> None:
        self.script = script or {}
        self._tick = 0

    def step(self, tick: Tick) -> Observation:
        self._tick += 1
        nan = np.full(17, np.nan)
        return Observation(
            contacts=self.script.get(self._tick, ()),
            expected=nan,
            residual=nan,
            threshold=nan,
            torque=nan,
            torque_std=nan,
            state=np.zeros(17, dtype=np.int8),
        )

    def reset(self) -> None:
        self._tick = 0

    def describe(self) -> str:
        return "scripted"


def make_session(
    backend: Backend,
    *,
    pacer: Pacer | None = None,
    loop_thread: bool = False,
) -> Session:
    """A session that is not started yet."""
    return Session(
        backend,
        ROBOT,
        load_controller_settings(ROBOT),
        load_safety_settings(),
        dispatcher=Dispatcher(),
        pacer=pacer or Pacer(),
        changes=Changes(),
        metadata=dict,
        loop_thread=loop_thread,
    )


def start(
    session: Session,
    *,
    log: Path | None = None,
    reflexes: tuple[Reflex, ...] = (),
    observer: Observer | None = None,
) -> Session:
    """Start it."""
    session.start(
        observer=lambda: observer,
        reflexes=prepare_reflexes(reflexes, ROBOT),
        parts=(),
        log=log,
    )
    return session


@contextmanager
def active(
    backend: Backend | None = None,
    *,
    time: SteppedTime | None = None,
    loop_thread: bool = False,
    **parts: Any,
) -> Iterator[Session]:
    """A session inside a block, paced by a clock or not, without what the facade does in the end."""
    backend = backend or MockBackend()
    session = make_session(
        backend,
        pacer=None if time is None else time.pacer(ROBOT.cycle, backend),
        loop_thread=loop_thread,
    )
    start(session, **parts)
    try:
        yield session
    finally:
        with nullcontext() if time is None else time.flowing():
            session.close()


def in_thread(function: Callable[[], object], name: str = "another") -> Background:
    """Call a function in a thread of its own."""
    return Background(function, name)


class Background(threading.Thread):
    """A thread that keeps what its function returned or raised."""

    def __init__(self, function: Callable[[], object], name: str) -> None:
        super().__init__(name=name, daemon=True)
        self._function = function
        self._returned: object = None
        self._raised: BaseException | None = None
        self.start()

    def run(self) -> None:
        try:
            self._returned = self._function()
        except BaseException as error:
            self._raised = error

    def result(self) -> Any:
        """Wait for its end; what it returned, or raise what it raised."""
        self.join(PATIENCE)
        assert not self.is_alive(), f"{self.name} hangs"
        if self._raised is not None:
            raise self._raised
        return self._returned


@contextmanager
def stepped_time() -> Iterator[SteppedTime]:
    """Robots that are made inside this block tick by a clock that the test turns; to end, they wait for none."""
    time, close = SteppedTime(), Session.close

    def close_at_once(session: Session) -> None:
        with time.flowing():
            close(session)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pepper_driver.robot.RealTimePacer", time.pacer)
        patch.setattr(Session, "close", close_at_once)
        yield time


def backend_of(pepper: Pepper) -> MockBackend:
    assert isinstance(pepper.backend, MockBackend)
    return pepper.backend


def begun(pepper: Pepper) -> bool:
    """Return True if a thread waits for ticks."""
    session = pepper._session
    return session is not None and not session._wait.over.is_set()
