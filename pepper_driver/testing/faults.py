"""Measurements as a faulty robot would have taken them, for ``MockBackend(faults=...)`` and its like."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import Fault
from pepper_driver.config import load_robot


def aged(seconds: float) -> Fault:
    """A sample so much older [s]."""
    return lambda measurement: replace(measurement, age=seconds)


def displaced(joint: str, by: float) -> Fault:
    """A joint is measured elsewhere, by an angle [rad]: as somebody pushes it, or its sensor fails.

    Raises:
        UnknownNameError: No such joint.
    """
    index = load_robot().joint_index(joint)

    def change(measurement: Measurement) -> Measurement:
        position = measurement.position.copy()
        position[index] += by
        return replace(measurement, position=position)

    return change


def pressed(sensor: Literal["touch", "bumpers", "buttons"], *numbers: int) -> Fault:
    """Sensors of a kind are pressed, by their numbers in its order; the first where none is given."""

    def change(measurement: Measurement) -> Measurement:
        values = getattr(measurement, sensor).copy()
        values[list(numbers or (0,))] = 1.0
        return replace(measurement, **{sensor: values})

    return change


def heated(joint: str, temperature: float) -> Fault:
    """The motor of a joint has a temperature [deg C].

    Raises:
        UnknownNameError: No such joint.
    """
    index = load_robot().joint_index(joint)

    def change(measurement: Measurement) -> Measurement:
        values = measurement.temperature.copy()
        values[index] = temperature
        return replace(measurement, temperature=values)

    return change


def drained(charge: float) -> Fault:
    """The battery has a charge, 0..1."""
    return lambda measurement: replace(measurement, battery=charge)
