"""Measurements of a robot that stands still, faults for them, and references."""

from dataclasses import replace

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.config import ControllerSettings
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Reference


def quiet() -> Measurement:
    """A sample of a robot that stands, and that nothing touches."""
    return MockBackend().open()


def aged(seconds: float) -> Fault:
    return lambda measurement: replace(measurement, age=seconds)


def displaced(joint: int, by: float) -> Fault:
    def change(measurement: Measurement) -> Measurement:
        position = measurement.position.copy()
        position[joint] += by
        return replace(measurement, position=position)

    return change


def pressed(sensor: str, index: int = 0) -> Fault:
    """A bumper or button (``bumpers`` or ``buttons``) is pressed."""

    def change(measurement: Measurement) -> Measurement:
        values = getattr(measurement, sensor).copy()
        values[index] = 1.0
        return replace(measurement, **{sensor: values})

    return change


def heated(joint: int, temperature: float) -> Fault:
    def change(measurement: Measurement) -> Measurement:
        values = measurement.temperature.copy()
        values[joint] = temperature
        return replace(measurement, temperature=values)

    return change


def drained(charge: float) -> Fault:
    return lambda measurement: replace(measurement, battery=charge)


def slowed(settings: ControllerSettings, speed: float) -> ControllerSettings:
    """Settings for a gate that lets no joint pass faster than ``speed`` [rad/s] times its margin."""
    return replace(settings, velocity_limit=dict.fromkeys(settings.velocity_limit, speed))


def reference(position: FloatArray) -> Reference:
    """At rest at a posture."""
    zero = np.zeros(17)
    return Reference(
        position=position,
        velocity=zero,
        acceleration=zero,
        load_torque=zero,
        base_twist=np.zeros(3),
    )
