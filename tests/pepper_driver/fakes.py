"""A backend without physics: joints follow at once, and faults can be injected."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pepper_driver.backends import Backend, BackendInfo, Command, Imu, Measurement
from pepper_driver.config import ControllerSettings, RobotConfig, load_robot
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Reference

Fault = Callable[[Measurement], Measurement]


class FakeBackend(Backend):
    """Perfect joints. ``faults`` maps a tick to a change of its measurement; ``commands`` keeps all that was written.

    Each tick shows the command that was in force ``delay`` ticks before.
    """

    def __init__(self, robot: RobotConfig | None = None, delay: int = 0) -> None:
        self.robot = robot or load_robot()
        self.faults: dict[int, Fault] = {}
        self.commands: list[Command] = []
        self.position = self.robot.posture("Stand")
        self.calls: list[str] = []
        self._tick = 0
        self._delay = delay
        self._in_force: list[FloatArray] = []

    @property
    def uri(self) -> str:
        return "fake"

    @property
    def info(self) -> BackendInfo:
        return BackendInfo(
            joint_names=self.robot.joint_names,
            cycle=self.robot.cycle,
            response_delay=self._delay,
            capabilities=frozenset(),
            identity="fake",
        )

    def open(self) -> Measurement:
        self.calls.append("open")
        return self._measure(self.position)

    def activate(self) -> Measurement:
        self.calls.append("activate")
        return self._measure(self.position)

    def read(self) -> Measurement:
        self._tick += 1
        self._in_force.append(self.commands[-1].position if self.commands else self.position)
        measurement = self._measure(self._in_force[max(0, self._tick - 1 - self._delay)])
        fault = self.faults.get(self._tick)
        return fault(measurement) if fault is not None else measurement

    def write(self, command: Command) -> None:
        self.commands.append(command)

    def deactivate(self) -> None:
        self.calls.append("deactivate")

    def close(self) -> None:
        self.calls.append("close")

    def _measure(self, position: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Measurement:
        return Measurement(
            time=self._tick * self.robot.cycle,
            tick=self._tick,
            position=position.copy(),
            current=np.zeros(17),
            wheel_speed=np.zeros(3),
            imu=Imu(
                acceleration=np.array([0.0, 0.0, 9.81]),
                angular_velocity=np.zeros(3),
                attitude=np.zeros(3),
            ),
            touch=np.zeros(5),
            bumpers=np.zeros(3),
            buttons=np.zeros(1),
            temperature=np.full(17, 38.0),
            battery=1.0,
            age=0.0,
        )


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
