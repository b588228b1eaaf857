"""Signals as exceptions, and signals that wait: sent by the tests to their own process, which always has a handler."""

from __future__ import annotations

import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

import pytest

from pepper_driver.config import signals
from pepper_driver.config.signals import (
    MAX_DEFERRAL,
    MIN_INTERVAL,
    Terminated,
    check_signals,
    deferred_signals,
    describe_interrupt,
    exit_code,
    immediate_signals,
    raised_signals,
)

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
send = signal.raise_signal


class Clock:
    """In place of the time."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    """Signals as a program finds them, and finds them again afterwards."""
    before = {number: signal.getsignal(number) for number in (INT, TERM, HUP)}
    clock = Clock()
    monkeypatch.setattr(signals, "time", clock)
    monkeypatch.setattr(signals._Blocks, "last_came", -MIN_INTERVAL)  # and back: by another clock
    for number in (TERM, HUP):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(INT, signal.default_int_handler)
    yield clock
    after = {number: signal.getsignal(number) for number in (INT, TERM, HUP)}
    for number, handler in before.items():
        signal.signal(number, handler)
    assert after == {INT: signal.default_int_handler, TERM: signal.SIG_DFL, HUP: signal.SIG_DFL}
    assert signal.set_wakeup_fd(-1) == -1


@pytest.fixture
def received() -> Iterator[list[int]]:
    """Signals as a handler of the user's own receives them: SIGTERM."""
    numbers: list[int] = []
    signal.signal(TERM, lambda number, _: numbers.append(number))
    yield numbers
    signal.signal(TERM, signal.SIG_DFL)


@contextmanager
def interrupted(
    kind: type[KeyboardInterrupt] = KeyboardInterrupt,
) -> Iterator[pytest.ExceptionInfo[KeyboardInterrupt]]:
    with pytest.raises(kind) as caught:
        yield caught


def in_a_thread(function: Callable[[], object]) -> None:
    thread = threading.Thread(target=function)
    thread.start()
    thread.join()


# -- as exceptions --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code", "words"), [(TERM, 143, "terminated"), (HUP, 129, "hung up")]
)
def test_a_signal_ends_as_ctrl_c_does(number: int, code: int, words: str) -> None:
    with pytest.raises(KeyboardInterrupt) as caught, raised_signals():
        send(number)
    assert isinstance(caught.value, Terminated)
    assert exit_code(caught.value) == code
    assert describe_interrupt(caught.value) == words
    caught.value.add_note("log: x.mcap")
    assert describe_interrupt(caught.value) == f"{words}; log: x.mcap"


def test_uncaught_it_ends_a_program_without_a_traceback() -> None:
    """As Python does with a SystemExit."""
    error = Terminated(TERM)
    assert isinstance(error, SystemExit)
    assert error.code == 143


def test_ctrl_c_itself_has_its_code() -> None:
    error = KeyboardInterrupt()
    assert (exit_code(error), describe_interrupt(error)) == (130, "interrupted")


def test_of_several_blocks_the_last_puts_back() -> None:
    first, second = raised_signals(), raised_signals()
    assert first.__enter__() is True
    assert second.__enter__() is False, "nothing was left to change"
    first.__exit__(None, None, None)
    with pytest.raises(Terminated):
        send(TERM)
    second.__exit__(None, None, None)


def test_what_is_ignored_or_handled_is_left_alone(received: list[int]) -> None:
    signal.signal(HUP, signal.SIG_IGN)  # as by nohup
    with raised_signals() as changed:
        send(HUP)
        send(TERM)
    assert not changed
    assert received == [TERM]
    assert signal.getsignal(HUP) is signal.SIG_IGN
    signal.signal(HUP, signal.SIG_DFL)


def test_a_handler_that_came_meanwhile_stays() -> None:
    def mine(*_: object) -> None: ...

    with raised_signals():
        signal.signal(TERM, mine)
    assert signal.getsignal(TERM) is mine
    signal.signal(TERM, signal.SIG_DFL)


def test_other_threads_change_nothing() -> None:
    def block() -> None:
        with raised_signals() as changed:
            found.append((changed, signal.getsignal(TERM)))

    found: list[object] = []
    in_a_thread(block)
    assert found == [(False, signal.SIG_DFL)]


def test_two_at_once_are_one(clock: Clock) -> None:
    """A second exception would break off what the first has begun to close."""
    with raised_signals():
        with pytest.raises(Terminated):
            send(HUP)
        clock.advance(0.9 * MIN_INTERVAL)
        send(HUP)
        send(TERM)
        clock.advance(0.2 * MIN_INTERVAL)
        with pytest.raises(Terminated):
            send(TERM)


def test_two_at_once_are_one_also_where_the_second_waits_long(clock: Clock) -> None:
    """For the robot to be closed; this took all its time from the interval."""
    with raised_signals():
        with pytest.raises(Terminated):
            send(HUP)
        with deferred_signals():
            send(TERM)
            clock.advance(3.0 * MIN_INTERVAL)


def test_a_signal_that_another_thread_takes_wakes_the_main_one() -> None:
    """The system chooses the thread where two come at once."""

    def take() -> None:
        signal.pthread_kill(threading.get_ident(), TERM)

    seconds = 20.0  # only a failing test sleeps them
    thread = threading.Timer(0.05, take)
    begin = time.monotonic()
    with interrupted(Terminated), raised_signals():
        thread.start()
        time.sleep(seconds)
    thread.join()
    assert time.monotonic() - begin < seconds


