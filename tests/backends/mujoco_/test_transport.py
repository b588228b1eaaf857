"""Between plant and reader: delays of whole ticks, late samples, noise, counts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import Command
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.mujoco_.sensors import CommandDelayLine, CurrentSensors, Encoders
from pepper_driver.config import PlantConfig
from pepper_driver.config.arrays import FloatArray
from support.plant import ROBOT, N, plain

COUNT = ROBOT.sensors.encoder.step
TICKS = 120


def transported(**changes: Any) -> PlantConfig:
    plant = plain()
    return replace(plant, transport=replace(plant.transport, **changes))


def run(
    plant: PlantConfig, start: int = 20, seed: int = 0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, 17) true and measured positions, (n,) age [s], of a motion of all joints that begins at tick ``start``."""
    backend = MujocoBackend(ROBOT, plant, seed=seed)
    hold = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    backend.activate()
    true, measured, age = [], [], []
    middle = (ROBOT.lower + ROBOT.upper) / 2
    for tick in range(TICKS):
        time = max(0, tick - start) * ROBOT.cycle
        fraction = 0.2 * (1 - np.cos(3.0 * time))
        command = Command(
            position=hold + fraction * (middle - hold),
            stiffness=np.ones(N),
            wheel_speed=np.zeros(3),
        )
        measurement = backend.exchange(command)
        true.append(backend.truth.position)
        measured.append(measurement.position)
        age.append(measurement.age)
    return np.array(true), np.array(measured), np.array(age)


def counted(position: FloatArray) -> FloatArray:
    return np.asarray(np.rint(position / COUNT) * COUNT)


@pytest.mark.parametrize("delay", [1, 3])
def test_a_command_acts_whole_ticks_late(delay: int) -> None:
    """Sent as much earlier, it moves the robot as before, to the last bit."""
    prompt, _, _ = run(transported(), start=20)
    late, _, _ = run(transported(command_delay=delay), start=20 - delay)
    assert np.ptp(prompt, axis=0).max() > 0.1
    np.testing.assert_array_equal(late, prompt)
    unshifted, _, _ = run(transported(command_delay=delay), start=20)
    np.testing.assert_allclose(unshifted[delay:], prompt[:-delay], atol=2e-3)
    assert np.abs(unshifted - prompt).max() > 4e-3


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_sample_arrives_whole_ticks_late(delay: int) -> None:
    true, measured, age = run(transported(sensor_delay=delay))
    np.testing.assert_array_equal(measured[delay:], counted(true[: TICKS - delay]))
    assert not age.any()


@pytest.mark.parametrize(("there", "back"), [(0, 0), (1, 0), (0, 2), (2, 3)])
def test_the_response_delay_is_the_sum(there: int, back: int) -> None:
    plant = transported(command_delay=there, sensor_delay=back)
    assert MujocoBackend(ROBOT, plant).info.response_delay == there + back
    _, delayed, _ = run(plant, start=20)
    _, prompt, _ = run(transported(), start=20 + there + back)
    # The same motion, except for what the robot still settles in the meantime.
    np.testing.assert_allclose(delayed[40:], prompt[40:], atol=3 * COUNT)


def test_late_samples_repeat_and_say_how_old_they_are() -> None:
    delay, longest = 1, 3
    true, measured, age = run(
        transported(sensor_delay=delay, late=0.5, longest_late=longest), seed=5
    )
    ticks = np.rint(age / ROBOT.cycle).astype(int)
    np.testing.assert_allclose(age, ticks * ROBOT.cycle)
    assert set(ticks) == {0, 1, 2, 3}
    for tick in range(delay + longest, TICKS):
        np.testing.assert_array_equal(measured[tick], counted(true[tick - delay - ticks[tick]]))
    assert ((np.diff(ticks) == 1) | (ticks[1:] == 0)).all(), "a sample ages by a tick, or is new"


def test_samples_come_late_as_often_as_configured() -> None:
    plant = transported(late=0.2, longest_late=10)
    encoders = Encoders(ROBOT, plant, np.random.default_rng(1))
    encoders.reset(np.zeros(N))
    late = 0
    for _ in range(5000):
        encoders.read(np.zeros(N))
        late += encoders.age > 0
    assert late / 5000 == pytest.approx(0.2, abs=0.02)


