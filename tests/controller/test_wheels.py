"""Wheel speeds that keep the base's direction, and odometry against exact arcs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Odometry, desaturate
from support.controller import DT, ROBOT

LIMIT = ROBOT.wheels.speed_limit
MATRIX = ROBOT.wheels.matrix

twists = st.tuples(*[st.floats(-5, 5, allow_nan=False)] * 3).map(np.array)


@given(twist=twists)
def test_wheels_too_fast_are_slowed_along_the_same_direction(twist: FloatArray) -> None:
    speed = MATRIX @ twist
    sent = desaturate(speed, LIMIT)
    assert np.abs(sent).max() <= LIMIT
    slower = np.linalg.solve(MATRIX, sent)
    fraction = min(1.0, LIMIT / max(np.abs(speed).max(), 1e-12))
    np.testing.assert_allclose(slower, fraction * twist, atol=1e-9)
    if np.abs(speed).max() > LIMIT:
        assert np.abs(sent).max() == pytest.approx(LIMIT)


@given(twist=twists.map(lambda t: 0.05 * t))
def test_wheels_within_their_limit_are_left_alone(twist: FloatArray) -> None:
    speed = np.clip(MATRIX @ twist, -LIMIT, LIMIT)
    assert desaturate(speed, LIMIT) is speed


@pytest.mark.parametrize("turn", [0.0, 0.8, -0.3, 1e-9])
def test_odometry_follows_a_constant_twist_along_its_arc(turn: float) -> None:
    """x(t) = v/w sin(w t) and so on: the closed form, not the sum of short lines."""
    odometry = Odometry(ROBOT)
    vx, vy, ticks = 0.2, -0.1, 400
    for _ in range(ticks):
        odometry.update(MATRIX @ [vx, vy, turn], DT)
    t = ticks * DT
    if abs(turn) > 1e-6:
        s, c = np.sin(turn * t) / turn, (1 - np.cos(turn * t)) / turn
    else:
        s, c = t, 0.0
    expected = [vx * s - vy * c, vx * c + vy * s, turn * t]
    np.testing.assert_allclose(odometry.pose, expected, atol=1e-6)
    np.testing.assert_allclose(odometry.twist, [vx, vy, turn], atol=1e-6)


def test_wheel_speeds_may_be_of_any_layout() -> None:
    """As a backend of a user may have them: single precision, every second of six, not to be written to."""
    speeds = MATRIX @ [0.3, 0.1, 0.2]
    expected = Odometry(ROBOT)
    expected.update(speeds, DT)
    spread = np.repeat(speeds, 2)[::2]
    spread.flags.writeable = False
    odometry = Odometry(ROBOT)
    odometry.update(spread, DT)
    np.testing.assert_array_equal(odometry.pose, expected.pose)
    odometry = Odometry(ROBOT)
    odometry.update(speeds.astype(np.float32), DT)
    np.testing.assert_allclose(odometry.pose, expected.pose, atol=1e-8)


def test_odometry_starts_again_at_the_origin() -> None:
    odometry = Odometry(ROBOT)
    odometry.update(MATRIX @ [0.3, 0.0, 0.2], DT)
    before = odometry.pose
    odometry.reset()
    assert np.array_equal(odometry.pose, np.zeros(3))
    assert before[0] > 0


def test_wheel_speeds_that_are_no_numbers_move_nothing() -> None:
    odometry = Odometry(ROBOT)
    odometry.update(MATRIX @ [0.3, 0.0, 0.2], DT)
    before = odometry.pose
    odometry.update(np.array([np.nan, 0.0, 0.0]), DT)
    np.testing.assert_array_equal(odometry.pose, before)
