"""What every backend must do, whatever is behind it. A new backend is one more parameter here."""

import copy
from collections.abc import Iterator
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pepper_driver.backends import (
    Backend,
    BackendError,
    Command,
    Imu,
    Measurement,
    NotConnectedError,
    make_backend,
)
from pepper_driver.config import load_robot

ROBOT = load_robot()
URIS = ["mujoco://?seed=7"]


@pytest.fixture(params=URIS)
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    backend = make_backend(request.param)
    yield backend
    backend.close()


def hold(measurement: Measurement) -> Command:
    position = np.clip(measurement.position, ROBOT.lower, ROBOT.upper)
    return Command(position=position, stiffness=np.ones(17), wheel_speed=np.zeros(3))


def test_info_is_known_before_open(backend: Backend) -> None:
    info = backend.info
    assert info.joint_names == ROBOT.joint_names
    assert info.cycle == ROBOT.cycle
    assert info.response_delay >= 0
    assert info.identity


def test_measurements_have_the_documented_shapes(backend: Backend) -> None:
    first = backend.open()
    second = backend.step(hold(first))
    for measurement in (first, second):
        assert measurement.position.shape == measurement.current.shape == (17,)
        assert measurement.temperature.shape == (17,)
        assert measurement.wheel_speed.shape == measurement.bumpers.shape == (3,)
        assert measurement.touch.shape == (5,)
        assert measurement.imu.acceleration.shape == (3,)
        assert np.isfinite(measurement.position).all()
        assert (measurement.current >= 0).all(), "the sensor loses the sign"
        assert 0.0 <= measurement.battery <= 1.0
    assert (first.tick, second.tick) == (0, 1)
    assert second.time == pytest.approx(ROBOT.cycle)


def test_a_measurement_is_never_changed_afterwards(backend: Backend) -> None:
    """The log and callbacks read it on threads of their own, later."""
    backend.open()
    measurement = backend.activate()
    target = hold(measurement).position + 0.02
    kept = []
    for _ in range(20):
        kept.append((measurement, copy.deepcopy(measurement)))
        measurement = backend.step(
            Command(position=target, stiffness=np.ones(17), wheel_speed=np.full(3, 1.0))
        )
    assert not np.array_equal(kept[0][0].current, measurement.current)
    for later, then in kept:
        for field in fields(Measurement):
            if field.name != "imu":
                np.testing.assert_array_equal(getattr(later, field.name), getattr(then, field.name))
        for field in fields(Imu):
            np.testing.assert_array_equal(
                getattr(later.imu, field.name), getattr(then.imu, field.name)
            )


def test_activation_holds_the_measured_posture(backend: Backend) -> None:
    before = backend.open().position
    after = backend.activate()
    assert np.abs(after.position - before).max() < np.radians(2.0)
    assert after.tick > 0


def test_the_joints_follow_the_command(backend: Backend) -> None:
    backend.open()
    measurement = backend.activate()
    start = hold(measurement).position
    index = ROBOT.joint_index("LShoulderRoll")
    target = start.copy()
    for tick in range(250):
        target[index] = start[index] + 0.4 * min(1.0, tick / 120)
        measurement = backend.step(
            Command(position=target, stiffness=np.ones(17), wheel_speed=np.zeros(3))
        )
    assert measurement.position[index] == pytest.approx(target[index], abs=np.radians(4.0))


def test_nothing_moves_before_activation(backend: Backend) -> None:
    first = backend.open()
    command = hold(first)
    command.position[ROBOT.joint_index("KneePitch")] += 0.3
    command.wheel_speed[:] = 2.0
    for _ in range(50):
        measurement = backend.step(command)
    knee = ROBOT.joint_index("KneePitch")
    assert measurement.position[knee] == pytest.approx(first.position[knee], abs=0.01)
    np.testing.assert_allclose(measurement.wheel_speed, 0.0, atol=1e-6)


def test_order_of_calls_is_checked(backend: Backend) -> None:
    with pytest.raises(NotConnectedError):
        backend.step(
            Command(position=np.zeros(17), stiffness=np.zeros(17), wheel_speed=np.zeros(3))
        )
    with pytest.raises(BackendError):
        backend.activate()
    backend.open()
    with pytest.raises(BackendError):
        backend.open()
    backend.activate()
    with pytest.raises(BackendError):
        backend.activate()


def test_closing_works_from_any_state_and_twice(backend: Backend) -> None:
    backend.close()
    backend.open()
    backend.close()
    backend.open()
    backend.activate()
    backend.close()
    backend.close()
    with pytest.raises(NotConnectedError):
        backend.step(
            Command(position=np.zeros(17), stiffness=np.zeros(17), wheel_speed=np.zeros(3))
        )


def test_leaving_the_block_closes(backend: Backend) -> None:
    def fail() -> None:
        with backend:
            backend.open()
            backend.activate()
            raise KeyError("a user's mistake")

    with pytest.raises(KeyError):
        fail()
    assert backend.open().tick == 0


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    part=st.sampled_from(["position", "stiffness", "wheel_speed"]),
    value=st.sampled_from([np.nan, np.inf, -np.inf]),
    place=st.integers(0, 2),
)
def test_a_command_that_is_not_finite_is_refused(
    backend: Backend, part: str, value: float, place: int
) -> None:
    backend.close()
    measurement = backend.open()
    command = hold(measurement)
    getattr(command, part)[place] = value
    with pytest.raises(ValueError, match=part):
        backend.step(command)
    # and the robot is as it was
    assert backend.step(hold(measurement)).tick == 1


@pytest.mark.parametrize("size", [0, 16, 18])
def test_a_command_of_the_wrong_size_is_refused(backend: Backend, size: int) -> None:
    measurement = backend.open()
    with pytest.raises(ValueError, match="position"):
        backend.step(
            Command(position=np.zeros(size), stiffness=np.ones(17), wheel_speed=np.zeros(3))
        )
    assert backend.step(hold(measurement)).tick == 1
