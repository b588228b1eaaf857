"""What a run in real time changes in the process, and that all of it is put back."""

import gc
import logging
import os
import sys
import threading
from collections.abc import Iterator

import pytest

from pepper_driver import realtime as module
from pepper_driver.realtime import (
    PRIORITY,
    PYTHONS_OWN,
    SWITCH_INTERVAL,
    priority_obstacle,
    realtime,
)

LINUX = hasattr(os, "sched_setscheduler")
State = tuple[bool, bool, float]


def state() -> State:
    """What all threads share."""
    frozen = gc.get_freeze_count() > PYTHONS_OWN
    return gc.isenabled(), frozen, round(sys.getswitchinterval(), 6)


@pytest.fixture(autouse=True)
def untouched() -> Iterator[None]:
    before = state()
    scheduler = os.sched_getscheduler(0) if LINUX else None
    yield
    assert state() == before
    if LINUX:
        assert os.sched_getscheduler(0) == scheduler


class Scheduler:
    """In place of the system's: knows what was asked for, and may refuse."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, permitted: bool = True) -> None:
        self.permitted, self.now, self.priority = permitted, os.SCHED_OTHER, 0
        self.asked: list[int] = []
        monkeypatch.setattr(os, "sched_getscheduler", lambda _: self.now)
        monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(self.priority))
        monkeypatch.setattr(os, "sched_setscheduler", self.set)
        monkeypatch.setattr(module, "_said", set())

    def set(self, thread: int, policy: int, param: os.sched_param) -> None:
        assert thread == 0
        self.asked.append(policy)
        flagged = bool(self.now & os.SCHED_RESET_ON_FORK)
        if not self.permitted or (flagged and not policy & os.SCHED_RESET_ON_FORK):
            raise PermissionError  # as without root: the flag stays
        self.now, self.priority = policy, param.sched_priority


def test_inside_nothing_is_collected_and_threads_switch_quickly() -> None:
    with realtime():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > PYTHONS_OWN
        assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_all_is_put_back_whatever_happens(error: type[BaseException]) -> None:
    with pytest.raises(error), realtime():
        raise error


def test_garbage_of_the_run_is_gone_afterwards() -> None:
    class Loop:
        """Refers to itself."""

        def __init__(self) -> None:
            self.me = self

        def __del__(self) -> None:
            ended.append(1)

    ended: list[int] = []
    with realtime():
        Loop()
        assert not ended
    assert ended


def test_what_the_user_has_set_stays() -> None:
    interval = sys.getswitchinterval()
    gc.disable()
    gc.freeze()
    sys.setswitchinterval(1e-5)
    try:
        frozen = gc.get_freeze_count()
        with realtime():
            assert sys.getswitchinterval() == pytest.approx(1e-5)
        assert not gc.isenabled()
        assert gc.get_freeze_count() >= frozen
    finally:
        gc.enable()
        gc.unfreeze()
        sys.setswitchinterval(interval)


def test_what_python_itself_has_frozen_keeps_nothing_else_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gc, "get_freeze_count", lambda: 375)  # as Python 3.12.1 starts
    with realtime():
        pass


def test_blocks_of_several_threads_overlap() -> None:
    inside, leave = threading.Event(), threading.Event()

    def other() -> None:
        with realtime():
            inside.set()
            leave.wait(10)

    thread = threading.Thread(target=other)
    with realtime():
        thread.start()
        assert inside.wait(10)
    assert not gc.isenabled(), "the other one still runs"
    leave.set()
    thread.join(10)


def test_blocks_may_be_nested() -> None:
    with realtime():
        with realtime():
            pass
        assert not gc.isenabled()


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_the_thread_gets_priority_and_its_children_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        scheduler = Scheduler(patch)
        with realtime():
            assert scheduler.now == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            assert scheduler.priority == PRIORITY
        assert scheduler.now & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
        assert scheduler.priority == 0


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_priority_given_from_outside_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        scheduler = Scheduler(patch)
        scheduler.now, scheduler.priority = os.SCHED_RR, 70
        with realtime():
            pass
        assert (scheduler.now, scheduler.priority, scheduler.asked) == (os.SCHED_RR, 70, [])


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_a_refusal_is_said_once_with_the_cure(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        Scheduler(patch, permitted=False)
        for _ in range(3):
            with realtime():
                assert not gc.isenabled()
    (record,) = caplog.records
    assert "rtprio" in record.getMessage()
    assert "limits.d" in record.getMessage()


@pytest.mark.skipif(not LINUX, reason="no such scheduler")
def test_the_system_takes_the_priority_back() -> None:
    """For real, where it is permitted; the fixture looks at what is left."""
    seen: list[int] = []
    with realtime():
        policy = os.sched_getscheduler(0)
        thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert policy in (os.SCHED_OTHER, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK)
    assert seen == [os.SCHED_OTHER]


@pytest.mark.skipif(not LINUX, reason="no schedulers")
@pytest.mark.parametrize("permitted", [True, False])
def test_what_stands_in_the_way_of_priority_can_be_asked_for(
    permitted: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    scheduler = Scheduler(monkeypatch, permitted)
    obstacle = priority_obstacle()
    assert obstacle == "" if permitted else "not permitted" in obstacle
    assert scheduler.now & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER
    assert caplog.records == [], "who asks says it"
    monkeypatch.undo()
