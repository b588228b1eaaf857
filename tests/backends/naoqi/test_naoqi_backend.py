"""The backend over real qi, against the stand-in and its black box. Bounds are generous: others use the machine too."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import (
    Backend,
    BackendError,
    CapabilityError,
    Command,
    Measurement,
    NotConnectedError,
    make_backend,
)
from pepper_driver.backends.naoqi.qi_library import QI_PRIORITY, THREADS, preferred
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import (
    ConfigError,
    UnknownNameError,
    load_naoqi_settings,
    load_robot,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import Contact
from pepper_driver.realtime import (
    RealTimePacer,
    priority_obstacle,
    realtime_process,
    realtime_thread,
)
from support.processes import suspend
from support.stand_ins import PATIENT, SILENCE, patient_driver, since
from support.waiting import wait_until

ROBOT = load_robot()
ONES, STILL = np.ones(17), np.zeros(3)
SMART = 0.69
"""What ALMotion's smart stiffness leaves to joints that stand is above it."""
LEGS = np.array([name in ROBOT.chains["legs"] for name in ROBOT.joint_names])


@pytest.fixture(autouse=True, scope="module")
def _patient() -> Iterator[None]:
    with patient_driver():
        yield


@pytest.fixture(scope="module")
def robot(wake_up: Callable[[StandIn], None]) -> Iterator[StandIn]:
    """Awake, and its owner allows all: as a robot is that somebody works with."""
    with StandIn("mujoco://?seed=3", consent=True) as running:
        wake_up(running)
        yield running


@pytest.fixture
def backend(robot: StandIn) -> Iterator[Backend]:
    backend = make_backend(f"naoqi://127.0.0.1:{robot.port}")
    yield backend
    backend.close()


def run(
    backend: Backend,
    ticks: int,
    position: Callable[[int], FloatArray],
    wheels: FloatArray = STILL,
    stiffness: FloatArray = ONES,
    until: Callable[[Measurement], bool] = lambda _: False,
) -> list[Measurement]:
    """Ticks in real time."""
    pacer, measured = RealTimePacer(ROBOT.cycle, backend), []
    with realtime_process(), realtime_thread():
        for tick in range(ticks):
            pacer.wait()
            measured.append(backend.read())
            command = Command(position=position(tick), stiffness=stiffness, wheel_speed=wheels)
            backend.write(command)
            if until(measured[-1]):
                break
    return measured


def held(measurement: Measurement) -> FloatArray:
    return np.clip(measurement.position, ROBOT.lower, ROBOT.upper)


def assert_let_go(box: BlackBox) -> None:
    """Arms, head and wheels went soft, and gently; the legs did not.

    What ALMotion then does is its own: it gives them stiffness in the next cycle, or in the very one in which they lost
    the last of it.
    """
    assert box.stiffness[:, LEGS].min() >= SMART
    stiffest = box.stiffness[:, ~LEGS].max(axis=1)
    soft = int(np.argmin(stiffest))
    assert stiffest[soft] < 0.2, stiffest.round(2).tolist()
    steps = (
        np.diff(box.stiffness[: soft + 1, ~LEGS], axis=0) / np.diff(box.cycle[: soft + 1])[:, None]
    )
    assert steps.min() > -0.15
    assert not box.wheel_stiffness[soft].any()


def test_a_variant_behind_the_stand_in_is_known_as_one(wake_up: Callable[[StandIn], None]) -> None:
    with StandIn("mujoco://?plant=drift&draw=5", consent=True) as robot:
        wake_up(robot)
        for mode, way in (("", ""), ("&mode=angles", "/angles")):
            info = make_backend(f"naoqi://127.0.0.1:{robot.port}?wake=1{mode}").info
            parents = make_backend("mujoco://?plant=drift&draw=5").info.parents
            assert len(parents) == 2
            assert info.parents == tuple(
                replace(parent, identity=parent.identity + way) for parent in parents
            )


def recent(robot: StandIn, seconds: float) -> BlackBox:
    time.sleep(0.1)  # what was said last is done
    return robot.black_box(round(seconds / ROBOT.cycle))


# -- who it is ----------------------------------------------------------------------------------------------------


