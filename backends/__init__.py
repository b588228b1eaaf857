"""Robots, real and simulated, behind one interface."""

from pepper_driver.backends.fields import Command, Imu, Measurement
from pepper_driver.backends.interface import (
    DEAD_MAN_CYCLES,
    Backend,
    BackendError,
    BackendInfo,
    Capability,
    CapabilityError,
    CommandError,
    DeviceError,
    NotConnectedError,
    Serial,
    checked_command,
    serial,
)
from pepper_driver.backends.pushes import ScheduledPush
from pepper_driver.backends.robot_services import RobotServices
from pepper_driver.backends.selection import BackendUri, make_backend, with_query
from pepper_driver.backends.simulated import Grab, Push, SimulatedPlant, TrueContact, Truth

__all__ = [
    "DEAD_MAN_CYCLES",
    "Backend",
    "BackendError",
    "BackendInfo",
    "BackendUri",
    "Capability",
    "CapabilityError",
    "Command",
    "CommandError",
    "DeviceError",
    "Grab",
    "Imu",
    "Measurement",
    "NotConnectedError",
    "Push",
    "RobotServices",
    "ScheduledPush",
    "Serial",
    "SimulatedPlant",
    "TrueContact",
    "Truth",
    "checked_command",
    "make_backend",
    "serial",
    "with_query",
]
