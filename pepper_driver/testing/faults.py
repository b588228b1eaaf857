"""Measurements of a faulty robot, for ``MockBackend(faults=...)`` and similar backends."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import Fault
from pepper_driver.config import load_robot


def aged(seconds: float) -> Fault:
    """Set the age of a sample [s]."""
    return lambda measurement: replace(measurement, age=seconds)


def displaced(joint: str, by: float) -> Fault:
    """Displace the measurement of a joint by an angle [rad]: it is pushed, or its sensor fails.

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
    """Set the temperature of a joint's motor [deg C].

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
    """Set the charge of the battery, 0..1."""
    return lambda measurement: replace(measurement, battery=charge)
