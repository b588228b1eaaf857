"""Begin and end of a run: what is made when, and an orderly end wherever something happens."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time as clock
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from pepper_driver import ExperimentRun, Pepper
from pepper_driver import session as session_module
from pepper_driver.backends import BackendError, Measurement, NotConnectedError
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import TickEvent
from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings
from pepper_driver.controller import PositionTask
from pepper_driver.log import LogError, LogWriter, read_log
from pepper_driver.observer import ModelFileError
from pepper_driver.safety import RobotState
from support import ROOT
from support.robots import make_pepper
from support.sessions import (
    SteppedTime,
    backend_of,
    begun,
    in_thread,
    stepped_time,
)
from support.waiting import PATIENCE, wait_until

EXPERIMENTS = sorted((ROOT / "examples").glob("**/*.yaml"))
MODES: list[dict[str, Any]] = [
    {},
    {"real_time": True},
    {"real_time": True, "loop": "caller"},
]

SAFETY = load_safety_settings()


@pytest.fixture(autouse=True)
def time() -> Iterator[SteppedTime]:
    """By a clock that costs no time; and nothing is left behind."""
    threads, interval = set(threading.enumerate()), sys.getswitchinterval()
    with stepped_time() as time, time.flowing():
        yield time
    assert wait_until(lambda: set(threading.enumerate()) <= threads), threading.enumerate()
    assert sys.getswitchinterval() == interval
    assert gc.isenabled()


# -- constructors ---------------------------------------------------------------------------------------------------


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither network nor threads; what libraries do when they are imported is done."""
    Pepper("mujoco")

    def refuse(*_: object, **__: object) -> None:
        pytest.fail("before the start nothing connects, and no thread starts")

    monkeypatch.setattr("socket.socket.connect", refuse)
    monkeypatch.setattr("socket.getaddrinfo", refuse)
    monkeypatch.setattr(threading.Thread, "start", refuse)
    monkeypatch.setattr("subprocess.Popen.__init__", refuse)


URIS = ["mujoco", "mock", "naoqi://pepper.invalid", "naoqis://nao@pepper.invalid"]


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("uri", URIS)
def test_a_pepper_is_made_without_network_and_threads(uri: str) -> None:
    pepper = Pepper(uri, observer=None if uri == "mock" else "fusion")
    pepper.on_contact()(print)
    pepper.add(PositionTask("l_wrist"))
    assert pepper.state is RobotState.INACTIVE
    pepper.stop()


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("uri", ["mujoco", "naoqi://pepper.invalid"])
def test_an_experiment_is_made_without_network_and_threads(uri: str) -> None:
    assert EXPERIMENTS
    for path in EXPERIMENTS:
        if "experiment" in path.read_text() or "steps:" in path.read_text():
            with suppress(ValueError):  # no experiment, or for simulations only
                ExperimentRun(path, uri)


def test_models_are_checked_when_a_pepper_is_made(tmp_path: Path) -> None:
    for uri in ("mujoco", "naoqi://pepper.invalid"):
        with pytest.raises(ModelFileError, match="no such file"):
            Pepper(uri, models=tmp_path / "none.json")


# -- beginning ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_entering_twice_is_refused_and_harms_nothing(mode: dict[str, Any]) -> None:
    pepper = make_pepper(**mode)
    with pepper:
        for enter in (pepper.start, pepper.__enter__):
            with pytest.raises(BackendError, match="'mock' is already active"):
                enter()
        pepper.run(0.12)
    assert backend_of(pepper).calls == ["open", "activate", "close"]
    pepper.start()
    pepper.run(0.12)
    pepper.stop()
    pepper.stop()
    assert backend_of(pepper).calls.count("open") == 2


@pytest.mark.parametrize("mode", MODES)
def test_two_threads_cannot_start_one_robot(mode: dict[str, Any]) -> None:
    inside, go = threading.Event(), threading.Event()

    class Slow(MockBackend):
        def open(self) -> Measurement:
            inside.set()
            assert go.wait(PATIENCE)
            return super().open()

    pepper = make_pepper(**mode)
    pepper.backend = Slow()
    first = in_thread(pepper.start)
    assert inside.wait(PATIENCE)
    with pytest.raises(BackendError, match="is being started already"):
        pepper.start()
    with pytest.raises(BackendError, match="is being started already"):
        pepper.__enter__()
    go.set()
    first.result()
    pepper.run(0.12)
    pepper.stop()
    assert backend_of(pepper).calls == ["open", "activate", "close"]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("stage", ["open", "activate", "write"])
