"""A robot over NAOqi's own library, with its threads, types and network: what virtual time cannot show."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import Backend, Command, NotConnectedError, make_backend
from pepper_driver.backends.naoqi.connection import LoginError, connect
from pepper_driver.backends.naoqi.qi_library import QI_PRIORITY, THREADS, preferred
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.tls import Login
from pepper_driver.cli.app import run
from pepper_driver.config import load_robot
from pepper_driver.realtime import RealTimePacer, priority_obstacle
from support.naoqi_fakes import address_of
from support.pushes import joints_of_a_push
from support.stand_ins import PATIENT, patient_driver, since, url
from support.waiting import wait_until

pytestmark = pytest.mark.realtime

ROBOT = load_robot()
LEGS = np.array([name in ROBOT.chains["legs"] for name in ROBOT.joint_names])


@pytest.fixture(autouse=True, scope="module")
def _patient() -> Iterator[None]:
    with patient_driver():
        yield


@pytest.fixture(scope="module")
def robot(wake_up: Callable[[StandIn], None]) -> Iterator[StandIn]:
    """Awake, and its owner allows all."""
    with StandIn("mujoco://?seed=3", consent=True) as running:
        wake_up(running)
        yield running


@pytest.fixture
def backend(robot: StandIn) -> Iterator[Backend]:
    backend = make_backend(url(robot))
    yield backend
    backend.close()


def test_a_robot_is_taken_over_driven_and_given_back(robot: StandIn, backend: Backend) -> None:
    """Values arrive in their types, commands in theirs; in the end all is soft but the legs."""
    first = backend.open()
    assert first.position.shape == first.current.shape == first.temperature.shape == (17,)
    assert first.wheel_speed.shape == (3,)
    assert first.buttons.dtype == first.touch.dtype
    backend.activate()
    held = np.clip(first.position, ROBOT.lower, ROBOT.upper)
    wheels = np.array([0.5, -0.5, 0.0])
    pacer = RealTimePacer(ROBOT.cycle, backend)
    for _ in range(60):
        pacer.wait()
        backend.read()
        backend.write(Command(position=held, stiffness=np.ones(17), wheel_speed=wheels))
    assert np.abs(robot.black_box(60).wheel_command).max() == pytest.approx(0.5)
    begun = robot.black_box(1).begin[-1]
    backend.deactivate()
    box = since(robot, begun)
    assert box.stiffness[:, ~LEGS].max(axis=1).min() < 0.2
    assert box.stiffness[:, LEGS].min() > 0.69, "the least of ALMotion's smart stiffness"
    assert wait_until(lambda: not robot.black_box(1).wheel_command.any())


def test_a_whole_pepper_detects_a_push(robot: StandIn) -> None:
    assert joints_of_a_push(Pepper(url(robot), safety=PATIENT))[:1] == ["LShoulderRoll"]


def priorities() -> list[int]:
    """Priorities of libqi's threads in this process."""
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


def test_over_tls(monkeypatch: pytest.MonkeyPatch) -> None:
    with StandIn("mujoco://?seed=5", login=Login(user="nao", token="sesame-8")) as robot:
        place = f"127.0.0.1:{robot.port}"
        monkeypatch.setenv("PEPPER_PASSWORD", "sesame-8")
        with make_backend(f"naoqis://nao@{place}?mode=angles") as backend:
            assert backend.open().position.shape == (17,)
            assert "sesame" not in repr(vars(backend))
        for uri, password in (
            (f"naoqis://nao@{place}", "wrong-9"),
            (f"naoqis://x@{place}", "sesame-8"),
        ):
            monkeypatch.setenv("PEPPER_PASSWORD", password)
            with pytest.raises(LoginError, match="wrong password") as caught:
                make_backend(uri).open()
            assert password not in str(caught.value)
        with pytest.raises(NotConnectedError, match=f"write naoqis://nao@{place}"):
            make_backend(f"naoqi://{place}").open()


def test_the_doctor(robot: StandIn, capsys: pytest.CaptureFixture[str]) -> None:
    connection = connect(address_of(url(robot)))
    key = "Diagnosis/Temperature/LElbowRoll/Error"
    connection.call("ALMemory", "insertData", key, 1)
    assert run(["doctor", url(robot), "--no-motion"]) == 1
    connection.call("ALMemory", "insertData", key, 0)
    connection.close()
    table = capsys.readouterr().out
    for check in ("connection", "joints", "battery", "charging flap", "models"):
        assert any(row.startswith("ok") and check in row for row in table.splitlines()), table
    assert any(row.startswith("FAILED") and "diagnosis" in row for row in table.splitlines())
    assert "LElbowRoll: too hot" in table
