"""A robot whose caller ticks: it comes to rest while no ticks come; unpaced, time passes in ``run`` alone."""

from __future__ import annotations

import signal
import threading
import time as clock
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pepper_driver import FaultError, Hold, Pepper
from pepper_driver.backends import BackendError, Command
from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import FaultEvent
from pepper_driver.config import load_controller_settings, load_safety_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import PositionTask
from pepper_driver.log import read_log
from pepper_driver.safety import RobotState
from pepper_driver.session import Session
from pepper_driver.testing import aged
from support.sessions import ROBOT, SteppedTime, active, backend_of, in_thread, stepped_time
from support.waiting import wait_until

SETTINGS = load_controller_settings(ROBOT)
MAX_SILENCE = load_safety_settings().caller_silence
LIMIT = SETTINGS.joint_acceleration(ROBOT)
BASE_LIMIT = 0.3
"""[m/s2]"""
ROLL = ROBOT.joint_index("LShoulderRoll")


def acceleration(commands: list[Command]) -> FloatArray:
    """(ticks, 17) of the joints [rad/s2], as commanded."""
    positions = np.array([command.position for command in commands])
    return np.diff(positions, 2, axis=0) / ROBOT.cycle**2


def base_speed(commands: list[Command]) -> FloatArray:
    """(ticks,) forwards [m/s], as commanded."""
    return np.array([(ROBOT.wheels.inverse @ command.wheel_speed)[0] for command in commands])


def fall_silent(session: Session, time: SteppedTime) -> None:
    """Let so much time pass without a tick that the session's thread ticks."""
    assert not time.sleeping, "it is the caller that ticks"
    time.now += round(1.02e9 * MAX_SILENCE)
    time.wait_for_sleeper()
    assert session.loop.arbiter.paused


def set_out(session: Session) -> None:
    """Turn an arm and drive the base, until both are on their way."""
    target = session.loop.arbiter.target.copy()
    target[ROLL] += 1.0
    session.loop.arbiter.move_to(target)
    session.loop.arbiter.drive(np.array([0.2, 0.0, 0.0]))
    session.run(60)
    assert session.loop.arbiter.controller.velocity[ROLL] > 0.2
    assert session.loop.arbiter.controller.model.v[0] > 0.15


def test_while_the_caller_is_silent_the_robot_comes_to_rest_and_then_goes_on(
    tmp_path: Path,
) -> None:
    path, robot, time = tmp_path / "run.mcap", MockBackend(), SteppedTime()
    with active(robot, time=time, log=path) as session:
        set_out(session)
        moving = len(robot.commands)
        fall_silent(session, time)
        time.advance(3.0)
        resting = len(robot.commands)
        assert resting - moving == pytest.approx(3.0 / ROBOT.cycle, abs=6), "it ticks on"
        rest = np.array([command.position for command in robot.commands[resting - 50 :]])
        assert np.ptp(rest, axis=0).max() < 1e-4
        assert np.abs(base_speed(robot.commands[resting - 50 :])).max() < 1e-3
        assert rest[-1][ROLL] < robot.commands[0].position[ROLL] + 0.8, "it is not there yet"
        with time.flowing():
            session.run(400)
        assert not session.loop.arbiter.paused
        statistics = session.loop.times.statistics
    # It sets out again, and gets there.
    assert robot.commands[-1].position[ROLL] == pytest.approx(
        robot.commands[0].position[ROLL] + 1.0, abs=0.01
    )
    assert base_speed(robot.commands)[-1] == pytest.approx(0.2, abs=0.01)
    # Nowhere in between does it jump.
    assert (np.abs(acceleration(robot.commands)) <= LIMIT + 1e-6).all()
    assert np.abs(np.diff(base_speed(robot.commands))).max() <= BASE_LIMIT * ROBOT.cycle + 1e-9
    braking = np.array([command.position[ROLL] for command in robot.commands[moving:resting]])
    assert (np.diff(braking) > -1e-9).all(), "it does not turn round"
    # 60 ms without ticks are five that were missed; all others are in the log.
    assert 4 <= statistics.missed <= 5
    log = read_log(path)
    assert len(log) == statistics.ticks
    assert log["missed"][-1] == statistics.missed


