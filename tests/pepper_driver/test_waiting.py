"""Waiting for a contact: in the thread that runs the robot, and in others."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from pepper_driver import Contact, FaultError, Pepper
from pepper_driver.backends import BackendError
from pepper_driver.config import UnknownNameError
from pepper_driver.filters import ListeningError

from event_cases import LONG, ROBOT, contact, make_pepper, pressed  # isort: skip
from fakes import aged  # isort: skip

CYCLE = ROBOT.cycle


class Waiting:
    """Another thread that waits; ``result`` is what it got or the error raised."""

    def __init__(self, pepper: Pepper, **which: Any) -> None:
        self.result: Contact | BaseException | None = None
        self._pepper = pepper
        self._which = which
        self.thread = threading.Thread(target=self._wait)
        self.thread.start()
        attached = pepper._active().dispatcher
        while self.thread.is_alive() and not attached.wants(Contact):
            time.sleep(0.001)

    def _wait(self) -> None:
        try:
            self.result = self._pepper.wait_for_contact(**self._which)
        except BaseException as error:
            self.result = error

    def join(self) -> Contact | BaseException | None:
        self.thread.join(LONG)
        assert not self.thread.is_alive()
        return self.result


def test_it_runs_the_robot_up_to_the_contact() -> None:
    pepper = make_pepper({5: (contact(1),), 8: (contact(2, link="RForeArm"), contact(3))})
    with pepper:
        assert pepper.wait_for_contact(timeout=1.0) == contact(1)
        assert pepper.time == pytest.approx(5 * CYCLE)
        assert pepper.wait_for_contact(link="LForeArm") == contact(3)
        assert pepper.time == pytest.approx(8 * CYCLE)


def test_it_waits_no_longer_than_told_on_the_robots_clock() -> None:
    pepper = make_pepper({10: (contact(1),), 21: (contact(2),)})
    with pepper:
        assert pepper.wait_for_contact(timeout=10 * CYCLE) == contact(1)  # in the last tick
        assert pepper.wait_for_contact(timeout=10 * CYCLE) is None
        assert pepper.time == pytest.approx(20 * CYCLE)
        assert pepper.wait_for_contact(timeout=0) is None
        assert pepper.time == pytest.approx(20 * CYCLE)


def test_it_takes_what_is_asked_for_and_nothing_from_before() -> None:
    pepper = make_pepper(
        {
            2: (contact(1),),
            4: (contact(2, kind="rebound"), contact(1, phase="update", intensity=9.0)),
            6: (contact(1, phase="end"),),
        }
    )
    with pepper:
        pepper.run(3 * CYCLE)
        assert pepper.wait_for_contact(timeout=20 * CYCLE, phase="end") == contact(1, phase="end")
        assert pepper.wait_for_contact(timeout=20 * CYCLE) is None


def test_another_thread_waits_for_the_one_that_runs() -> None:
    pepper = make_pepper({5: (contact(1),), 50: (contact(2),)})
    with pepper:
        waiting = Waiting(pepper, timeout=1.0)
        pepper.run(3 * CYCLE)
        assert waiting.thread.is_alive()  # nothing yet, and it goes on over several runs
        pepper.run(3 * CYCLE)
        assert waiting.join() == contact(1)
        assert pepper.time == pytest.approx(6 * CYCLE)  # it has run nothing itself
        waiting = Waiting(pepper, timeout=10 * CYCLE)
        pepper.run(100 * CYCLE)
        assert waiting.join() is None  # the second contact came too late


def until_somebody_waits(pepper: Pepper) -> None:
    end = time.monotonic() + LONG
    while not pepper._active().dispatcher.wants(Contact):
        assert time.monotonic() < end
        time.sleep(0.001)


def test_its_own_thread_waits_while_another_runs() -> None:
    pepper = make_pepper({10: (contact(1),)})
    inside = threading.Event()

    def hold_up(*_: object) -> None:
        if not inside.is_set():
            inside.set()
            until_somebody_waits(pepper)

    with pepper:
        runner = threading.Thread(target=lambda: pepper.run(50 * CYCLE, on_tick=hold_up))
        runner.start()
        assert inside.wait(LONG)
        assert pepper.wait_for_contact(timeout=20 * CYCLE) == contact(1)
        runner.join(LONG)
        assert pepper.time == pytest.approx(50 * CYCLE)


def test_a_callback_may_wait() -> None:
    pepper = make_pepper({10: (contact(1),)}, {1: pressed("bumpers", 0)})
    found: list[Contact | None] = []
    ticks: list[object] = []

    @pepper.on_bumper()
    def hit(_: object) -> None:
        found.append(pepper.wait_for_contact(timeout=20 * CYCLE))

    def hold_up(tick: object, _: object) -> None:
        ticks.append(tick)
        if len(ticks) == 2:
            until_somebody_waits(pepper)

    with pepper:
        pepper.run(50 * CYCLE, on_tick=hold_up)
    assert found == [contact(1)]


def test_it_does_not_wait_for_a_robot_that_nobody_runs() -> None:
    with make_pepper() as pepper:
        start = time.monotonic()
        waiting = Waiting(pepper, timeout=0.1)
        assert waiting.join() is None
        assert time.monotonic() - start < LONG / 2


def test_closing_the_robot_ends_the_wait() -> None:
    with make_pepper() as pepper:
        waiting = Waiting(pepper)
        pepper.run(3 * CYCLE)
        assert waiting.thread.is_alive()
    assert waiting.join() is None


@pytest.mark.parametrize("stop", [lambda p: p.emergency_stop(), lambda p: p.run(1.0)])
def test_a_fault_ends_the_wait_of_all(stop: Callable[[Pepper], object]) -> None:
    pepper = make_pepper(faults={3: aged(0.2)})
    with pepper:
        waiting = Waiting(pepper)
        with suppress(FaultError):
            stop(pepper)
        assert isinstance(waiting.join(), FaultError)
        with pytest.raises(FaultError):
            pepper.wait_for_contact(timeout=1.0)
        assert isinstance(Waiting(pepper, timeout=1.0).join(), FaultError)


def test_a_fault_while_it_runs_the_robot_is_raised() -> None:
    pepper = make_pepper(faults={3: aged(0.2)})
    with pepper, pytest.raises(FaultError, match="200 ms old"):
        pepper.wait_for_contact(timeout=1.0)


@pytest.mark.parametrize("timeout", [-1.0, float("nan"), float("inf"), "1", [1.0]])
def test_a_timeout_that_is_none_is_refused(timeout: Any) -> None:
    with make_pepper() as pepper, pytest.raises(ListeningError, match="timeout"):
        pepper.wait_for_contact(timeout=timeout)


def test_what_can_never_come_is_not_waited_for() -> None:
    pepper = make_pepper()
    with pytest.raises(BackendError, match="with Pepper"):
        pepper.wait_for_contact(timeout=1.0)
    with pepper, pytest.raises(UnknownNameError, match="LForeArm"):
        pepper.wait_for_contact(link="LForearm")
    numb = Pepper("mujoco", observer=None)
    with numb, pytest.raises(ListeningError, match="without an observer"):
        numb.wait_for_contact()


def test_a_waiter_leaves_nothing_behind() -> None:
    with make_pepper() as pepper:
        pepper.wait_for_contact(timeout=3 * CYCLE)
        assert not pepper._active().dispatcher.wants(Contact)
