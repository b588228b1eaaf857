"""The base of the stand-in's ALMotion: velocities, ways to a pose, odometry, without physics."""

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi_server.almotion.wheels import DriveLimits, Move, wrapped_angle
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import MONOTONIC_CLOCK
from support.almotion import CONFIG, SETTINGS, Stage, wheel_key
from support.examples import examples

LIMITS = DriveLimits.of(SETTINGS, {})


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.quiet()
    made.stiffen(awake=True)
    return made


def twists(stage: Stage) -> FloatArray:
    """(n, 3) velocities of the base that the DCM sent."""
    wheels = np.array([stage.robot.sent[wheel_key(name)] for name in CONFIG.wheels.names])
    sent: FloatArray = (CONFIG.wheels.inverse @ wheels).T
    return sent


@pytest.mark.parametrize(
    "way", [(0.3, 0.0, 0.0), (-0.2, 0.1, 0.0), (0.0, 0.0, pi / 2), (0.5, -0.3, 2.0)]
)
def test_a_move_ends_where_it_was_sent(stage: Stage, way: tuple[float, float, float]) -> None:
    move = stage.motion.base.move(np.array(way), LIMITS)
    stage.run(move.duration + SETTINGS.move_patience + 0.5)
    assert move.succeeded
    assert not stage.motion.base.active
    assert stage.motion.base.pose == pytest.approx(np.array(way), abs=0.01)
    assert twists(stage)[-1] == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_move_is_as_seen_from_the_robot(stage: Stage) -> None:
    for way in ((0.0, 0.0, pi / 2), (0.3, 0.0, 0.0)):
        move = stage.motion.base.move(np.array(way), LIMITS)
        stage.run(move.duration + SETTINGS.move_patience)
    assert stage.motion.base.pose == pytest.approx(np.array([0.0, 0.3, pi / 2]), abs=0.02)


def test_a_move_keeps_the_limits(stage: Stage) -> None:
    move = stage.motion.base.move(np.array([1.0, 0.0, 0.0]), LIMITS)
    stage.run(move.duration + 1.0)
    speed = np.hypot(*twists(stage)[:, :2].T)
    assert speed.max() == pytest.approx(LIMITS.speed, rel=0.05)
    assert np.abs(np.diff(speed) / 0.012).max() < 1.2 * LIMITS.acceleration


def test_a_move_takes_the_time_it_is_given_or_the_time_it_needs(stage: Stage) -> None:
    base = stage.motion.base
    assert base.move(np.array([0.3, 0.0, 0.0]), LIMITS, 8.0).duration == 8.0
    assert base.move(np.array([0.3, 0.0, 0.0]), LIMITS, 0.1).duration > 2.0


def test_a_newer_order_ends_a_move(stage: Stage) -> None:
    first = stage.motion.base.move(np.array([1.0, 0.0, 0.0]), LIMITS)
    stage.run(1.0)
    second = stage.motion.base.move(np.array([0.1, 0.0, 0.0]), LIMITS)
    assert (first.wait(MONOTONIC_CLOCK), second.succeeded) == (False, False)
    stage.motion.base.drive(np.zeros(3), LIMITS)
    assert second.wait(MONOTONIC_CLOCK) is False


def test_a_velocity_is_taken_with_its_acceleration_and_kept(stage: Stage) -> None:
    stage.motion.base.drive(np.array([0.2, 0.0, 0.0]), LIMITS)
    stage.run(2.0)
    forward = twists(stage)[:, 0]
    assert forward[-50:] == pytest.approx(np.full(50, 0.2), abs=1e-3)
    assert np.diff(forward).max() / 0.012 < 1.05 * LIMITS.acceleration
    stage.motion.base.stop()
    stage.run(1.0)
    assert twists(stage)[-1] == pytest.approx(np.zeros(3), abs=1e-9)
    assert not stage.motion.base.active


def test_a_stop_at_once_is_one(stage: Stage) -> None:
    stage.motion.base.drive(np.array([0.2, 0.0, 0.0]), LIMITS)
    stage.run(2.0)
    stage.motion.base.stop(at_once=True)
    stage.run(0.09)
    assert twists(stage)[-1] == pytest.approx(np.zeros(3), abs=1e-9)


@examples(30)
@given(*[st.floats(-5.0, 5.0)] * 3)
def test_wheels_keep_their_limit_and_the_base_its_direction(
    x: float, y: float, turn: float
) -> None:
    stage = Stage()
    stage.quiet()
    stage.stiffen(awake=True)
    most = DriveLimits.of(
        SETTINGS, {"MaxVelXY": 9.0, "MaxVelTheta": 9.0, "MaxAccXY": 9.0, "MaxAccTheta": 9.0}
    )
    stage.motion.base.drive(np.array([x, y, turn]), most)
    stage.run(3.0)
    speeds = np.array([stage.robot.sent[wheel_key(name)] for name in CONFIG.wheels.names])
    assert np.abs(speeds).max() <= CONFIG.wheels.speed_limit + 1e-6
    last = twists(stage)[-1]
    assert np.hypot(last[0], last[1]) <= most.speed + 1e-9
    assert last[0] * y - last[1] * x == pytest.approx(0.0, abs=1e-6)
    assert abs(last[2]) <= most.turn + 1e-9


def test_drive_parameters_are_brought_into_their_ranges() -> None:
    limits = DriveLimits.of(SETTINGS, {"MaxVelXY": 9.0, "MaxAccTheta": 0.0})
    assert limits.speed == 0.55
    assert limits.turn_acceleration == 0.1
    assert limits.turn == 1.0


@given(st.floats(0.01, 3.0), st.floats(0.0, 3.0))
def test_the_way_of_a_move_keeps_speed_acceleration_and_jerk(length: float, angle: float) -> None:
    duration = LIMITS.duration(length, angle)
    move = Move(start=np.zeros(3), goal=np.array([length, 0.0, angle]), duration=duration)
    dt = duration / 4000
    rates = []
    for _ in range(4000):
        move.elapsed += dt
        rates.append(move.reference()[1])
    speeds = np.array(rates)
    for axis, speed, acceleration, jerk in (
        (0, LIMITS.speed, LIMITS.acceleration, LIMITS.jerk),
        (2, LIMITS.turn, LIMITS.turn_acceleration, LIMITS.turn_jerk),
    ):
        assert np.abs(speeds[:, axis]).max() <= speed * 1.001
        assert np.abs(np.diff(speeds[:, axis])).max() / dt <= acceleration * 1.001
        assert np.abs(np.diff(speeds[:, axis], 2)).max() / dt**2 <= jerk * 1.01
    assert move.reference()[0] == pytest.approx(move.goal)


@given(st.floats(-50.0, 50.0))
def test_angles_are_wrapped(angle: float) -> None:
    wrapped = wrapped_angle(angle)
    assert -pi <= wrapped <= pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)
