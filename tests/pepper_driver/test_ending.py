"""Ctrl-C, SIGTERM and SIGHUP at every stage of a robot's start and end: it is never left as it was half-way.

The tests send signals to their own process, at a line or in a call of the backend. ``test_ending_processes.py`` sends
them to other ones.
"""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from pepper_driver import Pepper
from pepper_driver import robot as robot_module
from pepper_driver import session as session_module
from pepper_driver.backends import Command, Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings, signals
from pepper_driver.config.signals import Terminated, check_signals, raised_signals
from pepper_driver.log import read_log
from pepper_driver.safety import FaultError, FaultReason, RobotState

ROBOT = load_robot()
CONTROLLER, SAFETY = load_controller_settings(ROBOT), load_safety_settings()
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
KINDS: dict[int, type[KeyboardInterrupt]] = {
    signal.SIGINT: KeyboardInterrupt,
    signal.SIGTERM: Terminated,
    signal.SIGHUP: Terminated,
}
STAGES = ("open", "activate", "read", "write", "deactivate")


class Signalled(MockBackend):
    """Signals come in one of its calls, before and after what that does."""

    def __init__(self, stage: str, *numbers: int, points: bool = False) -> None:
        super().__init__(ROBOT)
        self.stage, self.numbers, self.points = stage, numbers, points
        self.active = False
        self.stiff = 0.0

    def _signal(self, stage: str) -> None:
        if stage == self.stage:
            for number in self.numbers:
                signal.raise_signal(number)
            if self.points:
                check_signals()

    def open(self) -> Measurement:
        measurement = super().open()
        self._signal("open")
        return measurement

    def activate(self) -> Measurement:
        self.active = True
        for step in range(1, 6):
            self.stiff = step / 5
            if step == 3:
                self._signal("activate")
        return super().activate()

    def read(self) -> Measurement:
        self._signal("read")
        return super().read()

    def write(self, command: Command) -> None:
        super().write(command)
        self._signal("write")

    def close(self) -> None:
        if self.active:
            for step in range(4, -1, -1):
                self.stiff = step / 5
                self._signal("deactivate")
        self.active = False
        super().close()


