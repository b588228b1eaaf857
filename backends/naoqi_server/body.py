"""The robot's boards and body: what the DCM sends moves the simulated Pepper, what it measures becomes values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.backends.mujoco_.backend import MujocoBackend
from pepper_driver.backends.naoqi_server.keys import table_keys
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray, IndexArray
from pepper_driver.config.naoqi_devices import NaoqiDevices

HOT, VERY_HOT = 68.0, 74.0
"""[deg C] Where ``Temperature/Sensor/Status`` becomes 1 and 2: levels of public ROS drivers of Pepper."""


class Body:
    """A simulated Pepper behind the DCM.

    Attributes:
        backend: The simulation.
        keys: Key of each value of the table, to its place.
        values: Their newest values, sensors and what was sent to the actuators.
        sent: The command of the last cycle, as the boards took it.
        measurement: The sample of the last cycle.

    ``date`` is that of the start, as the robot's clock shows it.
    """

    def __init__(
        self, robot: RobotConfig, devices: NaoqiDevices, backend: MujocoBackend, date: int
    ) -> None:
        self.backend = backend
        self.keys = table_keys(robot, devices)
        self.values = np.array([devices.values.get(key, 0.0) for key in self.keys])
        self._robot = robot
        self._actuators = len(devices.actuators)
        names, joints, wheels = robot.naoqi, robot.joint_names, robot.wheels.names
        place = self._places
        self._position_command = place(names.position_command, joint=joints)
        self._stiffness_command = place(names.stiffness_command, joint=joints)
        self._wheel_command = place(names.wheel_speed_command, wheel=wheels)
        self._wheel_stiffness = place(names.wheel_stiffness_command, wheel=wheels)
        self._temperature_status = place("{joint}/Temperature/Sensor/Status", joint=joints)
        self._sensors: Mapping[str, IndexArray] = {
            "position": place(names.position, joint=joints),
            "current": place(names.current, joint=joints),
            "temperature": place(names.temperature, joint=joints),
            "wheel_speed": place(names.wheel_speed, wheel=wheels),
            "touch": place(names.touch, touch=tuple(robot.sensors.touch)),
            "bumpers": place(names.bumper, bumper=tuple(robot.sensors.bumpers)),
            "buttons": place(names.button, button=tuple(robot.sensors.buttons)),
        }
        self._imu = place("{imu}", imu=(*names.accelerometer, *names.gyroscope, *names.attitude))
        self._battery = self.keys[names.prefix + names.battery_charge]
        self._date = self.keys[names.time]
        self.values[self._date] = date
        self._mirrored = [
            (self.keys[key], self.keys[sensor])
            for key in devices.actuators
            if (sensor := key.replace("/OperationMode/Actuator/", "/OperationMode/Sensor/")) != key
        ]
        self.measurement = backend.open()
        backend.switch_on()
        start = np.clip(self.measurement.position, robot.lower, robot.upper)
        self.values[self._position_command] = start
        self.sent = self._command()
        self._take(self.measurement)

    @property
    def actuator_values(self) -> dict[str, float]:
        """What was last sent to each actuator, in the order of the DCM."""
        return dict(zip(self.keys, self.values[: self._actuators].tolist(), strict=False))

    def cycle(self, actuators: list[float], date: int) -> None:
        """One cycle of 12 ms, towards what the DCM sends.

        Args:
            actuators: Their values, in the order of the DCM.
            date: Of this cycle, as the robot's clock shows it.

        Raises:
            BackendError: The simulation diverged.
        """
        self.values[: self._actuators] = actuators
        self.sent = self._command()
        self.backend.wheel_stiffness = np.clip(self.values[self._wheel_stiffness], 0.0, 1.0)
        self.backend.write(self.sent)
        self.measurement = self.backend.read()
        self._take(self.measurement)
        self.values[self._date] = date

    def _command(self) -> Command:
        """What the boards make of it: a joint's goes no farther than the joint."""
        robot, values = self._robot, self.values
        limit = robot.wheels.speed_limit
        return Command(
            position=np.clip(values[self._position_command], robot.lower, robot.upper),
            stiffness=np.clip(values[self._stiffness_command], 0.0, 1.0),
            wheel_speed=np.clip(values[self._wheel_command], -limit, limit),
        )

    def _take(self, measurement: Measurement) -> None:
        values = self.values
        for name, places in self._sensors.items():
            values[places] = getattr(measurement, name)
        imu = measurement.imu
        values[self._imu] = np.concatenate([imu.acceleration, imu.angular_velocity, imu.attitude])
        values[self._battery] = measurement.battery
        heat = measurement.temperature
        values[self._temperature_status] = np.where(heat >= VERY_HOT, 2.0, heat >= HOT)
        for actuator, sensor in self._mirrored:
            values[sensor] = values[actuator]

    @property
    def info(self) -> dict[str, Any]:
        """What the robot says of itself, for the other processes."""
        info, plant = self.backend.info, self.backend.plant.config
        assert plant is not None  # of MuJoCo
        return {
            "identity": info.identity,
            "parents": [[parent.name, parent.identity] for parent in info.parents],
            "uri": self.backend.uri,
            "plant": plant.name,
            "response_delay": info.response_delay,
            "cycle_ms": round(1000 * info.cycle),
        }

    def true_state(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(17,) joints [rad], (3,) wheel speeds [rad/s] and (3,) base (x, y [m], yaw [rad]), as they really are."""
        truth = self.backend.truth
        return truth.position, self.measurement.wheel_speed, truth.base

    def commanded(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """What the DCM sent: positions (17,), hardness (17,), wheel speeds (3,) and wheel stiffness (3,)."""
        values = self.values
        return (
            values[self._position_command],
            values[self._stiffness_command],
            values[self._wheel_command],
            values[self._wheel_stiffness],
        )

    def _places(self, pattern: str, **names: tuple[str, ...]) -> IndexArray:
        ((slot, choices),) = names.items()
        prefix = self._robot.naoqi.prefix
        return np.array([self.keys[prefix + pattern.format(**{slot: n})] for n in choices])
