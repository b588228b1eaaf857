"""The safety gate between controller and backend: every command passes it, every measurement is watched."""

from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.safety.gate import GatedCommand, SafetyGate
from pepper_driver.safety.states import (
    TRANSITIONS,
    Fault,
    FaultError,
    FaultReason,
    RobotState,
    StateError,
)

__all__ = [
    "TRANSITIONS",
    "Fault",
    "FaultError",
    "FaultReason",
    "GatedCommand",
    "NotReadyError",
    "RobotState",
    "SafetyGate",
    "StateError",
]
