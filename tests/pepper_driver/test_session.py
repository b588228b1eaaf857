"""One active run: what is started is ended, in the right order, whatever fails."""

from collections.abc import Callable
from pathlib import Path

import pytest

from pepper_driver.backends import BackendError, Measurement
from pepper_driver.callbacks import Dispatcher
from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings
from pepper_driver.log import LogWriter, read_log
from pepper_driver.observer import Observation
from pepper_driver.reflexes import Control, Reflex
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
    return Session(
        backend,
        ROBOT,
        load_controller_settings(ROBOT),
        gate or make_gate(),
        observer=None,
        reflexes=reflexes,
        log=log,
        subscriptions=[(lambda _: None, lambda _: True)],
        paced=False,
    )


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was ended, in order; a backend made with these calls adds its own."""
    calls: list[str] = []
    end_log, end_callbacks = LogWriter.close, Dispatcher.close

    def close_log(self: LogWriter) -> None:
        calls.append("log")
        end_log(self)

    def close_dispatcher(self: Dispatcher, timeout: float | None = None) -> bool:
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
    """Cannot be reset."""

    def step(self, observation: Observation, measurement: Measurement, control: Control) -> None:
        pass

    def reset(self) -> None:
        raise ZeroDivisionError("a user's mistake")


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
