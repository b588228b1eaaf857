"""Where each value stands in the table between the processes."""

from __future__ import annotations

from pepper_driver.config import RobotConfig
from pepper_driver.config.naoqi_devices import NaoqiDevices


def table_keys(robot: RobotConfig, devices: NaoqiDevices) -> dict[str, int]:
    """Place of every key in the table: actuators first, in the order of the DCM, then sensors, then the date."""
    sensors = [key for key in devices.values if key not in set(devices.actuators)]
    return {
        key: place for place, key in enumerate([*devices.actuators, *sensors, robot.naoqi.time])
    }
