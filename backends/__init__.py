"""Robots, real and simulated, behind one interface."""

from pepper_driver.backends.extras import Extras
from pepper_driver.backends.interface import (
    Backend,
    BackendError,
    BackendInfo,
    Capability,
    CapabilityError,
    Command,
    DeviceError,
    Imu,
    Measurement,
    NotConnectedError,
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
    "DeviceError",
    "Extras",
    "Imu",
    "Measurement",
    "NotConnectedError",
    "Truth",
    "make_backend",
]