def test_no_thread_is_left_where_the_last_block_ends_in_another_thread(clock: Clock) -> None:
    block = raised_signals()
    block.__enter__()
    ending = threading.Thread(target=block.__exit__, args=(None, None, None))
    ending.start()
    ending.join()
    assert "signals" not in [thread.name for thread in threading.enumerate()]
    with interrupted(Terminated), raised_signals():  # and it works again
        send(TERM)


def test_a_program_that_is_woken_by_signals_goes_on_being_woken() -> None:
    reader, writer = socket.socketpair()
    with reader, writer:
        writer.setblocking(False)
        signal.set_wakeup_fd(writer.fileno())
        with interrupted(Terminated), raised_signals():
            send(TERM)
        assert signal.set_wakeup_fd(-1) == writer.fileno()
        assert TERM in reader.recv(16)


# -- deferred -------------------------------------------------------------------------------------------------------


def test_signals_wait_for_the_end_of_the_outermost_block(received: list[int]) -> None:
    done = []
    with interrupted(), deferred_signals():
        with deferred_signals():
            send(INT)
            send(TERM)
            send(INT)
            done.append("inner")
        done.append("outer")
        assert not received
    assert done == ["inner", "outer"]
    assert received == [TERM], "another's exception takes it nothing"


def test_a_signal_that_is_raised_waits_too() -> None:
    done = []
    with interrupted(Terminated), raised_signals(), deferred_signals():
        send(TERM)
        done.append(1)
    assert done


def test_a_signal_that_waits_is_raised_even_if_its_block_has_ended() -> None:
    block, done = raised_signals(), []
    block.__enter__()
    with interrupted(Terminated), deferred_signals():
        send(TERM)
        block.__exit__(None, None, None)
        done.append(1)
    assert done


def test_an_error_in_the_block_is_the_context_of_what_waited() -> None:
    with interrupted() as caught, deferred_signals():
        send(INT)
        raise ValueError("mine")
    assert isinstance(caught.value.__context__, ValueError)


def test_what_is_ignored_stays_ignored() -> None:
    signal.signal(INT, signal.SIG_IGN)
    with deferred_signals():
        send(INT)
    assert signal.getsignal(INT) is signal.SIG_IGN
    signal.signal(INT, signal.default_int_handler)


def test_a_check_handles_what_waits_until_one_has_raised() -> None:
    done = []
    with interrupted(), deferred_signals(checked=True):
        check_signals()
        send(INT)
        done.append("begun")
        try:
            check_signals()
            done.append("not reached")
        finally:
            send(INT)
            check_signals()
            done.append("cleaned up")
    assert done == ["begun", "cleaned up"]


def test_a_check_calls_handlers_that_raise_nothing_each_time(received: list[int]) -> None:
    with deferred_signals(checked=True):
        for count in (1, 2):
            send(TERM)
            check_signals()
            assert len(received) == count


def test_nothing_is_handled_any_more_once_an_end_has_begun() -> None:
    done = []
    with interrupted(), deferred_signals(checked=True):
        with deferred_signals():
            send(INT)
            check_signals()
        check_signals()
        with immediate_signals():
            done.append(1)
    assert done


def test_without_a_block_a_check_does_nothing() -> None:
    check_signals()
    with deferred_signals(checked=True):
        in_a_thread(check_signals)


def test_what_waits_long_is_broken_off_at_once_but_only_once() -> None:
    done = []
    with interrupted(), deferred_signals(checked=True):
        try:
            with immediate_signals():
                send(INT)
                done.append("not reached")
        finally:
            send(INT)
            done.append("cleaned up")
    assert done == ["cleaned up"]


def test_what_came_before_is_handled_where_signals_are_immediate() -> None:
    done = []
    with interrupted(), deferred_signals(checked=True):
        send(INT)
        with immediate_signals():
            done.append(1)
    assert not done


def test_what_hangs_can_be_broken_off(clock: Clock) -> None:
    done = []
    with deferred_signals():
        clock.advance(1.01 * MAX_DEFERRAL)
        with pytest.raises(KeyboardInterrupt):
            send(INT)
        done.append(1)
    assert done


@pytest.mark.parametrize("number", [INT, TERM])
def test_a_signal_at_any_moment_of_begin_and_end_leaves_all_as_it_was(
    number: int, clock: Clock
) -> None:
    """Python handles signals where a function begins, and where one of C's returns."""
    moments = [0]

    def profile(frame: FrameType, event: str, argument: object) -> None:
        code = (
            frame if frame.f_code.co_filename == signals.__file__ else frame.f_back or frame
        ).f_code
        mine = code.co_filename == signals.__file__ and code.co_name in ("begin", "end")
        if mine and event in ("call", "return", "c_return"):
            moments[-1] += 1
            if moments[-1] == len(moments) - 1:
                send(number)

    with raised_signals():
        handlers = [signal.getsignal(each) for each in (INT, TERM, HUP)]
        while moments[-1] >= len(moments) - 1:  # the first time, none is sent
            moments.append(0)
            clock.advance(MIN_INTERVAL)
            before = sys.getprofile()
            with suppress(KeyboardInterrupt):
                sys.setprofile(profile)
                try:
                    with deferred_signals():
                        pass
                finally:
                    sys.setprofile(before)
            assert signals._Deferral.current is None, moments
            assert [signal.getsignal(each) for each in (INT, TERM, HUP)] == handlers, moments
    assert len(moments) > 8


def test_in_other_threads_signals_are_handled_as_ever() -> None:
    """They come to the main thread, which is doing something else."""
    inside, over = threading.Event(), threading.Event()

    def end() -> None:
        with deferred_signals():
            inside.set()
            over.wait()

    thread = threading.Thread(target=end)
    thread.start()
    inside.wait()
    with pytest.raises(KeyboardInterrupt):
        send(INT)
    over.set()
    thread.join()