@pytest.mark.parametrize("silence", [0.0, 0.011, 0.03, 0.059])
def test_who_calls_step_now_and_then_is_not_silent(silence: float) -> None:
    """By the robot's clock; on this one the session's thread gets time to be wrong."""
    robot, time = MockBackend(), SteppedTime()
    with active(robot, time=time) as session:
        set_out(session)
        for _ in range(5):
            time.now += round(1e9 * silence)
            clock.sleep(1.5 * MAX_SILENCE)
            assert not time.sleeping
            session.run(1)
            assert not session.loop.arbiter.paused
        assert session.loop.arbiter.controller.velocity[ROLL] > 0.2


def test_a_tick_that_takes_long_is_not_silence() -> None:
    robot, time = MockBackend(), SteppedTime()

    def think(*_: object) -> None:
        time.now += 200_000_000
        clock.sleep(1.5 * MAX_SILENCE)
        assert not time.sleeping

    with active(robot, time=time) as session:
        set_out(session)
        session.run(3, think)
        clock.sleep(1.5 * MAX_SILENCE)
        assert not time.sleeping, "the caller has just ticked"
        assert session.loop.times.statistics.ticks == 63


def test_tasks_stand_still_meanwhile_and_go_on() -> None:
    time = SteppedTime()
    with active(time=time) as session:
        controller = session.loop.arbiter.controller
        task = PositionTask("l_wrist", root="base_link")
        controller.add(task)
        session.run(1)
        goal = task.target + np.full(3, 0.1)
        task.move_to(goal, 2.0)
        session.run(60)
        fall_silent(session, time)
        time.advance(2.0)
        assert np.abs(controller.velocity).max() < 1e-3
        assert np.linalg.norm(task.error) < 1.0
        assert np.linalg.norm(task.target - goal) > 0.02
        with time.flowing():
            session.run(400)
        assert task.reached(0.005)


def test_reflexes_and_faults_are_watched_on_and_reported() -> None:
    faults: list[FaultEvent] = []
    with stepped_time() as time:
        pepper = Pepper("mock", observer=None, real_time=True, loop="caller")
        pepper.on_fault()(faults.append)
        with pepper:
            pepper.run(0.12)
            backend_of(pepper).faults[20] = aged(0.2)
            assert pepper._session is not None
            fall_silent(pepper._session, time)
            time.advance(0.3)
            assert wait_until(lambda: faults)
            assert pepper.state is RobotState.FAULT
            with pytest.raises(FaultError):
                pepper.step()
    assert len(faults) == 1


def test_a_fault_that_the_caller_has_seen_is_not_raised_again_in_the_end() -> None:
    with stepped_time() as time:
        pepper = Pepper("mock", observer=None, real_time=True, loop="caller")
        backend_of(pepper).faults[5] = aged(0.2)
        with pepper:
            with pytest.raises(FaultError):
                pepper.run(0.12)
            time.now += 200_000_000
            clock.sleep(2 * MAX_SILENCE)


def test_a_thread_that_waits_for_the_turn_gets_it_from_the_resting_robot() -> None:
    time = SteppedTime()
    with active(time=time) as session:
        session.run(1)
        fall_silent(session, time)
        with time.flowing():
            in_thread(lambda: session.run(10)).result()
            session.run(10)
        assert not session.loop.arbiter.paused


def test_a_robot_that_rests_can_be_closed_at_any_time() -> None:
    time = SteppedTime()
    threads = set(threading.enumerate())
    robot = MockBackend()
    with active(robot, time=time) as session:
        session.run(1)
        fall_silent(session, time)
        with time.flowing():
            session.close()
    assert robot.calls[-1] == "close"
    assert set(threading.enumerate()) == threads


