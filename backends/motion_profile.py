"""Minimum-jerk motion from rest to rest: 10 s^3 - 15 s^4 + 6 s^5 at the time s, both 0..1 (Flash and Hogan, 1985)."""

from __future__ import annotations

from typing import TypeVar

from pepper_driver.config.arrays import FloatArray

T = TypeVar("T", float, FloatArray)

PEAK_SPEED_RATIO = 1.875
"""Largest speed of the motion, divided by its mean speed."""


def minimum_jerk(time: T) -> T:
    """Return the fraction of the distance that is covered after a fraction of the duration, 0..1."""
    return time**3 * (10.0 - 15.0 * time + 6.0 * time**2)


def minimum_jerk_slope(time: T) -> T:
    """Return the derivative of :func:`minimum_jerk`."""
    return 30.0 * (time * (1.0 - time)) ** 2
