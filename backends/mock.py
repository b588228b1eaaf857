"""A robot without physics: it follows commands exactly. For dry runs, and for tests of programs that drive a robot."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from pepper_driver.backends.fields import Command, Imu, Measurement
from pepper_driver.backends.interface import (
    DEAD_MAN_CYCLES,
    MAX_RESPONSE_DELAY,
    Backend,
    BackendError,
    BackendInfo,
    NotConnectedError,
    Serial,
    checked_command,
    serial,
)
from pepper_driver.backends.selection import BackendUri
from pepper_driver.config import ConfigError, RobotConfig, load_robot
from pepper_driver.config.arrays import FloatArray

Fault = Callable[[Measurement], Measurement]
"""Returns the measurement of a faulty robot."""

GRAVITY = 9.81
"""[m/s2]"""

TEMPERATURE = 38.0
"""[deg C] Of all motors."""


class MockBackend(Serial, Backend):
    """A Pepper whose joints and wheels follow commands at once, without contacts.

    Args:
        robot: Its description, by default the shipped Pepper.
        posture: Name of the posture in which it stands.
        delay: Cycles from a command to the sample that shows it.
        faults: Changes of measurements, by tick.
        real_time: True to report that time passes by itself, as on a robot. It still passes with each ``read``.
        uri: URI it was asked for.

    Attributes:
        position: (17,) where the joints are [rad]. May be changed while it is not active.
        faults: Changes of measurements, by tick. May be changed at any time.
        commands: All that was written, as it was given, oldest first; never cleared.
        calls: Names of all calls of ``open``, ``activate``, ``deactivate`` and ``close``, oldest first; never cleared.

    Raises:
        UnknownNameError: No such posture.
        ConfigError: A negative delay.
    """

    def __init__(
        self,
        robot: RobotConfig | None = None,
        *,
        posture: str = "Stand",
        delay: int = 0,
        faults: Mapping[int, Fault] | None = None,
        real_time: bool = False,
        uri: str = "mock",
    ) -> None:
        super().__init__()
        if delay < 0:
            raise ConfigError(f"backend '{uri}': delay must be 0 or more cycles, got {delay}")
        self._robot, self._uri, self._delay = robot or load_robot(), uri, delay
        self.real_time = real_time
        self.position = self._robot.posture(posture)
        self.faults: dict[int, Fault] = dict(faults or {})
        self.commands: list[Command] = []
        self.calls: list[str] = []
        self._state: Literal["closed", "open", "active"] = "closed"
        self._tick = self._repeats = 0  # reads since ``open``, and since the last ``write``

    @property
    def uri(self) -> str:
        """The URI it was asked for."""
        return self._uri

    @property
    def info(self) -> BackendInfo:
        """Facts about a robot that can do nothing but move and measure."""
        return BackendInfo(
            joint_names=self._robot.joint_names,
            cycle=self._robot.cycle,
            response_delay=self._delay,
            capabilities=frozenset(),
            identity="mock",
            name=self.uri,
        )

    @serial
    def open(self) -> Measurement:
        """Stand where ``position`` says."""
        self.calls.append("open")
        if self._state != "closed":
            raise BackendError(f"'{self.uri}' is already open")
        self._tick, self._state = 0, "open"
        self._stand()
        self._shown = deque([self._now()], maxlen=self._delay + 1)
        return self._measure()

    @serial
    def activate(self) -> Measurement:
        """Hold the joints from now on; takes no time."""
        self.calls.append("activate")
        self._check_open()
        if self._state == "active":
            raise BackendError(f"'{self.uri}' is already active")
        self._state = "active"
        self._stand()
        return self._measure()

    @serial
    def read(self) -> Measurement:
        """Simulate one cycle."""
        self._check_open()
        self._tick += 1
        if self._state == "active":
            self.position = self._target
            self._repeats += 1
            if self._repeats > DEAD_MAN_CYCLES:
                self._wheel_speed = np.zeros(3)
        self._shown.append(self._now())
        return self._measure()

    @serial
    def write(self, command: Command) -> None:
        """Act in the cycle of the next ``read``."""
        self._check_open()
        position, stiffness, wheel_speed = checked_command(command, len(self.position))
        # Copies, because the caller may change its arrays afterwards.
        self.commands.append(
            Command(
                position=position.copy(),
                stiffness=stiffness.copy(),
                wheel_speed=wheel_speed.copy(),
            )
        )
        if self._state == "active":
            robot, limit = self._robot, self._robot.wheels.speed_limit
            self._target = np.clip(position, robot.lower, robot.upper)
            self._wheel_speed = np.clip(wheel_speed, -limit, limit)
            self._repeats = 0

    @serial
    def deactivate(self) -> None:
        """Stop the wheels; the joints stay where they are."""
        self.calls.append("deactivate")
        self._deactivate()

    @serial
    def close(self) -> None:
        """Deactivate and disconnect."""
        self.calls.append("close")
        self._deactivate()
        self._state = "closed"

    def _deactivate(self) -> None:
        if self._state == "active":
            self._state = "open"
            self._stand()

    def _stand(self) -> None:
        """Stay at ``position``, within the limits of the joints, with wheels that stand."""
        self.position = np.clip(self.position, self._robot.lower, self._robot.upper)
        self._target, self._wheel_speed, self._repeats = self.position, np.zeros(3), 0

    def _now(self) -> tuple[FloatArray, FloatArray]:
        return self.position.copy(), self._wheel_speed

    def _measure(self) -> Measurement:
        position, wheel_speed = self._shown[0]
        n, sensors = len(position), self._robot.sensors
        measurement = Measurement(
            time=self._tick * self._robot.cycle,
            tick=self._tick,
            position=position.copy(),
            current=np.zeros(n),
            wheel_speed=wheel_speed.copy(),
            imu=Imu(
                acceleration=np.array([0.0, 0.0, GRAVITY]),
                angular_velocity=np.zeros(3),
                attitude=np.zeros(3),
            ),
            touch=np.zeros(len(sensors.touch)),
            bumpers=np.zeros(len(sensors.bumpers)),
            buttons=np.zeros(len(sensors.buttons)),
            temperature=np.full(n, TEMPERATURE),
            battery=1.0,
            age=0.0,
        )
        fault = self.faults.get(self._tick)
        return measurement if fault is None else fault(measurement)

    def _check_open(self) -> None:
        if self._state == "closed":
            raise NotConnectedError(f"'{self.uri}' is not open")


def from_uri(uri: BackendUri, robot: RobotConfig) -> MockBackend:
    """``mock://?posture=NAME&delay=N``; all keys optional."""
    uri.check_keys({"posture", "delay"}, host=False)
    return MockBackend(
        robot,
        posture=uri.query.get("posture", "Stand"),
        delay=uri.integer("delay", 0, MAX_RESPONSE_DELAY),
        uri=uri.text,
    )
