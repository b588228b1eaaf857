"""One active run: what is started is ended, in the right order, whatever fails."""

import gc
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pepper_driver.pacing import Pacer, RealTimePacer

from pepper_driver.backends import BackendError, BackendInfo, Command, Measurement
from pepper_driver.callbacks.dispatcher import Dispatcher, Subscription
from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.log import LogWriter, read_log
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.reflexes import Control, Reflex, Reflexes
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError, FaultReason, RobotState, SafetyGate
from pepper_driver.session import Session

from fakes import FakeBackend  # isort: skip

ROBOT = load_robot()


def make_gate() -> SafetyGate:
    return SafetyGate(ROBOT, load_safety_settings(), load_controller_settings(ROBOT))


def make_session(
    backend: FakeBackend,
    log: Path | None = None,
    reflexes: tuple[Reflex, ...] = (),
    gate: SafetyGate | None = None,
) -> Session:
    dispatcher = Dispatcher()
    dispatcher.subscribe(lambda _: None, Subscription(Contact))
    return Session(
        backend,
        ROBOT,
        load_controller_settings(ROBOT),
        gate or make_gate(),
        observer=None,
        reflexes=Reflexes(reflexes, ROBOT),
        log=log,
        metadata={},
        dispatcher=dispatcher,
        pacer=Pacer(),
    )


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was ended, in order; a backend made with these calls adds its own."""
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


class Fragile(FakeBackend):
    """Fails at one step; its calls go to a list that others write to as well."""

    def __init__(self, calls: list[str], fails_at: str = "") -> None:
        super().__init__()
        self.calls, self.fails_at = calls, fails_at

    def open(self) -> Measurement:
        return self._checked("open", super().open())

    def activate(self) -> Measurement:
        return self._checked("activate", super().activate())

    def close(self) -> None:
        super().close()
        self._checked("close", self._measure(self.position))

    def _checked(self, step: str, measurement: Measurement) -> Measurement:
        if step == self.fails_at:
            raise BackendError(f"{step} fails")
        return measurement


class Unwilling(Reflex):
    """Cannot be reset once it is prepared."""

    prepared = False

    def step(self, observation: Observation, measurement: Measurement, control: Control) -> None:
        pass

    def reset(self) -> None:
        if self.prepared:
            raise ZeroDivisionError("a user's mistake")
        self.prepared = True


def test_the_robot_ends_first_and_only_once(tmp_path: Path, ended: list[str]) -> None:
    path = tmp_path / "run.mcap"
    gate = make_gate()
    session = make_session(Fragile(ended), path, gate=gate)
    assert session.active
    assert gate.state is RobotState.ACTIVE
    session.run(range(5), None, None)
    session.close()
    assert ended == ["open", "activate", "close", "log", "callbacks"]
    assert not session.active
    assert gate.state is RobotState.INACTIVE
    assert read_log(path).complete
    session.close()
    assert ended[5:] == ["close"]  # which does nothing in a backend that is closed


def test_a_robot_that_fails_to_close_leaves_neither_log_nor_callbacks_open(
    tmp_path: Path, ended: list[str]
) -> None:
    path = tmp_path / "run.mcap"
    session = make_session(Fragile(ended, "close"), path)
    session.run(range(5), None, None)
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
        make_session(Fragile(ended, fails_at), tmp_path / "run.mcap")
    assert ended == calls


def test_a_start_that_fails_with_the_robot_stiff_is_undone(
    tmp_path: Path, ended: list[str]
) -> None:
    with pytest.raises(ZeroDivisionError):
        make_session(Fragile(ended), tmp_path / "run.mcap", (Unwilling(),))
    assert ended == ["open", "activate", "close", "log", "callbacks"]


def test_a_fault_outlasts_the_session() -> None:
    gate = make_gate()
    session = make_session(FakeBackend(), gate=gate)
    gate.stop(FaultReason.EMERGENCY_STOP, "emergency stop")
    session.close()
    assert gate.state is RobotState.FAULT


class Stopped(Fragile):
    """Somebody presses stop while the robot is getting stiff."""

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
        pepper.activate()
    assert ended == ["open", "activate", "close", "callbacks"]
    assert pepper.state is RobotState.FAULT


class Recorder(FakeBackend):
    """Notes every call, those of a reflex and of listeners too."""

    def __init__(self, real_time: bool, calls: list[str]) -> None:
        super().__init__()
        self._real_time, self.calls = real_time, calls

    @property
    def info(self) -> BackendInfo:
        return replace(super().info, real_time=self._real_time)

    def step(self, command: Command) -> Measurement:
        self.calls.append(f"step {command.position[6]:.6f}")
        return super().step(command)


class Noting(Observer):
    def __init__(self, calls: list[str]) -> None:
        self.calls = calls

    def step(self, tick: Tick) -> Observation:
        self.calls.append("observe")
        nan = np.full(17, np.nan)
        return Observation(
            contacts=(),
            expected=nan,
            residual=nan,
            threshold=nan,
            torque=nan,
            torque_std=nan,
            state=np.zeros(17, dtype=np.int8),
        )

    def reset(self) -> None:
        self.calls.append("reset")

    def describe(self) -> str:
        return "notes its calls"


class Reacting(Reflex):
    def __init__(self, calls: list[str]) -> None:
        self.calls = calls

    def step(self, observation: Observation, measurement: Measurement, control: Control) -> None:
        self.calls.append("react")

    def reset(self) -> None:
        pass


def calls_of_a_run(monkeypatch: pytest.MonkeyPatch, *, real: bool, paced: bool) -> list[str]:
    """All that is called in a run of a backend, by a clock that stands still but for sleeping."""
    calls: list[str] = []
    now = 0

    def sleep(seconds: float) -> None:
        nonlocal now
        now += round(seconds * 1e9)

    monkeypatch.setattr(
        "pepper_driver.robot.RealTimePacer",
        lambda cycle, **_: RealTimePacer(cycle, clock=lambda: now, sleep=sleep),
    )
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: Recorder(real, calls))
    reflex = Reacting(calls)
    with Pepper("any", observer=Noting(calls), reflexes=[reflex], real_time=paced) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.5})
        pepper.run(0.12, on_tick=lambda *_: calls.append("listen"))
        pepper.run(1.2, until=lambda: calls.append("until?") or len(calls) > 100)  # type: ignore[func-returns-value]
        assert pepper.statistics.missed == 0
    assert now == (pepper.statistics.ticks - 1) * 12_000_000 * (real or paced)
    return calls


def test_all_backends_see_the_same_calls_in_the_same_order(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = calls_of_a_run(monkeypatch, real=False, paced=False)
    assert simulated[:3] == ["open", "activate", "reset"]
    assert [call.split()[0] for call in simulated[3:7]] == ["step", "observe", "react", "listen"]
    assert len(simulated) > 100
    assert calls_of_a_run(monkeypatch, real=True, paced=False) == simulated
    assert calls_of_a_run(monkeypatch, real=False, paced=True) == simulated


def broken(measurement: Measurement) -> Measurement:
    raise ZeroDivisionError("a driver's mistake")


def test_a_run_in_real_time_leaves_the_process_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    interval = sys.getswitchinterval()
    backend = Recorder(True, [])
    backend.faults[5] = broken
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: backend)
    with Pepper("any", observer=None) as pepper, pytest.raises(ZeroDivisionError):
        pepper.run(1.0, on_tick=lambda *_: seen.append(gc.isenabled()))
    assert seen == [False] * 4
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert sys.getswitchinterval() == interval


def test_a_slow_tick_is_missed_counted_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the real clock: one tick of 100 ms costs at least seven, whatever else the machine does."""
    backend = Recorder(True, [])
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: backend)
    with Pepper("any", observer=None) as pepper:
        pepper.run(
            0.12, on_tick=lambda tick, _: time.sleep(0.1 if tick.measurement.tick == 4 else 0)
        )
        statistics = pepper.statistics
    assert statistics.ticks == 10
    assert statistics.missed >= 7
    assert statistics.late["deliver"] >= 1
    assert statistics.end is not None
    assert statistics.end.largest >= 100


HEAD = ROBOT.joint_index("HeadYaw")


class Rising(FakeBackend):
    """Gets up before it is held, as a robot does that is woken up."""

    @property
    def held(self) -> FloatArray:
        return self.robot.posture("Stand") + np.where(np.arange(17) == HEAD, 0.3, 0.0)

    def activate(self) -> Measurement:
        self.position = self.held
        return super().activate()


def test_a_robot_that_got_up_while_it_was_activated_is_not_sent_back_to_where_it_was() -> None:
    backend = Rising()
    session = make_session(backend)
    session.run(range(3), None, None)
    session.close()
    for command in backend.commands:
        np.testing.assert_allclose(command.position, backend.held, atol=1e-6)