def test_no_sample_is_late_where_none_may_be() -> None:
    plant = transported(late=0.9, longest_late=0)
    encoders = Encoders(ROBOT, plant, np.random.default_rng(1))
    encoders.reset(np.zeros(N))
    for n in range(50):
        np.testing.assert_array_equal(encoders.read(np.full(N, 40 * n * COUNT)), 40 * n * COUNT)
        assert encoders.age == 0


def test_noise_comes_before_the_counting() -> None:
    encoders = Encoders(ROBOT, transported(encoder_noise=4 * COUNT), np.random.default_rng(2))
    encoders.reset(np.zeros(N))
    samples = np.array([encoders.read(np.full(N, 0.3)) for _ in range(2000)])
    np.testing.assert_allclose(samples / COUNT, np.rint(samples / COUNT), atol=1e-9)
    np.testing.assert_allclose(samples.mean(axis=0), 0.3, atol=0.4 * COUNT)
    np.testing.assert_allclose(samples.std(axis=0), np.hypot(4, 1 / 12**0.5) * COUNT, rtol=0.08)


def test_the_current_is_low_passed_absolute_and_counted() -> None:
    plant = transported(current_time=0.05)
    sensors = CurrentSensors(ROBOT, plant, np.random.default_rng(3))
    step = ROBOT.sensors.current.step
    assert not sensors.reset().any()
    for n in range(1, 20):
        reading = sensors.read(np.full(N, 1.0))
        expected = 1 - np.exp(-n * ROBOT.cycle / 0.05)
        np.testing.assert_allclose(reading, expected, atol=0.51 * step)
        np.testing.assert_allclose(reading / step, np.rint(reading / step), atol=1e-9)
    noisy = CurrentSensors(ROBOT, transported(current_noise=0.1), np.random.default_rng(3))
    noisy.reset()
    assert min(noisy.read(np.zeros(N)).min() for _ in range(100)) >= 0.0


def test_commands_wait_in_line() -> None:
    line = CommandDelayLine(transported(command_delay=2))
    line.reset(np.full(N, -1.0))
    arrived = [line.send(np.full(N, float(n)))[0] for n in range(6)]
    assert arrived == [-1.0, -1.0, 0.0, 1.0, 2.0, 3.0]


def test_a_lost_sample_repeats_the_position_and_does_not_report_it() -> None:
    """Each board loses its own; the fraction is the given one, and the age says nothing."""
    plant = transported(lost=0.2)
    encoders = Encoders(ROBOT, plant, np.random.default_rng(0))
    encoders.reset(np.zeros(N))
    rows = []
    for tick in range(1, 2001):
        rows.append(encoders.read(np.full(N, 10 * COUNT * tick)))
        assert encoders.age == 0
    repeated = np.diff(rows, axis=0) == 0.0
    assert np.mean(repeated) == pytest.approx(0.2, abs=0.01)
    correlation = np.corrcoef(repeated.T.astype(float))
    assert np.abs(correlation[~np.eye(N, dtype=bool)]).max() < 0.1
    caught_up = np.array(rows[1:])[~repeated]
    expected = np.repeat(10 * COUNT * np.arange(2, 2001)[:, None], N, axis=1)[~repeated]
    np.testing.assert_allclose(caught_up, expected, atol=1e-9)


@pytest.mark.parametrize(("there", "back"), [(1, 1), (5, 1), (5, 2)])
def test_two_to_seven_ticks_pass_from_command_to_sample(there: int, back: int) -> None:
    """A step of one joint shows in the encoder after the delay, and not before."""
    backend = MujocoBackend(ROBOT, transported(command_delay=there, sensor_delay=back))
    goal = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    backend.activate()
    joint = ROBOT.joint_index("HeadYaw")
    positions = []
    goal = goal.copy()
    for tick in range(30):
        if tick == 10:
            goal[joint] += 0.2
        sent = Command(position=goal.copy(), stiffness=np.ones(N), wheel_speed=np.zeros(3))
        positions.append(backend.exchange(sent).position[joint])
    moved = int(np.argmax(np.abs(np.array(positions) - positions[9]) > 2 * COUNT))
    # The cycle in which the board has the new target already moves the joint.
    assert moved == 10 + there + back