def test_the_stand_in_is_known_as_the_robot_it_simulates(robot: StandIn, backend: Backend) -> None:
    info = backend.info
    assert info.identity == make_backend("mujoco").info.identity, "so its models apply"
    assert info.capabilities >= {"push", "grab"}
    assert "truth" not in info.capabilities
    assert backend.real_time
    assert info.response_delay == make_backend("mujoco").info.response_delay == 3
    other = make_backend(f"naoqi://127.0.0.1:{robot.port}?delay=5")
    assert other.info.response_delay == 5
    other.close()


@pytest.mark.parametrize(
    ("query", "word"),
    [
        ("delay=-1", "whole number"),
        ("delay=x", "whole number"),
        ("wake=2", "wake"),
        ("force=yes", "force"),
        ("dela=3", "delay"),
    ],
)
def test_a_wrong_key_is_told_before_anything_is_looked_for(query: str, word: str) -> None:
    with pytest.raises(ConfigError, match=word) as caught:
        make_backend(f"naoqi://127.0.0.1:1?{query}")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("qi")
def test_nobody_there_is_one_line() -> None:
    backend = make_backend("naoqi://127.0.0.1:1")
    with pytest.raises(NotConnectedError, match=r"127\.0\.0\.1") as caught:
        backend.open()
    assert "\n" not in str(caught.value)
    backend.close()


# -- one after the other ------------------------------------------------------------------------------------------


def test_before_activation_all_sensors_are_read_and_nothing_is_told(
    robot: StandIn, backend: Backend
) -> None:
    before = robot.black_box(1)
    begun = time.monotonic()
    first = backend.open()
    assert first.tick == 0
    wanted = held(first) + 0.2
    measured = run(backend, 60, lambda _: np.clip(wanted, ROBOT.lower, ROBOT.upper), np.ones(3))
    last = measured[-1]
    for name, size in (("position", 17), ("current", 17), ("temperature", 17), ("wheel_speed", 3)):
        values = getattr(last, name)
        assert values.shape == (size,)
        assert np.isfinite(values).all()
    assert np.linalg.norm(last.imu.acceleration) == pytest.approx(9.81, abs=0.3)
    assert last.touch.shape == (5,)
    assert last.buttons.tolist() == [0.0]
    assert 0.0 < last.battery <= 1.0
    assert last.charging_flap == 0.0
    assert last.response_delay is None
    assert 20.0 < last.temperature[0] < 60.0
    ticks = [measurement.tick for measurement in measured]
    assert np.diff(ticks).min() >= 0
    assert 30 < ticks[-1] <= (time.monotonic() - begun) / ROBOT.cycle
    box = robot.black_box(60)
    assert not box.wheel_command.any()
    np.testing.assert_allclose(box.position_command[-1], before.position_command[-1], atol=1e-3)


def test_activation_holds_and_deactivation_lets_all_go_but_the_legs(
    robot: StandIn, backend: Backend
) -> None:
    before = backend.open()
    after = backend.activate()
    assert np.abs(after.position - before.position).max() < np.radians(2.0)
    box = recent(robot, 3.0)
    np.testing.assert_allclose(box.stiffness[-1], 1.0)
    np.testing.assert_allclose(box.wheel_stiffness[-1], 1.0)
    assert box.stiffness[:, LEGS].min() >= SMART, "they had it before, and keep it"
    np.testing.assert_allclose(box.position_command[-1], held(before), atol=0.02)
    begun = time.monotonic()
    backend.deactivate()
    assert_let_go(recent(robot, time.monotonic() - begun))
    with pytest.raises(BackendError, match="open"):
        backend.open()
    backend.activate()
    backend.close()
    with pytest.raises(NotConnectedError, match="not open"):
        backend.write(Command(position=held(before), stiffness=ONES, wheel_speed=STILL))


def test_the_dcm_is_at_each_command_at_a_cycle_and_samples_answer_it(
    robot: StandIn, backend: Backend
) -> None:
    backend.open()
    start = held(backend.activate())
    given = []

    def position(tick: int) -> FloatArray:
        wanted = start.copy()
        wanted[[6, 12]] += np.array([0.2, -0.2]) * (1.0 - np.cos(0.03 * tick))
        given.append(wanted)
        return wanted

    begun = time.monotonic()
    measured = run(backend, 250, position)
    commanded = recent(robot, time.monotonic() - begun + 0.5).position_command
    reached = {row.tobytes() for row in commanded}
    hits = [wanted.tobytes() in reached for wanted in given[20:]]
    assert np.mean(hits) > 0.5, "all, but on a busy machine; beside its cycles it would be at none"
    errors = []
    for tick in range(30, 250):
        measurement = measured[tick]
        assert measurement.response_delay is not None
        if measurement.age == 0.0:
            errors.append(given[tick - 1 - measurement.response_delay] - measurement.position)
    # The simulated robot lags by less than a degree; two ticks of a wrong pairing would be more.
    assert np.abs(np.array(errors)[:, [6, 12]]).max() < np.radians(2.5)