@pytest.fixture(autouse=True)
def _as_a_program_has_it(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """All signals end the program, those of the test before are long ago, and all is put back in the end."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    monkeypatch.setattr(signals, "MIN_INTERVAL", 0.0)
    for number in SIGNALS[1:]:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    after = [signal.getsignal(number) for number in SIGNALS]
    for number, handler in before.items():
        signal.signal(number, handler)
    assert after == [signal.default_int_handler, signal.SIG_DFL, signal.SIG_DFL]


@pytest.fixture
def at_exit(monkeypatch: pytest.MonkeyPatch) -> list[Callable[[], None]]:
    """Calls that the program would still make when it ends."""
    calls: list[Callable[[], None]] = []

    class AtExit:
        register = calls.append

        @staticmethod
        def unregister(call: Callable[[], None]) -> None:
            if call in calls:
                calls.remove(call)

    monkeypatch.setattr(session_module, "atexit", AtExit)
    return calls


def make_pepper(backend: MockBackend, log: Path | None = None, **arguments: Any) -> Pepper:
    settings: dict[str, Any] = {"robot": ROBOT, "controller": CONTROLLER, "safety": SAFETY}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot_module, "make_backend", lambda *_: backend)
        return Pepper("fake", observer=None, log=log, **settings, **arguments)


def assert_ended(pepper: Pepper, log: Path | None = None) -> None:
    backend = pepper.backend
    assert isinstance(backend, MockBackend)
    assert pepper.state is not RobotState.ACTIVE
    assert backend.calls[-1] == "close"
    assert not [thread for thread in threading.enumerate() if thread.name == "loop"]
    if log is not None:
        assert read_log(log).complete


# -- in a call of the backend ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("real_time", [False, True])
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_at_any_stage_ends_the_robot(
    number: int, stage: str, real_time: bool, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    backend = Signalled(stage, number)
    pepper = make_pepper(backend, log, real_time=real_time)
    with pytest.raises(KINDS[number]) as caught, pepper:
        pepper.run(0.06)
    began = stage != "open"
    assert backend.active is False
    assert backend.stiff == 0.0
    assert_ended(pepper, log if began else None)
    assert log.exists() is began
    assert getattr(caught.value, "__notes__", []) == ([f"log: {log}"] if began else [])


@pytest.mark.parametrize("stage", ["activate", "deactivate"])
def test_further_signals_do_not_break_off_the_end(stage: str, tmp_path: Path) -> None:
    """Each step of lowering the stiffness gets one; starting, none raises but where it may."""
    log = tmp_path / "run.mcap"
    backend = Signalled(stage, *SIGNALS, *SIGNALS)
    pepper = make_pepper(backend, log)
    with pytest.raises(KeyboardInterrupt), pepper:
        pepper.run(0.06)
    assert backend.stiff == 0.0
    assert_ended(pepper, log)


def test_a_beginning_is_broken_off_where_the_backend_allows_it() -> None:
    backend = Signalled("activate", signal.SIGTERM, points=True)
    with pytest.raises(Terminated), make_pepper(backend):
        pytest.fail("it has begun")
    assert backend.calls == ["open", "close"]
    assert backend.stiff == 0.0


def test_who_starts_without_a_block_gets_the_signals_too() -> None:
    pepper = make_pepper(MockBackend(ROBOT))
    pepper.start()
    with pytest.raises(Terminated):
        signal.raise_signal(signal.SIGHUP)
    assert pepper.state is RobotState.ACTIVE
    pepper.stop()
    assert_ended(pepper)


def test_what_a_program_leaves_open_is_closed_when_it_ends(at_exit: list[Any]) -> None:
    pepper = make_pepper(MockBackend(ROBOT))
    pepper.start()
    (close,) = at_exit
    close()
    assert_ended(pepper)
    assert not at_exit
    pepper.stop()


def test_handlers_of_the_users_own_are_called_while_it_starts() -> None:
    """Such as one that stops the robot: the start then fails."""
    backend = Signalled("activate", signal.SIGTERM)
    pepper = make_pepper(backend)
    signal.signal(signal.SIGTERM, lambda *_: pepper.emergency_stop())
    with pytest.raises(FaultError) as caught, pepper:
        pepper.run(0.06)
    assert caught.value.fault.reason is FaultReason.EMERGENCY_STOP
    assert_ended(pepper)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def test_in_another_thread_no_handler_is_changed() -> None:
    def drive() -> None:
        with pepper:
            found.append(signal.getsignal(signal.SIGTERM))

    pepper, found = make_pepper(MockBackend(ROBOT)), list[object]()
    thread = threading.Thread(target=drive)
    thread.start()
    thread.join()
    assert found == [signal.SIG_DFL]


# -- what is said ---------------------------------------------------------------------------------------------------


def test_a_script_says_once_what_ended_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """An uncaught ``Terminated`` has no traceback; Ctrl-C has, and its last line is the note."""
    log = tmp_path / "run.mcap"
    with pytest.raises(Terminated), make_pepper(MockBackend(ROBOT), log):
        signal.raise_signal(signal.SIGTERM)
    assert caplog.messages == [f"terminated; log: {log}"]
    caplog.clear()
    with pytest.raises(KeyboardInterrupt), make_pepper(MockBackend(ROBOT), log):
        signal.raise_signal(signal.SIGINT)
    assert not caplog.messages


def test_inside_a_program_that_says_it_nothing_is_said(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(Terminated), raised_signals(), make_pepper(MockBackend(ROBOT)):
        signal.raise_signal(signal.SIGTERM)
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


# -- at a line ------------------------------------------------------------------------------------------------------

NET = {"__enter__", "start", "__exit__", "_end"}
"""Functions of which some lines are not covered: a program that is hit there closes the robot when it ends."""


class LineTracer:
    """Sends a signal when the nth new line of start and end is reached."""

    FILES = (robot_module.__file__, session_module.__file__)
    NAMES = frozenset(
        {"__enter__", "__exit__", "start", "_start", "close", "_end", "_close", "_open_log"}
    )

    def __init__(self, number: int, nth: int) -> None:
        self._number, self._nth = number, nth
        self.lines: dict[tuple[str, int], str] = {}  # with the function

    def __call__(self, frame: FrameType, event: str, argument: object) -> Any:
        code = frame.f_code
        return self._line if code.co_filename in self.FILES and code.co_name in self.NAMES else None

    def _line(self, frame: FrameType, event: str, argument: object) -> Any:
        key = (frame.f_code.co_filename, frame.f_lineno)
        if event == "line" and key not in self.lines:
            self.lines[key] = frame.f_code.co_name
            if len(self.lines) == self._nth:
                signal.raise_signal(self._number)
        return self._line


def trace(number: int, nth: int, log: Path) -> tuple[LineTracer, Pepper, BaseException | None]:
    tracer, pepper = LineTracer(number, nth), make_pepper(MockBackend(ROBOT), log)
    before, error = sys.gettrace(), None
    sys.settrace(tracer)
    try:
        with pepper:
            pass
    except BaseException as caught:
        error = caught
    finally:
        sys.settrace(before)
    return tracer, pepper, error


def test_a_signal_at_any_line_of_start_and_end_leaves_nothing_open(
    tmp_path: Path, at_exit: list[Any]
) -> None:
    log = tmp_path / "run.mcap"
    with raised_signals():  # else SIGTERM ends the tests before the robot starts
        tracer, _, error = trace(signal.SIGINT, 0, log)
        assert error is None
        assert len(tracer.lines) > 50
        later = []
        for nth, where in enumerate(tracer.lines.values(), start=1):
            number = SIGNALS[nth % 2]
            log.unlink(missing_ok=True)
            _, pepper, error = trace(number, nth, log)
            assert isinstance(error, KINDS[number]), (nth, where)
            if at_exit:
                assert where in NET, (nth, where)
                later.append(nth)
                at_exit[0]()
                pepper.stop()
            assert not at_exit
            assert pepper.state is not RobotState.ACTIVE
            calls = pepper.backend.calls  # type: ignore[attr-defined]
            assert not calls or calls[-1] == "close", (nth, where)
            assert not log.exists() or read_log(log).complete, (nth, where)
        assert len(later) <= 10