def test_a_handler_of_a_signal_can_stop_the_robot_that_its_thread_runs(
    caplog: pytest.LogCaptureFixture,
) -> None:
    pepper = Pepper("mock://", observer=None, real_time=True, loop="caller")
    before = signal.signal(signal.SIGUSR1, lambda *_: pepper.stop())
    try:
        with pepper:
            timer = threading.Timer(0.2, lambda: signal.raise_signal(signal.SIGUSR1))
            timer.start()
            with pytest.raises(BackendError, match="was closed while it ran"):
                pepper.run(30.0)
            timer.join()
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert "does not end" not in caplog.text, "nothing seems to hang"
    assert pepper.state is RobotState.INACTIVE
    assert backend_of(pepper).calls[-1] == "close"
    wait_until(lambda: not [each for each in threading.enumerate() if each.name == "loop"])


def test_it_does_not_rest_before_its_time() -> None:
    """A start takes long; the silence begins with its end."""
    time = SteppedTime()

    class Slow(MockBackend):
        def activate(self) -> object:  # type: ignore[override]
            time.now += 2_000_000_000
            return super().activate()

    with active(Slow(), time=time) as session:
        clock.sleep(1.5 * MAX_SILENCE)
        assert not time.sleeping
        session.run(1)
        assert session.loop.times.statistics.missed == 0


# -- no pacing ------------------------------------------------------------------------------------------------------


def test_without_pacing_nothing_happens_outside_run_and_step() -> None:
    threads = set(threading.enumerate())
    with Pepper("mock", observer=None) as pepper:
        pepper.drive(0.2, 0.0, 0.0, hold=True)
        pepper.run(0.12)
        before = (pepper.time, len(backend_of(pepper).commands))
        clock.sleep(3 * MAX_SILENCE)
        assert (pepper.time, len(backend_of(pepper).commands)) == before
        assert pepper.statistics.end is None
        pepper.step()
        assert pepper.time == pytest.approx(before[0] + ROBOT.cycle)
        names = {thread.name for thread in set(threading.enumerate()) - threads}
        assert names <= {"callbacks", "signals"}


def sent(drive: Callable[[Pepper], object]) -> bytes:
    """All that a simulated robot that is touched reports, in one text."""
    kept: list[bytes] = []
    with Pepper("mujoco://?plant=integral&seed=3", reflexes=[Hold()]) as pepper:
        pepper.push("LBicep", [0.0, 25.0, 0.0], [0.16, 0.0, 0.0], 0.8, frame="link", delay=0.3)
        pepper.set_posture({"LShoulderRoll": 0.9}, duration=1.0)
        write = pepper.backend.write

        def note(command: Command) -> None:
            kept.append(command.position.tobytes() + command.wheel_speed.tobytes())
            write(command)

        pepper.backend.write = note  # type: ignore[method-assign]
        drive(pepper)
        assert pepper.contact_history
    return b"".join(kept)


def test_it_repeats_bit_for_bit_however_it_is_run() -> None:
    def in_steps(pepper: Pepper) -> None:
        for _ in range(100):
            pepper.step()

    def in_pieces(pepper: Pepper) -> None:
        for _ in range(10):
            pepper.run(0.12)
            clock.sleep(0.002)

    whole = sent(lambda pepper: pepper.run(1.2))
    assert sent(lambda pepper: pepper.run(1.2)) == whole
    assert sent(in_steps) == whole
    assert sent(in_pieces) == whole
    assert sent(lambda pepper: in_thread(lambda: pepper.run(1.2)).result()) == whole


def test_paced_or_not_a_simulation_does_the_same() -> None:
    """By a clock that costs no time, where the caller ticks."""

    def commands(*, paced: bool) -> list[bytes]:
        with stepped_time():
            with Pepper("mock", observer=None, real_time=paced, loop="caller") as pepper:
                pepper.set_posture({"LShoulderRoll": 0.9})
                pepper.drive(0.2, 0.0, 0.1)
                pepper.run(1.2)
                for _ in range(10):
                    pepper.step()
            return [c.position.tobytes() for c in backend_of(pepper).commands]

    assert commands(paced=True) == commands(paced=False)


def test_steps_are_whole_cycles_of_the_clock() -> None:
    with stepped_time() as time:
        with Pepper("mock", observer=None, real_time=True, loop="caller") as pepper:
            times = []
            for _ in range(10):
                pepper.step()
                times.append(time.now)
        assert {b - a for a, b in pairwise(times)} == {12_000_000}
