"""What a service of the stand-in is given."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from pepper_driver.backends.naoqi_server.fault_desk import FaultDesk
from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.backends.naoqi_server.modules.shared import Shared
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.backends.naoqi_server.sensor_events import SensorEvents
from pepper_driver.config import RobotConfig


@dataclass(frozen=True, kw_only=True)
class Context:
    """What services share.

    Attributes:
        robot: The robot.
        memory: What ALMemory holds; raises events.
        config: What the robot is.
        events: Raises events of its touch sensors.
        faults: Takes what is to go wrong.
        shared: What the services of the package ``modules`` share.
        services: Names of the services that this session offers.
        call: ``call(service, method, *arguments)`` calls a service of this session without waiting for it.
    """

    robot: Robot
    memory: Memory
    config: RobotConfig
    events: SensorEvents
    faults: FaultDesk
    shared: Shared
    services: Callable[[], Collection[str]]
    call: Callable[..., Any]