def test_legs_go_back_to_where_almotion_left_them(robot: StandIn, backend: Backend) -> None:
    settings = load_naoqi_settings().timing
    backend.open()
    start = held(backend.activate())
    bowed = start.copy()
    hip = ROBOT.joint_index("HipPitch")
    bowed[hip] -= 0.1
    run(backend, 120, lambda tick: start + (bowed - start) * min(1.0, tick / 100))
    assert recent(robot, 0.1).position_command[-1, hip] == pytest.approx(bowed[hip], abs=1e-6)
    begun = time.monotonic()
    backend.deactivate()
    box = recent(robot, time.monotonic() - begun + 0.2)
    assert box.position_command[-1, hip] == pytest.approx(start[hip], abs=0.01)
    steps = np.diff(box.position_command[:, hip]) / np.diff(box.cycle)
    assert np.abs(steps).max() <= settings.max_step
    on_way = np.ptp(box.cycle[np.abs(steps).nonzero()[0]]) * ROBOT.cycle
    assert on_way > 0.1 / (1.5 * settings.leg_return_speed)
    assert_let_go(box)


def test_wheels_turn_and_stand_again(robot: StandIn, backend: Backend) -> None:
    backend.open()
    start = held(backend.activate())
    begun = time.monotonic()
    run(backend, 60, lambda _: start, wheels=np.array([0.5, -0.5, 0.0]))
    box = since(robot, begun)
    assert np.abs(box.wheel_command).max() == pytest.approx(0.5)
    assert box.wheel_speed[:, 0].max() == pytest.approx(0.5, abs=0.1)
    assert wait_until(lambda: not robot.black_box(1).wheel_command.any()), (
        "nobody tells them to go on"
    )


def test_a_stand_in_can_be_pushed(robot: StandIn, backend: Backend) -> None:
    with pytest.raises(NotConnectedError):
        backend.push("LForeArm", np.array([5.0, 0.0, 0.0]))
    backend.open()
    start = held(backend.activate())
    begun = time.monotonic()
    backend.push("LBicep", np.array([0.0, 20.0, 0.0]), np.array([0.16, 0.0, 0.0]), duration=0.6)
    run(backend, 60, lambda _: start)
    assert np.abs(since(robot, begun).position[:, 6] - start[6]).max() > np.radians(0.5)
    with pytest.raises(UnknownNameError, match="LForeArm"):
        backend.push("LForearm", np.array([0.0, 8.0, 0.0]))
    with pytest.raises(ValueError, match="duration"):
        backend.push("LForeArm", np.array([0.0, 8.0, 0.0]), duration=-1.0)
    with pytest.raises(ValueError, match="stiffness"):
        backend.grab("LForeArm", np.array([0.0, 0.01, 0.0]), stiffness=1.0)
    with pytest.raises(CapabilityError):
        _ = backend.truth


def test_a_whole_pepper_feels_a_push(robot: StandIn) -> None:
    felt: list[Contact] = []
    with Pepper(f"naoqi://127.0.0.1:{robot.port}", safety=PATIENT) as pepper:
        pepper.on_contact()(felt.append)
        pepper.set_posture({"LShoulderRoll": 0.6}, duration=1.5)
        pepper.run(2.5)
        pepper.push("LBicep", [0.0, 30.0, 0.0], point=[0.16, 0.0, 0.0], duration=1.0)
        pepper.run(1.5)
    assert [contact.joint for contact in felt][:1] == ["LShoulderRoll"]


# -- what goes wrong ----------------------------------------------------------------------------------------------


