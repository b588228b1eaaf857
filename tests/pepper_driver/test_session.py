"""One active run: what is started is ended, in the right order, whatever fails."""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import BackendError, Command, Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.dispatcher import Dispatcher
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.log import LogWriter, read_log
from pepper_driver.observer import Observation
from pepper_driver.realtime import COLLECTION_PERIOD
from pepper_driver.reflexes import Reflex, ReflexRequests
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError, FaultReason, RobotState
from support.sessions import ROBOT, Scripted, SteppedTime, active, make_session, start

CYCLE = 12_000_000  # ns


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Parts that were ended, in order; a backend made with these calls adds its own."""
    calls: list[str] = []
    end_log, end_callbacks = LogWriter.close, Dispatcher.close

    def close_log(self: LogWriter) -> None:
        calls.append("log")
        end_log(self)

    def close_dispatcher(self: Dispatcher, timeout: float) -> bool:
        calls.append("callbacks")
        return end_callbacks(self, timeout)

    monkeypatch.setattr(LogWriter, "close", close_log)
    monkeypatch.setattr(Dispatcher, "close", close_dispatcher)
    return calls


class Fragile(MockBackend):
    """Fails at one step; its calls go to a list that others write to as well."""

    def __init__(self, calls: list[str], fails_at: str = "") -> None:
        super().__init__()
        self.calls, self.fails_at = calls, fails_at

    def open(self) -> Measurement:
        measurement = super().open()
        self._check("open")
        return measurement

    def activate(self) -> Measurement:
        measurement = super().activate()
        self._check("activate")
        return measurement

    def close(self) -> None:
        super().close()
        self._check("close")

    def _check(self, step: str) -> None:
        if step == self.fails_at:
            raise BackendError(f"{step} fails")


class Unwilling(Reflex):
    """Cannot be reset once it is prepared."""

    prepared = False

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        pass

    def reset(self) -> None:
        if self.prepared:
            raise ZeroDivisionError("a user's mistake")
        self.prepared = True


def test_the_robot_ends_first_and_only_once(tmp_path: Path, ended: list[str]) -> None:
    path = tmp_path / "run.mcap"
    session = start(make_session(Fragile(ended)), log=path)
    assert session.active
    assert session.gate.state is RobotState.ACTIVE
    session.run(5)
    session.close()
    assert ended == ["open", "activate", "close", "log", "callbacks"]
    assert not session.active
    assert session.gate.state is RobotState.INACTIVE
    assert read_log(path).complete
    session.close()
    assert not ended[5:]


def test_a_robot_that_fails_to_close_leaves_neither_log_nor_callbacks_open(
    tmp_path: Path, ended: list[str]
) -> None:
    path = tmp_path / "run.mcap"
    session = start(make_session(Fragile(ended, "close")), log=path)
    session.run(5)
    with pytest.raises(BackendError, match="close fails"):
        session.close()
    assert ended[2:] == ["close", "log", "callbacks"]
    assert read_log(path).complete


@pytest.mark.parametrize(
    ("fails_at", "calls"),
    [
        ("open", ["open", "close", "callbacks"]),
        ("activate", ["open", "activate", "close", "log", "callbacks"]),
    ],
)
def test_a_start_that_fails_is_undone(
    fails_at: str, calls: list[str], tmp_path: Path, ended: list[str]
) -> None:
    with pytest.raises(BackendError, match=fails_at):
        start(make_session(Fragile(ended, fails_at)), log=tmp_path / "run.mcap")
    assert ended == calls


def test_a_start_that_fails_with_the_robot_stiff_is_undone(
    tmp_path: Path, ended: list[str]
) -> None:
    with pytest.raises(ZeroDivisionError):
        start(make_session(Fragile(ended)), log=tmp_path / "run.mcap", reflexes=(Unwilling(),))
    assert ended == ["open", "activate", "close", "log", "callbacks"]


def test_a_fault_outlasts_the_session() -> None:
    with active() as session:
        session.gate.stop(FaultReason.EMERGENCY_STOP, "emergency stop")
    assert session.gate.state is RobotState.FAULT


class Stopped(Fragile):
    """A person presses stop while the robot is getting stiff."""

    def __init__(self, calls: list[str], stop: Callable[[], None]) -> None:
        super().__init__(calls)
        self.stop = stop

    def activate(self) -> Measurement:
        self.stop()
        return super().activate()


def test_an_emergency_stop_while_the_robot_starts_ends_the_start(ended: list[str]) -> None:
    pepper = Pepper("mujoco", observer=None)
    pepper.backend = Stopped(ended, pepper.emergency_stop)
    with pytest.raises(FaultError, match="emergency stop"):
        pepper.start()
    assert ended == ["open", "activate", "close", "callbacks"]
    assert pepper.state is RobotState.FAULT


class Recorder(MockBackend):
    """Notes every call, those of a reflex and of listeners too."""

    def __init__(self, real_time: bool, calls: list[str]) -> None:
        super().__init__(real_time=real_time)
        self.calls = calls

    def read(self) -> Measurement:
        self.calls.append("read")
        return super().read()

    def write(self, command: Command) -> None:
        self.calls.append(f"write {command.position[6]:.6f}")
        super().write(command)


class Noting(Scripted):
    def __init__(self, calls: list[str]) -> None:
        super().__init__()
        self.calls = calls

    def step(self, tick: Tick) -> Observation:
        self.calls.append("observe")
        return super().step(tick)

    def reset(self) -> None:
        self.calls.append("reset")
        super().reset()


class Reacting(Reflex):
    def __init__(self, calls: list[str]) -> None:
        self.calls = calls

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        self.calls.append("react")

    def reset(self) -> None:
        pass


def calls_of_a_run(monkeypatch: pytest.MonkeyPatch, *, real: bool, paced: bool) -> list[str]:
    """All that is called in a run of a backend whose caller ticks, by a clock that stands still but for sleeping."""
    calls: list[str] = []
    time = SteppedTime()
    monkeypatch.setattr("pepper_driver.robot.RealTimePacer", time.pacer)
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: Recorder(real, calls))
    reflex = Reacting(calls)
    pepper = Pepper(
        "any", observer=Noting(calls), reflexes=[reflex], real_time=paced, loop="caller"
    )
    calls.clear()  # of the dry run of observer and reflex
    with pepper:
        pepper.set_posture({"LShoulderRoll": 0.5})
        pepper.run(0.12, on_tick=lambda *_: calls.append("listen"))
        pepper.run(1.2, until=lambda: calls.append("until?") or len(calls) > 100)  # type: ignore[func-returns-value]
        for _ in range(3):
            pepper.step()
        assert pepper.statistics.missed == 0
    assert time.now == (pepper.statistics.ticks - 1) * CYCLE * (real or paced)
    return calls


def test_all_backends_see_the_same_calls_in_the_same_order(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = calls_of_a_run(monkeypatch, real=False, paced=False)
    assert [call.split()[0] for call in simulated[:4]] == ["open", "activate", "reset", "write"]
    assert [call.split()[0] for call in simulated[4:9]] == [
        "read",
        "observe",
        "react",
        "write",
        "listen",
    ]
    assert len(simulated) > 100
    assert calls_of_a_run(monkeypatch, real=True, paced=False) == simulated
    assert calls_of_a_run(monkeypatch, real=False, paced=True) == simulated


def broken(measurement: Measurement) -> Measurement:
    raise ZeroDivisionError("a driver's mistake")


@pytest.mark.parametrize("loop_thread", [True, False])
def test_a_run_in_real_time_leaves_the_process_as_it_was(loop_thread: bool) -> None:
    seen: list[bool] = []
    interval, threads = sys.getswitchinterval(), set(threading.enumerate())
    backend = MockBackend(faults={5: broken})
    time = SteppedTime()
    with (
        time.flowing(),
        active(backend, time=time, loop_thread=loop_thread) as session,
    ):
        assert gc.get_freeze_count() > 1000
        with pytest.raises(ZeroDivisionError):
            session.run(100, on_tick=lambda *_: seen.append(gc.isenabled()))
    assert seen == [False] * len(seen)
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert sys.getswitchinterval() == interval
    assert set(threading.enumerate()) == threads


@pytest.mark.parametrize("loop_thread", [True, False])
def test_garbage_of_a_run_in_real_time_is_collected_meanwhile(loop_thread: bool) -> None:
    """A robot may be active for hours, and Python's own collector waits for the end."""
    freed: list[int] = []

    class Circle:
        def __init__(self, number: int) -> None:
            self.number, self.me = number, self

        def __del__(self) -> None:
            freed.append(self.number)

    time = SteppedTime()
    with time.flowing(), active(time=time, loop_thread=loop_thread) as session:
        for number in range(3):
            Circle(number)
            session.run(COLLECTION_PERIOD + 1)
        # On a busy machine one collection may find two of them, in any order.
        assert {0, 1} <= set(freed)


def test_a_slow_tick_is_missed_counted_and_reported() -> None:
    """One tick of 100 ms costs eight."""
    time = SteppedTime()

    def think(tick: Tick, _: object) -> None:
        time.now += 100_000_000 * (tick.measurement.tick == 4)

    with active(time=time) as session:
        session.run(10, think)
        statistics = session.loop.times.statistics
    assert statistics.ticks == 10
    assert statistics.missed == 8


HEAD = ROBOT.joint_index("HeadYaw")


class Rising(MockBackend):
    """Gets up before it is held, as a robot does that is woken up."""

    @property
    def hold_position(self) -> FloatArray:
        return ROBOT.posture("Stand") + np.where(np.arange(17) == HEAD, 0.3, 0.0)

    def activate(self) -> Measurement:
        self.position = self.hold_position
        return super().activate()


def test_a_robot_that_got_up_while_it_was_activated_is_not_sent_back_to_where_it_was() -> None:
    backend = Rising()
    with active(backend) as session:
        session.run(3)
    for command in backend.commands:
        np.testing.assert_allclose(command.position, backend.hold_position, atol=1e-6)
