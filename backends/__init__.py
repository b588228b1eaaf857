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
)
from pepper_driver.backends.selection import make_backend
from pepper_driver.backends.simulated import SimulatedPlant, Truth

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
