"""The robot without physics: exact, and faulty where a test requests it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends import Command, Measurement, NotConnectedError, make_backend
from pepper_driver.backends.interface import DEAD_MAN_CYCLES
from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.config import ConfigError, PepperError, UnknownNameError, load_robot

ROBOT = load_robot()
STAND = ROBOT.posture("Stand")
HEAD = ROBOT.joint_index("HeadYaw")


def command(head: float = 0.0, wheel_speed: float = 0.0) -> Command:
    position = STAND.copy()
    position[HEAD] = head
    return Command(position=position, stiffness=np.ones(17), wheel_speed=np.full(3, wheel_speed))


def active(backend: MockBackend) -> MockBackend:
    backend.open()
    backend.activate()
    return backend


def heads(samples: list[Measurement]) -> list[float]:
    return [float(sample.position[HEAD]) for sample in samples]


def test_joints_and_wheels_follow_their_command_at_once() -> None:
    backend = active(MockBackend(ROBOT))
    for tick in range(1, 6):
        sample = backend.exchange(command(0.1 * tick, 0.2 * tick))
        assert (sample.tick, sample.time) == (tick, tick * ROBOT.cycle)
        assert sample.position[HEAD] == 0.1 * tick
        np.testing.assert_array_equal(sample.wheel_speed, 0.2 * tick)
    np.testing.assert_array_equal(np.delete(sample.position, HEAD), np.delete(STAND, HEAD))


@pytest.mark.parametrize("delay", [0, 1, 4])
def test_a_sample_shows_the_command_of_some_cycles_ago(delay: int) -> None:
    backend = active(MockBackend(ROBOT, delay=delay))
    assert backend.info.response_delay == delay
    samples = [backend.exchange(command(0.1 * tick, 0.1 * tick)) for tick in range(1, 11)]
    shown = [0] * delay + list(range(1, 11 - delay))
    assert heads(samples) == [0.1 * tick if tick else STAND[HEAD] for tick in shown]
    assert [float(sample.wheel_speed[0]) for sample in samples] == [0.1 * tick for tick in shown]


def test_wheels_without_a_command_stand() -> None:
    backend = active(MockBackend(ROBOT))
    backend.write(command(0.3, 1.0))
    samples = [backend.read() for _ in range(DEAD_MAN_CYCLES + 3)]
    speeds = [float(sample.wheel_speed.max()) for sample in samples]
    assert speeds == [1.0] * DEAD_MAN_CYCLES + [0.0] * 3
    assert heads(samples) == [0.3] * len(samples)


def test_commands_are_kept_as_they_were_written_and_done_within_the_limits() -> None:
    backend = active(MockBackend(ROBOT))
    beyond = command(9.0, 100.0)
    sample = backend.exchange(beyond)
    assert sample.position[HEAD] == ROBOT.upper[HEAD]
    np.testing.assert_array_equal(sample.wheel_speed, ROBOT.wheels.speed_limit)
    beyond.position[:] = 0.0
    (kept,) = backend.commands
    assert kept.position[HEAD] == 9.0
    np.testing.assert_array_equal(kept.wheel_speed, 100.0)


def test_what_is_written_while_it_is_not_active_is_kept_and_not_done() -> None:
    backend = MockBackend(ROBOT)
    backend.open()
    assert backend.exchange(command(0.5, 1.0)).position[HEAD] == STAND[HEAD]
    backend.activate()
    assert backend.read().position[HEAD] == STAND[HEAD]
    backend.write(command(0.5, 1.0))
    backend.deactivate()
    sample = backend.read()
    assert sample.position[HEAD] == STAND[HEAD]
    assert not sample.wheel_speed.any()
    assert len(backend.commands) == 2


def aged(sample: Measurement) -> Measurement:
    return replace(sample, age=0.2)


def test_faults_change_the_measurement_of_their_tick() -> None:
    faults: dict[int, Fault] = {0: aged, 2: aged}
    backend = MockBackend(ROBOT, faults=faults)
    ages = [backend.open().age, *(backend.read().age for _ in range(4))]
    assert ages == [0.2, 0.0, 0.2, 0.0, 0.0]
    backend.faults[6] = aged
    assert [backend.read().age for _ in range(3)] == [0.0, 0.2, 0.0]
    assert faults == {0: aged, 2: aged}


def test_it_records_what_was_done_with_it() -> None:
    with MockBackend(ROBOT) as backend, pytest.raises(NotConnectedError):
        backend.activate()
    backend.open()
    backend.activate()
    backend.deactivate()
    assert backend.calls == ["activate", "close", "open", "activate", "deactivate"]


def test_it_may_stand_anywhere() -> None:
    backend = MockBackend(ROBOT, posture="Crouch")
    np.testing.assert_array_equal(backend.open().position, ROBOT.posture("Crouch"))
    backend.close()
    backend.position[HEAD] = 5.0
    assert backend.open().position[HEAD] == ROBOT.upper[HEAD], "but within its limits"


def test_it_may_be_moved_by_hand_until_it_is_active() -> None:
    backend = MockBackend(ROBOT, delay=1)
    first = backend.open()
    backend.read()
    backend.position[HEAD] = 0.4
    assert heads([backend.read(), backend.read()]) == [STAND[HEAD], 0.4], "a cycle late"
    backend.position = np.where(np.arange(17) == HEAD, 0.5, STAND)
    backend.activate()
    assert heads([backend.read() for _ in range(3)]) == [0.4, 0.5, 0.5], "and held there"
    assert first.position[HEAD] == STAND[HEAD]


def test_a_sample_belongs_to_who_reads_it() -> None:
    backend = MockBackend(ROBOT)
    first = backend.open()
    for part in (first.position, first.wheel_speed):
        part += 1.0
    again = backend.activate()
    np.testing.assert_array_equal(again.position, STAND)
    assert not again.wheel_speed.any()


def test_a_uri_names_posture_and_delay() -> None:
    backend = make_backend("mock://?posture=Crouch&delay=3")
    assert isinstance(backend, MockBackend)
    assert (backend.uri, backend.info.response_delay) == ("mock://?posture=Crouch&delay=3", 3)
    np.testing.assert_array_equal(backend.position, ROBOT.posture("Crouch"))
    assert not backend.real_time
    assert MockBackend(ROBOT, real_time=True).real_time


@pytest.mark.parametrize(
    ("uri", "error", "word"),
    [
        ("mock://?posture=Crouhc", UnknownNameError, "Crouch"),
        ("mock://?delay=-1", ConfigError, "whole number"),
        ("mock://?dely=1", ConfigError, "did you mean delay"),
        ("mock://here", ConfigError, "'here' says nothing"),
    ],
)
def test_a_wrong_uri_is_one_line(uri: str, error: type[PepperError], word: str) -> None:
    with pytest.raises(error, match=word):
        make_backend(uri)
    with pytest.raises(ConfigError, match="delay"):
        MockBackend(ROBOT, delay=-1)


def test_it_is_loaded_only_where_it_is_asked_for() -> None:
    code = "import sys, pepper_driver.backends; print('pepper_driver.backends.mock' in sys.modules)"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert shown.stdout.strip() == "False"
