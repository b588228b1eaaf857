"""Finds when touch sensors, bumpers and buttons are pressed and let go."""

from __future__ import annotations

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.events import SensorEvent, SensorKind


class SensorEdges:
    """Compares each measurement with the one before.

    Args:
        robot: Names the sensors.
        first: What is pressed in it already is no event; letting it go is one.
    """

    def __init__(self, robot: RobotConfig, first: Measurement) -> None:
        sensors = robot.sensors
        self._sensors: tuple[tuple[SensorKind, str], ...] = (
            *(("touch", name) for name in sensors.touch),
            *(("bumper", name) for name in sensors.bumpers),
            *(("button", name) for name in sensors.buttons),
        )
        self._bytes = _bytes(first)
        self._pressed = _pressed(first)

    def step(self, measurement: Measurement) -> list[SensorEvent]:
        """The edges of one tick: touch sensors, bumpers, buttons, each in the order of ``sensors.yaml``."""
        now = _bytes(measurement)
        if now == self._bytes:
            return []
        before, self._pressed = self._pressed, _pressed(measurement)
        self._bytes = now
        return [
            SensorEvent(kind=kind, name=name, pressed=pressed, time=measurement.time)
            for (kind, name), pressed, was in zip(self._sensors, self._pressed, before, strict=True)
            if pressed != was
        ]


def _bytes(measurement: Measurement) -> tuple[bytes, bytes, bytes]:
    """The quickest thing to compare: a third of a microsecond in place of six."""
    return (
        measurement.touch.tobytes(),
        measurement.bumpers.tobytes(),
        measurement.buttons.tobytes(),
    )


def _pressed(measurement: Measurement) -> list[bool]:
    """A value that is not a number presses nothing."""
    values = (measurement.touch, measurement.bumpers, measurement.buttons)
    return [value > 0.5 for sensors in values for value in sensors.tolist()]
