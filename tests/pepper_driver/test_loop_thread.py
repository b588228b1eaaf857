"""A robot in real time ticks by itself, from the start to the end, whatever the program does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import FaultError, Pepper, Reflex
from pepper_driver.backends import BackendError, Measurement, NotConnectedError
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import FaultEvent
from pepper_driver.controller import PositionTask, Tick
from pepper_driver.log import read_log
from pepper_driver.observer import Observation
from pepper_driver.reflexes import ReflexRequests
from pepper_driver.safety import RobotState
from pepper_driver.testing import aged
from support import robots
from support.sessions import (
    ROBOT,
    Scripted,
    SteppedTime,
    backend_of,
    begun,
    in_thread,
    stepped_time,
)
from support.waiting import PATIENCE, wait_until

HEAD = ROBOT.joint_index("HeadYaw")


@pytest.fixture
def time() -> Iterator[SteppedTime]:
    with stepped_time() as time:
        yield time


def make_pepper(**arguments: Any) -> Pepper:
    return robots.make_pepper(real_time=True, **arguments)


def running(pepper: Pepper, call: Callable[[], object]) -> Any:
    """Call in another thread what waits for ticks, and return when it waits."""
    thread = in_thread(call)
    assert wait_until(lambda: begun(pepper) or not thread.is_alive())
    return thread


# -- ticks ----------------------------------------------------------------------------------------------------------


def test_it_ticks_before_between_during_and_after_what_the_program_does(
    time: SteppedTime, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    pepper = make_pepper(log=path)
    with pepper:
        time.wait_for_sleeper()
        time.advance(1.2)  # the program thinks
        pepper.set_posture({"HeadYaw": 0.5}, duration=1.0)
        time.advance(1.2)
        assert pepper.position["HeadYaw"] == pytest.approx(0.5, abs=1e-3)
        run = running(pepper, lambda: pepper.run(0.6))
        time.advance(0.6)
        assert run.result() is False
        time.advance(0.6)
        ticks = round(3.6 / ROBOT.cycle) + 1
        assert pepper.statistics.ticks == ticks
        assert pepper.statistics.missed == 0
        assert time.now == 3_600_000_000
    log = read_log(path)
    assert len(log) >= ticks, "a few may begin as it is left"
    assert log["tick"].tolist() == list(range(1, len(log) + 1))
    np.testing.assert_allclose(np.diff(log["time"]), ROBOT.cycle)
    assert not log["missed"].any()
    assert backend_of(pepper).calls == ["open", "activate", "close"]


def test_a_run_waits_that_long_and_until_ends_it_early(time: SteppedTime) -> None:
    with make_pepper() as pepper:
        time.wait_for_sleeper()
        run = running(pepper, lambda: pepper.run(0.6))
        time.advance(0.588)
        assert run.is_alive()
        assert begun(pepper)
        time.advance(0.012)
        assert run.result() is False
        end = pepper.time + 0.3
        run = running(pepper, lambda: pepper.run(0.6, until=lambda: pepper.time >= end - 1e-9))
        time.advance(0.3)
        assert run.result() is True
        assert pepper.time == pytest.approx(end)
        assert pepper.run(0.0) is False, "it waits for nothing"


def test_a_step_waits_for_the_next_tick(time: SteppedTime) -> None:
    with make_pepper(observer=Scripted()) as pepper:
        time.wait_for_sleeper()
        for _ in range(3):
            tick = pepper.measurement.tick
            step = running(pepper, pepper.step)
            time.advance(ROBOT.cycle)
            measurement, observation = step.result()
            assert measurement.tick == tick + 1
            assert measurement is pepper.measurement
            assert observation is pepper.observation is not None


class Slow(Scripted):
    """Thinks in its fifth tick until it may go on, once it is awake."""

    def __init__(self) -> None:
        super().__init__()
        self.awake = False
        self.inside, self.go = threading.Event(), threading.Event()

    def step(self, tick: Tick) -> Observation:
        if self.awake and tick.measurement.tick == 5:
            self.inside.set()
            assert self.go.wait(PATIENCE)
        return super().step(tick)


def test_a_step_that_begins_inside_a_tick_waits_for_the_one_after_it(time: SteppedTime) -> None:
    """That one was read before; a motion would miss its first tick, or be asked before it has begun."""
    observer = Slow()
    pepper = make_pepper(observer=observer)  # which tries it
    observer.awake = True
    with pepper:
        with time.flowing():
            assert observer.inside.wait(PATIENCE)
        step = in_thread(pepper.step)
        assert wait_until(lambda: pepper._changes._waiting)
        observer.go.set()
        time.wait_for_sleeper()
        assert wait_until(lambda: not pepper._changes._waiting)
        time.advance(ROBOT.cycle)
        measurement, _ = step.result()
        assert measurement.tick == 6


def test_what_is_changed_before_a_step_is_in_its_command(time: SteppedTime) -> None:
    with make_pepper() as pepper:
        time.wait_for_sleeper()
        commands = backend_of(pepper).commands
        pepper.set_posture({"HeadYaw": 0.5})
        count = len(commands)
        step = running(pepper, pepper.step)
        time.advance(ROBOT.cycle)
        step.result()
        assert len(commands) == count + 1
        assert commands[-1].position[HEAD] > commands[-2].position[HEAD]


def test_functions_of_a_run_are_called_inside_its_ticks(time: SteppedTime) -> None:
    threads: set[str] = set()
    seen: list[tuple[int, int]] = []

    def note(tick: Any, _: object) -> None:
        threads.add(threading.current_thread().name)
        seen.append((tick.measurement.tick, pepper.measurement.tick))
        pepper.set_posture({"HeadYaw": 0.1})  # waits for nothing

    def until() -> bool:
        threads.add(threading.current_thread().name)
        return False

    with make_pepper() as pepper:
        time.wait_for_sleeper()
        run = running(pepper, lambda: pepper.run(0.06, on_tick=note, until=until))
        time.advance(0.12)
        run.result()
    assert threads == {"loop"}
    assert len(seen) == 5
    assert all(tick == newest for tick, newest in seen)


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("where", ["on_tick", "until"])
def test_what_they_raise_is_raised_in_the_run_and_the_robot_ticks_on(
    where: str, error: type[BaseException], time: SteppedTime
) -> None:
    def fail(*_: object) -> bool:
        raise error("a user's mistake")

    with make_pepper() as pepper:
        time.wait_for_sleeper()
        run = running(pepper, lambda: pepper.run(1.0, **{where: fail}))
        time.advance(0.12)
        with pytest.raises(error, match="mistake"):
            run.result()
        ticks = pepper.statistics.ticks
        time.advance(0.6)
        assert pepper.statistics.ticks == ticks + 50
        assert pepper.state is RobotState.ACTIVE
        run = running(pepper, lambda: pepper.run(0.12))
        time.advance(0.12)
        run.result()


def test_an_interrupted_wait_leaves_the_robot_ticking(time: SteppedTime) -> None:
    """As Ctrl-C in a notebook."""
    with make_pepper() as pepper:
        time.wait_for_sleeper()
        session = pepper._session
        assert session is not None

        def interrupted() -> None:
            raise KeyboardInterrupt

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(session, "_tick_until", lambda _: interrupted())
            with pytest.raises(KeyboardInterrupt):
                pepper.run(1.0)
        ticks = pepper.statistics.ticks
        time.advance(0.12)
        assert pepper.statistics.ticks == ticks + 10
        run = running(pepper, pepper.step)
        time.advance(ROBOT.cycle)
        run.result()


# -- faults ---------------------------------------------------------------------------------------------------------


def disconnect(measurement: Measurement) -> Measurement:
    raise NotConnectedError("the robot has left")


class Quitting(Reflex):
    """Ends its thread."""

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        if measurement.tick == 11:
            raise SystemExit("a user's mistake")


def faulty(
    kind: str, time: SteppedTime, faults: list[FaultEvent] | None = None
) -> tuple[Pepper, type[BaseException]]:
    """A robot that has a fault in its eleventh tick, and what that raises."""
    pepper = make_pepper(observer=Scripted(), reflexes=[Quitting()] if kind == "reflex" else [])
    if kind == "gate":
        backend_of(pepper).faults[11] = aged(0.2)
    elif kind == "backend":
        backend_of(pepper).faults[11] = disconnect
    if faults is not None:
        pepper.on_fault()(faults.append)
    return pepper, {"gate": FaultError, "backend": NotConnectedError, "reflex": SystemExit}[kind]


def inside(pepper: Pepper, *steps: Callable[[], object]) -> None:
    """Do one after the other while the robot is active."""
    with pepper:
        for step in steps:
            step()


KINDS = ["gate", "backend", "reflex"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_reaches_callbacks_at_once_and_the_robot_stands(
    kind: str, time: SteppedTime
) -> None:
    faults: list[FaultEvent] = []
    pepper, error = faulty(kind, time, faults)

    def look() -> None:
        assert wait_until(lambda: faults), "nothing of the facade was called"
        assert pepper.state is RobotState.FAULT
        commands = backend_of(pepper).commands
        assert np.abs(commands[8].wheel_speed).max() > 0.0
        assert not commands[-1].wheel_speed.any()
        assert pepper.measurement.tick in (10, 11), "what was read last can be read on"

    with pytest.raises(error):
        inside(
            pepper,
            time.wait_for_sleeper,
            lambda: pepper.drive(0.2, 0.0, 0.0, hold=True),
            lambda: time.advance(0.24),
            look,
        )
    assert len(faults) == 1
    if kind == "gate":
        assert "200 ms old" in faults[0].fault.text


CALLS: list[Callable[[Pepper], object]] = [
    lambda pepper: pepper.run(0.1),
    lambda pepper: pepper.run(0.0),
    lambda pepper: pepper.step(),
    lambda pepper: pepper.set_posture("Stand"),
    lambda pepper: pepper.drive(0.1, 0.0, 0.0),
    lambda pepper: pepper.add(PositionTask("l_wrist", root="base_link")),
    lambda pepper: pepper.play("wave"),
    lambda pepper: pepper.wait_for_contact(timeout=1.0),
    lambda pepper: pepper.clear_statistics(),
]


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_raised_by_the_next_call_and_then_not_in_the_end(
    kind: str, time: SteppedTime
) -> None:
    pepper, error = faulty(kind, time)
    with pepper:
        time.wait_for_sleeper()
        time.advance(0.24)
        for call in CALLS:
            with pytest.raises(error):
                call(pepper)
    assert backend_of(pepper).calls[-1] == "close"


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_ends_a_run_under_way(kind: str, time: SteppedTime) -> None:
    pepper, error = faulty(kind, time)
    with pepper:
        time.wait_for_sleeper()
        run = running(pepper, lambda: pepper.run(60.0))
        time.advance(0.24)
        with pytest.raises(error):
            run.result()


def test_a_fault_in_the_last_tick_of_a_run_is_raised_by_it(time: SteppedTime) -> None:
    pepper, error = faulty("gate", time)
    with pepper:
        time.wait_for_sleeper()
        run = running(pepper, lambda: pepper.run(0.12))  # ticks 2 to 11
        time.advance(0.24)
        with pytest.raises(error):
            run.result()


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_that_no_caller_saw_is_raised_in_the_end(kind: str, time: SteppedTime) -> None:
    pepper, error = faulty(kind, time)
    with pytest.raises(error):
        inside(pepper, time.wait_for_sleeper, lambda: time.advance(0.24))
    assert backend_of(pepper).calls[-1] == "close"
    pepper.stop()  # raises it no more


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_block_the_end_raises_it(kind: str, time: SteppedTime) -> None:
    pepper, error = faulty(kind, time)
    pepper.start()
    time.wait_for_sleeper()
    time.advance(0.24)
    with pytest.raises(error):
        pepper.stop()
    assert backend_of(pepper).calls[-1] == "close"
    pepper.stop()


def test_without_a_block_too_it_never_comes_in_place_of_an_error_under_way(
    time: SteppedTime,
) -> None:
    def work() -> None:
        pepper.start()
        try:
            time.wait_for_sleeper()
            time.advance(0.24)
            raise KeyError("the program's own")
        finally:
            pepper.stop()

    pepper, _ = faulty("gate", time)
    with pytest.raises(KeyError, match="the program's own"):
        work()


def test_a_callback_may_stop_a_robot_that_has_a_fault(
    time: SteppedTime, caplog: pytest.LogCaptureFixture
) -> None:
    pepper, error = faulty("gate", time)
    pepper.on_fault()(lambda _: pepper.stop())
    pepper.start()
    time.wait_for_sleeper()
    time.advance(0.24)
    assert wait_until(lambda: backend_of(pepper).calls[-1] == "close")
    with pytest.raises(error):
        pepper.stop()
    assert "failed" not in caplog.text


def test_a_fault_that_only_a_callback_saw_is_raised_in_the_end(time: SteppedTime) -> None:
    pepper, error = faulty("gate", time)
    seen: list[BaseException] = []

    @pepper.on_fault()
    def react(_: object) -> None:
        try:
            pepper.set_posture("Stand")
        except FaultError as fault:
            seen.append(fault)

    with pytest.raises(error):
        inside(
            pepper,
            time.wait_for_sleeper,
            lambda: time.advance(0.24),
            lambda: wait_until(lambda: seen),
        )
    assert seen


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_never_comes_in_place_of_an_error_under_way(kind: str, time: SteppedTime) -> None:
    pepper, _ = faulty(kind, time)

    def fail() -> None:
        assert pepper.state is RobotState.FAULT
        raise KeyError("the program's own")

    with pytest.raises(KeyError, match="the program's own"):
        inside(pepper, time.wait_for_sleeper, lambda: time.advance(0.24), fail)
    assert backend_of(pepper).calls[-1] == "close"


def test_an_emergency_stop_from_the_program_is_raised_too(time: SteppedTime) -> None:
    faults: list[FaultEvent] = []
    pepper = make_pepper()
    pepper.on_fault()(faults.append)
    with pytest.raises(FaultError, match="too close"):
        inside(
            pepper,
            time.wait_for_sleeper,
            lambda: pepper.emergency_stop("too close"),
            lambda: wait_until(lambda: faults),  # before the next tick
            lambda: time.advance(0.024),
        )
    assert len(faults) == 1


@pytest.mark.parametrize("real_time", [False, True])
def test_an_emergency_stop_just_before_the_end_is_raised_and_logged(
    real_time: bool, time: SteppedTime, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    pepper = Pepper("mock", observer=None, real_time=real_time, log=path)
    with pytest.raises(FaultError, match="too close"):
        inside(
            pepper,
            lambda: pepper.drive(0.2, 0.0, 0.0, hold=True),
            lambda: pepper.emergency_stop("too close"),
        )
    (event,) = read_log(path).events
    assert (event.kind, event.text) == ("fault", "too close")
    assert not backend_of(pepper).commands[-1].wheel_speed.any()
    pepper.stop()


def test_a_fault_that_a_wait_has_raised_is_not_raised_in_the_end() -> None:
    with Pepper("mock", observer=Scripted()) as pepper:
        pepper.emergency_stop()
        with pytest.raises(FaultError):
            pepper.wait_for_contact(timeout=1.0)


def test_a_robot_can_be_started_again_after_a_fault(time: SteppedTime) -> None:
    pepper, error = faulty("gate", time)
    with pytest.raises(error):
        inside(pepper, time.wait_for_sleeper, lambda: time.advance(0.24))
    backend_of(pepper).faults.clear()
    with pepper:
        time.wait_for_sleeper()
        time.advance(0.24)
        assert pepper.state is RobotState.ACTIVE


def test_the_loop_ticks_on_its_own_wherever_time_passes_by_itself() -> None:
    robot = MockBackend(real_time=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pepper_driver.robot.make_backend", lambda *_: robot)
        assert Pepper("any", observer=None)._loop_thread
        assert not Pepper("any", observer=None, loop="caller")._loop_thread
    assert Pepper("mock", observer=None, real_time=True)._loop_thread
    assert not Pepper("mock", observer=None)._loop_thread


@pytest.mark.parametrize(
    "arguments",
    [{"loop": "thread"}, {"loop": "main"}, {"loop": ""}, {"loop": "main", "real_time": True}],
)
def test_other_loops_are_refused(arguments: dict[str, Any]) -> None:
    with pytest.raises(BackendError, match="loop is 'thread' or 'caller'"):
        Pepper("mock", observer=None, **arguments)