def test_a_lost_connection_is_told_and_nothing_goes_on_by_itself(
    wake_up: Callable[[StandIn], None], robot: StandIn, backend: Backend
) -> None:
    backend.open()
    start = held(backend.activate())
    run(backend, 20, lambda _: start)
    robot.naoqi_process.kill()
    robot.naoqi_process.wait()
    killed = time.monotonic()
    with pytest.raises(NotConnectedError, match=r"lost.*start again"):
        run(backend, 500, lambda _: start)
    assert time.monotonic() - killed < 5.0, "the library notices at once that a program ended"
    with pytest.raises(NotConnectedError):
        backend.diagnosis()
    begun = time.monotonic()
    backend.close()
    assert time.monotonic() - begun < 5.0
    assert robot.black_box(1).stiffness[-1].all(), "the joints stay as they are"

    robot.start_naoqi()
    backend.open()
    measured = run(backend, 20, lambda _: start)
    assert measured[-1].response_delay is None, "open, and not active"
    backend.activate()
    assert run(backend, 500, lambda _: start, until=lambda m: m.age < 0.03)[-1].age < 0.03
    backend.close()
    wake_up(robot)


def test_a_robot_that_hangs_is_left_as_it_is(
    robot: StandIn, backend: Backend, caplog: pytest.LogCaptureFixture
) -> None:
    backend.open()
    start = held(backend.activate())
    run(backend, 30, lambda _: start, wheels=np.array([1.0, -1.0, 0.0]))
    suspend(robot.naoqi_process.pid)
    hung = time.monotonic()
    turn = np.array([1.0, -1.0, 0.0])
    last = run(backend, 500, lambda _: start, turn, until=lambda m: m.age > 0.3)[-1]
    assert 0.3 < last.age < time.monotonic() - hung + 0.2, "as old as it is"
    begun = time.monotonic()
    backend.close()
    assert time.monotonic() - begun < 5 * SILENCE, "it waits for no answer any more"
    assert "left as it is" in caplog.text
    box = recent(robot, 0.2)
    assert not box.wheel_command.any()
    assert (box.stiffness[-1] == 1.0).all()
    os.kill(robot.naoqi_process.pid, signal.SIGCONT)
    box = recent(robot, 0.08)
    assert not box.wheel_command[-1].any()
    assert np.abs(np.diff(box.position_command, axis=0)).max() <= 0.02


def test_leaving_the_block_lets_go_whatever_happened(robot: StandIn) -> None:
    backend = make_backend(f"naoqi://127.0.0.1:{robot.port}")
    with pytest.raises(KeyError), backend:  # noqa: PT012
        backend.open()
        backend.activate()
        begun = time.monotonic()
        raise KeyError("a user's mistake")
    assert_let_go(recent(robot, time.monotonic() - begun))


def priorities() -> list[int]:
    """Of libqi's threads in this process."""
    tasks = list(Path("/proc/self/task").iterdir())
    names = {task.name: (task / "comm").read_text() for task in tasks}
    ours = [int(task) for task, name in names.items() if name.startswith(THREADS)]
    return [os.sched_getparam(task).sched_priority for task in ours]


def test_messages_go_before_other_programs_while_a_robot_is_open(backend: Backend) -> None:
    backend.open()
    obstacle = priority_obstacle()
    if obstacle:
        assert set(priorities()) == {0}
        pytest.skip(obstacle)
    assert set(priorities()) == {QI_PRIORITY}
    backend.close()
    assert set(priorities()) == {0}


def test_what_is_measured_at_the_start_has_the_priority_of_ticks() -> None:
    before = os.sched_getscheduler(0)
    obstacle = priority_obstacle()
    with preferred():
        now = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    assert now == ((before, 0) if obstacle else (os.SCHED_FIFO, QI_PRIORITY))
    assert os.sched_getscheduler(0) == before


def test_a_robot_that_is_woken_up_goes_on_from_where_it_then_stands(
    qi: Any, robot: StandIn
) -> None:
    """Asleep its arms hang elsewhere: to go back there would be a jump. This leaves it asleep, and is the last test."""
    session = qi.Session()
    session.connect(robot.url)
    session.service("ALMotion").rest()
    session.close()
    asleep = robot.black_box(1).position[-1]
    with Pepper(f"naoqi://127.0.0.1:{robot.port}?wake=1", safety=PATIENT, observer=None) as pepper:
        pepper.run(0.5)
        box = recent(robot, 1.5)
        moved = np.abs(pepper.target - asleep)
    assert moved.max() > 0.2, "it did move while it woke up"
    steps = np.diff(box.position_command, axis=0) / np.diff(box.cycle)[:, None]
    assert np.abs(steps).max() < 0.01