def test_a_stop_while_it_starts_ends_the_start(stage: str, mode: dict[str, Any]) -> None:
    inside, go = threading.Event(), threading.Event()

    class Slow(MockBackend):
        def _wait(self, now: str) -> None:
            if now == stage:
                inside.set()
                assert go.wait(PATIENCE)

        def open(self) -> Measurement:
            measurement = super().open()
            self._wait("open")
            return measurement

        def activate(self) -> Measurement:
            measurement = super().activate()
            self._wait("activate")
            return measurement

        def write(self, command: Any) -> None:
            super().write(command)
            self._wait("write")

    pepper = make_pepper(**mode)
    pepper.backend = Slow()
    starting = in_thread(pepper.start)
    assert inside.wait(PATIENCE)
    pepper.stop()
    go.set()
    with pytest.raises((BackendError, NotConnectedError)):
        starting.result()
    assert pepper.state is RobotState.INACTIVE
    assert backend_of(pepper)._state == "closed"
    with pytest.raises(BackendError, match="not active"):
        pepper.run(0.1)


def test_start_and_stop_do_what_a_block_does(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    pepper = make_pepper(log=path, real_time=True)
    assert pepper.start() is None  # type: ignore[func-returns-value]
    pepper.run(0.12)
    pepper.stop()
    log = read_log(path)
    assert log.complete
    assert len(log) >= 10
    assert pepper.state is RobotState.INACTIVE


# -- one at a time --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_only_one_thread_steps_at_a_time(mode: dict[str, Any]) -> None:
    go = threading.Event()
    with make_pepper(**mode) as pepper:

        def wait(*_: object) -> None:
            go.wait(PATIENCE)

        first = in_thread(lambda: pepper.run(0.12, on_tick=wait), "the first")
        assert wait_until(lambda: begun(pepper))
        for call in (pepper.step, lambda: pepper.run(0.1), lambda: pepper.play("wave")):
            with pytest.raises(BackendError, match="thread 'the first' runs the robot already"):
                call()
        go.set()
        first.result()
        in_thread(pepper.step).result()
        pepper.step()


@pytest.mark.parametrize("mode", MODES)
def test_threads_that_step_at_random_get_a_tick_or_an_error(mode: dict[str, Any]) -> None:
    with make_pepper(**mode) as pepper:

        def step() -> int:
            ticks = 0
            for _ in range(30):
                try:
                    pepper.step()
                    ticks += 1
                except BackendError as error:
                    assert "runs the robot already" in str(error)
            return ticks

        threads = [in_thread(step) for _ in range(3)]
        ticks = sum(thread.result() for thread in threads)
        assert ticks >= 1
        if not pepper.paced:
            assert pepper.statistics.ticks == ticks
        pepper.step()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("call", ["run", "step", "play"])
def test_inside_callbacks_and_ticks_nothing_waits_for_ticks(
    call: str, mode: dict[str, Any]
) -> None:
    errors: list[BaseException] = []
    pepper = make_pepper(**mode)
    calls: dict[str, Callable[[], object]] = {
        "run": lambda: pepper.run(0.1),
        "step": pepper.step,
        "play": lambda: pepper.play("wave"),
    }

    @pepper.on_tick(queue=1)
    def wrong(_: TickEvent) -> None:
        if not errors:
            try:
                calls[call]()
            except BackendError as error:
                errors.append(error)

    with pepper:
        target = pepper.target
        pepper.run(0.12)
        assert wait_until(lambda: errors)
        assert "inside a callback" in str(errors[0])
        with pytest.raises(BackendError, match="inside a tick"):
            pepper.run(0.12, on_tick=lambda *_: calls[call]())
        with pytest.raises(BackendError, match="inside a tick"):
            pepper.run(0.12, until=lambda: bool(calls[call]()))
        assert (pepper.target == target).all(), "no motion has begun"
        pepper.run(0.12)


# -- ending ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_stop_from_another_thread_ends_a_run(mode: dict[str, Any], tmp_path: Path) -> None:
    pepper = make_pepper(log=tmp_path / "run.mcap", **mode)
    pepper.start()
    run = in_thread(lambda: pepper.run(1e6))
    assert wait_until(lambda: begun(pepper) and pepper.measurement.tick > 10)
    pepper.stop()
    with pytest.raises(BackendError, match="closed while it ran"):
        run.result()
    assert read_log(tmp_path / "run.mcap").complete
    assert backend_of(pepper).calls == ["open", "activate", "close"]


@pytest.mark.parametrize("mode", MODES)
def test_a_signal_handler_may_run_the_robot_inside_a_run(mode: dict[str, Any]) -> None:
    """As a handler that moves an arm away before it raises; here between two lines."""
    ticks: list[int] = []
    with make_pepper(**mode) as pepper:

        def trace(frame: FrameType, event: str, _: object) -> Any:
            if frame.f_code.co_name == "_tick_until":
                sys.settrace(None)
                pepper.run(0.12, on_tick=lambda tick, _: ticks.append(tick.measurement.tick))
            return None

        sys.settrace(trace)
        try:
            pepper.run(0.12)
        finally:
            sys.settrace(None)
        assert len(ticks) == 10
        assert pepper.measurement.tick >= 20
        pepper.step()


@pytest.mark.parametrize("mode", MODES)
def test_a_stop_from_a_callback_ends_a_run(mode: dict[str, Any], tmp_path: Path) -> None:
    pepper = make_pepper(log=tmp_path / "run.mcap", **mode)

    @pepper.on_tick()
    def stop(event: TickEvent) -> None:
        if event.tick.measurement.tick == 5:
            pepper.stop()

    pepper.start()
    with pytest.raises(BackendError, match=r"closed while it ran|not active"):
        pepper.run(1e6)
    pepper.stop()
    assert read_log(tmp_path / "run.mcap").complete


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("where", ["on_tick", "until"])
def test_a_stop_inside_a_tick_ends_a_run(where: str, mode: dict[str, Any], tmp_path: Path) -> None:
    pepper = make_pepper(log=tmp_path / "run.mcap", **mode)

    def stop(*_: object) -> bool:
        pepper.stop()
        return False

    pepper.start()
    functions: dict[str, Any] = {where: stop}
    with pytest.raises(BackendError, match="closed while it ran"):
        pepper.run(1e6, **functions)
    pepper.stop()  # waits for the end of the other
    assert read_log(tmp_path / "run.mcap").complete
    assert backend_of(pepper).calls == ["open", "activate", "close"]
    with pytest.raises(BackendError, match="not active"):
        pepper.step()


@pytest.mark.parametrize("mode", MODES)
def test_a_stop_at_any_moment_of_a_run_leaves_no_caller_waiting(
    mode: dict[str, Any],
) -> None:
    """Between two lines of what a run does, another thread stops the robot, from the beginning to the end."""
    settings = load_controller_settings(load_robot())
    # The capsules of its links take longer to make than all else of a start.
    bare = replace(settings, constraints=replace(settings.constraints, self_collision=False))
    pepper = make_pepper(controller=bare, safety=replace(SAFETY, tick_time=0.02), **mode)
    for line in count():
        pepper.start()
        places: set[int] = set()

        def run(line: int = line, places: set[int] = places) -> None:
            session = pepper._session
            assert session is not None

            def trace(frame: FrameType, event: str, _: object) -> Any:
                if frame.f_code.co_filename != session_module.__file__:
                    return None
                if event == "line" and frame.f_lineno not in places:
                    places.add(frame.f_lineno)
                    if len(places) == line + 1:
                        sys.settrace(None)
                        in_thread(session.close).join(0.05)
                return trace

            sys.settrace(trace)
            try:
                pepper.run(0.024)
            finally:
                sys.settrace(None)

        with suppress(BackendError):
            in_thread(run).result()
        pepper.stop()
        assert backend_of(pepper).calls[-1] == "close"
        if len(places) <= line:
            break
    assert line > 20


class Hanging(MockBackend):
    """From its fifth cycle on it does not answer, and closing waits for the answer."""

    def __init__(self) -> None:
        super().__init__()
        self.go, self.hangs = threading.Event(), threading.Event()

    def read(self) -> Measurement:
        if self._tick == 4:
            self.hangs.set()
            self.go.wait(PATIENCE)
        return super().read()


@pytest.mark.parametrize("deaf", [False, True])
@pytest.mark.parametrize("mode", MODES)
def test_leaving_a_robot_that_hangs_ends_all_else(
    mode: dict[str, Any],
    deaf: bool,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    safety = replace(SAFETY, tick_time=0.1, close_time=0.1 if deaf else PATIENCE)

    class Deaf(Hanging):
        def close(self) -> None:
            self.go.wait(PATIENCE)
            super().close()

    pepper = make_pepper(log=tmp_path / "run.mcap", safety=safety, **mode)
    robot = pepper.backend = Deaf() if deaf else Hanging()
    pepper.start()
    run = in_thread(lambda: pepper.run(1.0))
    # Only now: before its next tick begins, the robot can still be closed without it.
    assert robot.hangs.wait(PATIENCE)
    begin = clock.monotonic()
    if deaf:
        with pytest.raises(BackendError, match="may still be stiff"):
            pepper.stop()
    else:
        pepper.stop()
    assert clock.monotonic() - begin < 5.0
    assert "a tick that does not end" in caplog.text
    assert read_log(tmp_path / "run.mcap").complete
    robot.go.set()
    with pytest.raises(BackendError):
        run.result()
    if not deaf:
        assert wait_until(lambda: "in the middle of a tick, which failed" in caplog.text)
    assert pepper.state is RobotState.INACTIVE
    pepper.stop()  # what came of the end is no fault
    assert wait_until(lambda: robot.calls[-1] == "close")


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("fails", ["close", "read"])
def test_a_robot_that_fails_in_the_end_does_not_hide_the_error_under_way(
    fails: str, mode: dict[str, Any], tmp_path: Path
) -> None:
    class Failing(MockBackend):
        def read(self) -> Measurement:
            if fails == "read" and self._tick == 4:
                raise NotConnectedError("lost in a tick")
            return super().read()

        def close(self) -> None:
            super().close()
            raise BackendError("lost in the end")

    def work() -> None:
        with pepper:
            with suppress(NotConnectedError):
                pepper.run(0.12)
            raise KeyError("the program's own")

    pepper = make_pepper(log=tmp_path / "run.mcap", **mode)
    pepper.backend = Failing()
    with pytest.raises(KeyError, match="the program's own") as caught:
        work()
    assert caught.value.__notes__ == ["and in the end: lost in the end"]
    assert read_log(tmp_path / "run.mcap").complete
    pepper.start()
    with pytest.raises(BackendError, match="lost in the end"):
        pepper.stop()


def test_a_log_that_fails_in_the_end_does_not_hide_the_error_under_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finish = LogWriter.close

    def fail(self: LogWriter) -> None:
        finish(self)
        raise LogError("the disk is full")

    def work() -> None:
        with make_pepper(log=tmp_path / "run.mcap"):
            raise KeyboardInterrupt

    monkeypatch.setattr(LogWriter, "close", fail)
    with pytest.raises(KeyboardInterrupt) as caught:
        work()
    assert "and in the end: the disk is full" in caught.value.__notes__


# -- Ctrl-C ---------------------------------------------------------------------------------------------------------


class Interrupted:
    """Raises Ctrl-C in this thread, at the n-th place of the session where Python looks for signals.

    These are the beginnings of functions, and the ends of calls of functions in C.

    Attributes:
        over: Whether there were fewer.
    """

    def __init__(self, number: int) -> None:
        self._left, self.over = number, True

    def __enter__(self) -> Interrupted:
        sys.setprofile(self._profile)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _profile(self, frame: FrameType, event: str, _: object) -> None:
        inside = frame.f_code.co_filename == session_module.__file__
        if inside and event in ("call", "c_return"):
            self._left -= 1
            if self._left < 0:
                self.over = False
                sys.setprofile(None)
                raise KeyboardInterrupt


@pytest.mark.parametrize("mode", MODES)
def test_ctrl_c_anywhere_in_a_step_lets_the_robot_tick_on(mode: dict[str, Any]) -> None:
    """As in a notebook."""
    with make_pepper(**mode) as pepper:
        for number in count():
            with suppress(KeyboardInterrupt), Interrupted(number) as interrupted:
                pepper.step()
            tick = pepper.measurement.tick
            pepper.step()
            assert pepper.measurement.tick > tick
            if interrupted.over:
                break
    assert number > 10
    assert backend_of(pepper).calls == ["open", "activate", "close"]


PROGRAM = """
from pepper_driver import Pepper
pepper = Pepper("mock", observer=None, real_time=True, log={path!r})
pepper.start()
pepper.drive(0.1, 0.0, 0.0, hold=True)
pepper.run(0.3)
{end}
"""


@pytest.mark.parametrize("end", ["", "1 / 0", "import sys; sys.exit(3)"])
def test_a_program_that_forgets_to_stop_lets_go_of_the_robot(end: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = PROGRAM.format(path=str(path), end=end)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, env=environment, timeout=60, capture_output=True
    )
    assert done.returncode == {"": 0, "1 / 0": 1}.get(end, 3), done.stderr
    log = read_log(path)
    assert log.complete
    assert len(log) >= 25
