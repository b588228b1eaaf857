"""A recording as a robot: the same measurements bit for bit, commands compared, a clear end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import (
    Backend,
    BackendError,
    Command,
    Measurement,
    NotConnectedError,
    make_backend,
)
from pepper_driver.backends.interface import MAX_RESPONSE_DELAY
from pepper_driver.backends.log_file import LogError
from pepper_driver.backends.replay import EndOfLogError, ReplayBackend
from pepper_driver.config import ConfigError, PepperError, load_robot
from pepper_driver.log import LogWriter, read_log

ROBOT = load_robot()
TICKS = 60


def program(pepper: Pepper) -> None:
    pepper.set_posture({"LShoulderRoll": 0.6})
    pepper.run(TICKS * ROBOT.cycle)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with Pepper("mujoco://?seed=5", observer=None, log=path) as pepper:
        program(pepper)
    return path


@pytest.fixture
def backend(log: Path) -> Iterator[ReplayBackend]:
    backend = make_backend(f"replay://{log}")
    assert isinstance(backend, ReplayBackend)
    yield backend
    backend.close()


def answered(backend: ReplayBackend, step: int) -> Command:
    """The command of a step, as far as the recording says."""
    place = min(step + backend.info.response_delay, TICKS - 1)
    return backend.commands[place]


def test_it_is_the_robot_that_was_recorded(log: Path, backend: Backend) -> None:
    run, info = read_log(log).metadata, backend.info
    assert (info.identity, info.cycle) == (run["identity"], ROBOT.cycle)
    assert info.response_delay == int(run["response_delay"])
    assert info.joint_names == ROBOT.joint_names
    assert not backend.real_time
    assert not info.capabilities


def test_the_same_bits_are_measured(log: Path, backend: ReplayBackend) -> None:
    read = read_log(log)
    backend.open()
    backend.activate()
    for row in range(TICKS):
        measurement = backend.exchange(answered(backend, row))
        for name in ("time", "tick", "age", "battery", "position", "current", "touch", "bumpers"):
            value = np.asarray(getattr(measurement, name))
            assert value.tobytes() == read[name][row].tobytes(), name
        assert measurement.imu.attitude.tobytes() == read["imu_attitude"][row].tobytes()
        with pytest.raises(ValueError, match="read-only"):
            measurement.position[0] = 1.0
    assert (backend.differences.compared, backend.differences.differing) == (
        TICKS - backend.info.response_delay,
        0,
    )
    assert backend.differences.first is None


def test_it_ends_with_an_error_that_says_so(backend: ReplayBackend) -> None:
    first = backend.open()
    for _ in range(TICKS):
        backend.exchange(hold(first))
    with pytest.raises(EndOfLogError, match=f"over after {TICKS} ticks"):
        backend.exchange(hold(first))
    backend.close()
    assert backend.open().tick == first.tick


def hold(measurement: Measurement) -> Command:
    return Command(position=measurement.position, stiffness=np.ones(17), wheel_speed=np.zeros(3))


def test_another_command_is_reported_with_its_size(backend: ReplayBackend) -> None:
    backend.open()
    backend.activate()
    joint = ROBOT.joint_index("LElbowRoll")
    for step in range(TICKS):
        command = answered(backend, step)
        if step in (7, 20):
            position = command.position.copy()
            position[joint] += 0.25 if step == 20 else 1e-15
            command = replace(command, position=position)
        backend.exchange(command)
    found = backend.differences
    assert found.differing == 2
    assert found.first is not None
    time, text = found.first
    assert time == backend.measurements[7 + backend.info.response_delay].time
    assert "position of LElbowRoll" in text
    assert found.largest["position"] == pytest.approx(0.25)
    assert found.largest["stiffness"] == found.largest["wheel_speed"] == 0.0


def test_commands_before_activation_are_not_compared(backend: ReplayBackend) -> None:
    first = backend.open()
    backend.exchange(hold(first))
    assert backend.differences.compared == 0


def test_the_same_program_sends_the_same_commands(log: Path) -> None:
    """One program, one path of code: the controller finds the references of then by itself."""
    with Pepper(f"replay://{log}", observer=None) as pepper:
        program(pepper)
        backend = pepper.backend
        assert isinstance(backend, ReplayBackend)
        assert backend.differences.compared == TICKS - backend.info.response_delay
        assert backend.differences.differing == 0
        with pytest.raises(EndOfLogError):
            pepper.run(0.012)


def test_another_program_does_not(log: Path) -> None:
    with Pepper(f"replay://{log}", observer=None) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.61})
        pepper.run(0.5)
        backend = pepper.backend
        assert isinstance(backend, ReplayBackend)
        assert backend.differences.differing > 30


def test_a_command_too_old_to_be_known_is_not_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a sample that answers an older command than the loop keeps, the log has the oldest it kept."""
    ways = iter([MAX_RESPONSE_DELAY + 10] * 80 + [MAX_RESPONSE_DELAY] * 20)
    path = tmp_path / "run.mcap"
    with Pepper("mujoco://?seed=5", observer=None, log=path) as pepper:
        read = pepper.backend.read
        monkeypatch.setattr(
            pepper.backend, "read", lambda: replace(read(), response_delay=next(ways, None))
        )
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(100 * ROBOT.cycle)
    with Pepper(f"replay://{path}", observer=None) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(100 * ROBOT.cycle)
        backend = pepper.backend
    assert isinstance(backend, ReplayBackend)
    assert backend.answered.tolist() == 80 * [-1] + list(
        range(80 - MAX_RESPONSE_DELAY, 100 - MAX_RESPONSE_DELAY)
    )
    assert (backend.differences.compared, backend.differences.differing) == (20, 0)


