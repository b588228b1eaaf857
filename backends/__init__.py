"""Robots, real and simulated, behind one interface."""

from pepper_driver.backends.extras import Extras
from pepper_driver.backends.interface import (
    Backend,
    BackendError,
    BackendInfo,
    Capability,
    CapabilityError,
    Command,
    CommandError,
    DeviceError,
    Imu,
    Measurement,
    NotConnectedError,
    SimulatedPlant,
    Truth,
)
from pepper_driver.backends.selection import make_backend

__all__ = [
    "Backend",
    "BackendError",
    "BackendInfo",
    "Capability",
    "CapabilityError",
    "Command",
    "CommandError",
    "DeviceError",
    "Extras",
    "Imu",
    "Measurement",
    "NotConnectedError",
    "SimulatedPlant",
    "Truth",
    "make_backend",
]
