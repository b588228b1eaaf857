"""Minimum-jerk motion: begins and ends at rest, without acceleration."""

from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.backends.motion_profile import (
    PEAK_SPEED_RATIO,
    minimum_jerk,
    minimum_jerk_slope,
)

TIME = np.linspace(0.0, 1.0, 1001)


def test_it_goes_from_rest_to_rest() -> None:
    assert minimum_jerk(TIME[[0, -1]]).tolist() == [0.0, 1.0]
    assert minimum_jerk_slope(TIME[[0, -1]]).tolist() == [0.0, 0.0]
    acceleration = np.gradient(minimum_jerk_slope(TIME), TIME, edge_order=2)
    assert acceleration[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_the_slope_is_the_derivative() -> None:
    numerical = np.gradient(minimum_jerk(TIME), TIME, edge_order=2)
    np.testing.assert_allclose(minimum_jerk_slope(TIME), numerical, atol=1e-4)


def test_the_peak_speed_is_in_the_middle() -> None:
    assert minimum_jerk(0.5) == pytest.approx(0.5)
    assert minimum_jerk_slope(0.5) == PEAK_SPEED_RATIO == minimum_jerk_slope(TIME).max()


def test_it_is_the_published_polynomial() -> None:
    polynomial = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    np.testing.assert_allclose(minimum_jerk(TIME), polynomial(TIME), atol=1e-12)