def test_order_of_calls_is_checked(backend: ReplayBackend) -> None:
    command = backend.commands[0]
    with pytest.raises(NotConnectedError):
        backend.exchange(command)
    with pytest.raises(NotConnectedError):
        backend.activate()
    backend.open()
    with pytest.raises(BackendError):
        backend.open()
    backend.activate()
    with pytest.raises(BackendError):
        backend.activate()
    with pytest.raises(ValueError, match="position"):
        backend.exchange(replace(command, position=np.full(17, np.nan)))
    backend.close()
    backend.close()


def test_a_relative_path_is_one(log: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "run.mcap").write_bytes(log.read_bytes())
    monkeypatch.chdir(tmp_path)
    assert isinstance(make_backend("replay://deep/run.mcap"), ReplayBackend)
    monkeypatch.chdir(tmp_path / "deep")
    assert isinstance(make_backend("replay://run.mcap"), ReplayBackend)


@pytest.mark.parametrize(
    ("uri", "error", "message"),
    [
        ("replay://nowhere.mcap", LogError, "nowhere.mcap: cannot be read"),
        ("replay", ConfigError, "name the log"),
        ("replay://", ConfigError, "name the log"),
        ("replay://a.mcap?seed=3", ConfigError, "unknown key 'seed'"),
        (f"replay://{__file__}", LogError, "not an MCAP file"),
    ],
)
def test_what_is_no_log_is_one_line(uri: str, error: type[PepperError], message: str) -> None:
    with pytest.raises(error, match=message) as caught:
        make_backend(uri)
    assert "\n" not in str(caught.value)


def empty(path: Path, robot: Any = ROBOT, **metadata: str) -> Path:
    with LogWriter(path, robot, metadata):
        pass
    return path


KNOWN = {"cycle": "0.012", "response_delay": "2", "identity": "a body"}


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        (KNOWN, "holds no tick"),
        ({}, "does not say of which backend"),
        ({**KNOWN, "response_delay": "soon"}, "does not say of which backend"),
        ({**KNOWN, "cycle": "nan"}, "a cycle of nan"),
        ({**KNOWN, "response_delay": "-1"}, "a delay of -1"),
    ],
)
def test_a_log_that_lacks_something_says_what(
    tmp_path: Path, metadata: dict[str, str], message: str
) -> None:
    with pytest.raises(LogError, match=message):
        make_backend(f"replay://{empty(tmp_path / 'a.mcap', **metadata)}")


def test_a_log_of_another_robot_is_refused(tmp_path: Path) -> None:
    joints = tuple(replace(joint, name=f"My{joint.name}") for joint in ROBOT.joints)
    path = empty(tmp_path / "a.mcap", replace(ROBOT, joints=joints), **KNOWN)
    with pytest.raises(LogError, match="other joints"):
        make_backend(f"replay://{path}")
