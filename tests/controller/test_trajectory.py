"""Reference motions: closed forms, ends, continuity, and what a controller makes of them."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.trajectory import (
    Trajectory,
    rotation_spline,
    spline,
    vector_trajectory,
)
from support.controller import DT

NO_SPEED = np.zeros(3)


def samples(trajectory: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    read = []
    while not trajectory.over:
        read.append(trajectory.next())
    targets, velocities, accelerations = zip(*read, strict=True)
    return np.array(targets), np.array(velocities), np.array(accelerations)


def test_from_rest_to_one_point_it_is_the_motion_of_least_jerk() -> None:
    """10 s^3 - 15 s^4 + 6 s^5, Flash and Hogan (1985)."""
    start, end, duration = np.array([0.2, -1.0, 0.0]), np.array([-0.5, 1.0, 0.3]), 1.2
    targets, velocities, accelerations = samples(
        vector_trajectory(np.array([start, end]), NO_SPEED, [duration], DT)
    )
    s = (np.arange(len(targets)) * DT / duration)[:, None]
    assert len(targets) == 101
    np.testing.assert_allclose(
        targets, start + (end - start) * (10 * s**3 - 15 * s**4 + 6 * s**5), atol=1e-12
    )
    speed = (end - start) / duration * (30 * s**2 - 60 * s**3 + 30 * s**4)
    np.testing.assert_allclose(velocities, speed, atol=1e-11)
    middle = s + DT / 2 / duration
    change = (end - start) / duration**2 * (60 * middle - 180 * middle**2 + 120 * middle**3)
    np.testing.assert_allclose(accelerations[:-1], change[:-1], atol=0.02)
    assert not accelerations[-1].any()


def test_held_for_a_cycle_the_accelerations_lead_along_the_spline() -> None:
    points = np.array([[0.0], [0.8], [0.3], [1.0]])
    targets, velocities, accelerations = samples(
        vector_trajectory(points, np.array([0.7]), [0.9, 0.6, 1.1], DT)
    )
    place, speed = np.array([0.0]), np.array([0.7])
    for target, velocity, acceleration in zip(targets, velocities, accelerations, strict=True):
        np.testing.assert_allclose(place, target, atol=5e-4)
        np.testing.assert_allclose(speed, velocity, atol=1e-9)
        place = place + speed * DT + acceleration * DT**2 / 2
        speed = speed + acceleration * DT


def test_a_spline_passes_its_points_in_time_and_without_a_jump() -> None:
    random = np.random.default_rng(0)
    points, durations = random.uniform(-1, 1, (5, 3)), [0.4, 1.0, 0.3, 0.8]
    velocity = np.array([0.5, -1.0, 0.2])
    motion = spline(points, velocity, durations)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    np.testing.assert_allclose(motion(knots)[0], points, atol=1e-12)
    np.testing.assert_allclose(motion(knots)[1][[0, -1]], [velocity, NO_SPEED], atol=1e-11)
    step = 1e-4
    fine = np.arange(0.0, knots[-1], step)
    place, speed = motion(fine)
    np.testing.assert_allclose(
        np.diff(place, axis=0) / step, (speed[1:] + speed[:-1]) / 2, atol=1e-4
    )
    acceleration = np.diff(speed, axis=0) / step
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.02 * np.abs(acceleration).max()
    np.testing.assert_allclose(acceleration[[0, -1]], 0.0, atol=0.1)


@pytest.mark.parametrize("count", [1, 2, 3, 12, 200])
def test_it_is_the_spline_of_scipy(count: int) -> None:
    random = np.random.default_rng(count)
    points, velocity = random.uniform(-1, 1, (count + 1, 4)), random.uniform(-1, 1, 4)
    durations = random.uniform(0.2, 3.0, count)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    still = np.zeros(4)
    # More general than SciPy's types.
    ends: Any = ([(1, velocity), (2, still)], [(1, still), (2, still)])
    expected = make_interp_spline(knots, points, k=5, bc_type=ends)
    times = np.sort(np.concatenate([knots, random.uniform(0, knots[-1], 300)]))
    positions, speeds = spline(points, velocity, durations.tolist())(times)
    np.testing.assert_allclose(positions, expected(times), atol=1e-11)
    np.testing.assert_allclose(speeds, expected.derivative()(times), atol=1e-10)


def test_points_on_the_way_and_the_end_are_met_to_the_last_bit() -> None:
    random = np.random.default_rng(5)
    points, durations = random.uniform(-1, 1, (6, 3)), [0.3, 1.1, 0.7, 0.2, 0.9]
    motion = spline(points, np.array([0.4, 0.0, -1.0]), durations)
    positions, speeds = motion(np.cumsum(durations))
    np.testing.assert_array_equal(positions, points[1:])
    np.testing.assert_array_equal(speeds[-1], NO_SPEED)


def test_the_controller_needs_none_of_scipys_slow_imports() -> None:
    """Together they took a third of the time in which a program starts."""
    code = (
        "import sys; from pepper_driver import Pepper; import pepper_driver.controller;"
        "sys.exit(any(f'scipy.{name}' in sys.modules for name in ('interpolate', 'spatial')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("duration", [1e-3, 0.005, 0.1, 0.125, 1.0, 7.3])
def test_the_last_sample_is_the_end_at_rest(duration: float) -> None:
    end = np.array([1.0, 2.0, 3.0])
    targets, velocities, accelerations = samples(
        vector_trajectory(np.array([NO_SPEED, end]), NO_SPEED, [duration], DT)
    )
    assert abs((len(targets) - 1) * DT - duration) <= max(DT / 2, DT - duration) + 1e-9
    np.testing.assert_allclose(targets[-1], end, atol=1e-9)
    np.testing.assert_allclose(targets[0], NO_SPEED, atol=1e-9)
    assert np.abs(velocities[-1]).max() < 1e-8 / duration
    assert np.abs(accelerations[-1]).max() < 1e-8 / duration


def test_a_motion_of_a_year_begins_at_once() -> None:
    year = 3.2e7
    trajectory = vector_trajectory(np.array([NO_SPEED, NO_SPEED + 1]), NO_SPEED, [year], DT)
    for _ in range(1000):
        target, velocity, acceleration = trajectory.next()
    assert not trajectory.over
    assert np.abs(target).max() < 1e-12
    assert np.isfinite([*velocity, *acceleration]).all()


@pytest.mark.parametrize("durations", [[1e-3, 1e6], [1e6, 1e-3], [1e-3, 10.0, 1e-3, 1e3]])
def test_durations_far_apart_stay_finite(durations: list[float]) -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (len(durations) + 1, 3))
    trajectory = vector_trajectory(points, NO_SPEED, durations, DT)
    for _ in range(2000):
        assert all(np.isfinite(part).all() for part in trajectory.next())


def rotation_cases() -> list[list[FloatArray]]:
    random = np.random.default_rng(2)
    several = [Rotation.random(random_state=7)]
    for _ in range(4):
        several.append(Rotation.from_rotvec(random.uniform(-1, 1, 3)) * several[-1])
    round_trip = [Rotation.from_euler("z", angle) for angle in (0.3, 2.0, 4.0, 6.0, 8.0)]
    return [[turn.as_matrix() for turn in turns] for turns in (several, round_trip)]


@pytest.mark.parametrize("rotations", rotation_cases())
def test_angular_velocities_are_those_of_the_rotations(rotations: list[FloatArray]) -> None:
    velocity = np.array([0.3, -0.2, 0.5])
    durations = [0.7, 1.0, 0.8, 1.3]
    motion = rotation_spline(rotations, velocity, durations)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    np.testing.assert_allclose(motion(knots)[0], rotations, atol=1e-9)
    np.testing.assert_allclose(motion(knots)[1][[0, -1]], [velocity, NO_SPEED], atol=1e-9)
    step = 1e-5
    times = np.linspace(0.0, knots[-1] - step, 400)
    before, after = motion(times)[0], motion(times + step)[0]
    turned = Rotation.from_matrix(after @ before.transpose(0, 2, 1)).as_rotvec() / step
    np.testing.assert_allclose(motion(times + step / 2)[1], turned, atol=1e-5)


@pytest.mark.parametrize("rotations", rotation_cases())
def test_held_angular_accelerations_lead_along_the_rotations(rotations: list[FloatArray]) -> None:
    motion = rotation_spline(rotations, NO_SPEED, [1.0] * 4)
    targets, velocities, accelerations = samples(Trajectory(motion, 4.0, DT))
    turn, speed = Rotation.from_matrix(targets[0]), NO_SPEED
    for target, velocity, acceleration in zip(targets, velocities, accelerations, strict=True):
        np.testing.assert_allclose(speed, velocity, atol=1e-9)
        assert (Rotation.from_matrix(target) * turn.inv()).magnitude() < 2e-3
        turn = Rotation.from_rotvec(speed * DT + acceleration * DT**2 / 2) * turn
        speed = speed + acceleration * DT


def test_one_turn_goes_about_its_axis_as_the_motion_of_least_jerk() -> None:
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, 2.5
    start = Rotation.random(random_state=3)
    end = Rotation.from_rotvec(angle * axis) * start
    motion = rotation_spline([start.as_matrix(), end.as_matrix()], NO_SPEED, [2.0])
    s = np.linspace(0, 1, 11)
    turns = Rotation.from_matrix(motion(2.0 * s)[0]) * start.inv()
    profile = angle * (10 * s**3 - 15 * s**4 + 6 * s**5)
    np.testing.assert_allclose(turns.as_rotvec(), profile[:, None] * axis, atol=1e-9)


def test_turns_in_one_sense_go_on_in_that_sense() -> None:
    """Through a third and two thirds of a turn: not back from the second by a third."""
    rotations = [Rotation.from_euler("z", angle).as_matrix() for angle in (0.0, 2.1, 4.2, 6.3)]
    _, speed = rotation_spline(rotations, NO_SPEED, [1.0] * 3)(np.linspace(0, 3, 50))
    assert speed[:, 2].min() > -1e-9
    assert np.abs(speed[:, :2]).max() < 1e-9
