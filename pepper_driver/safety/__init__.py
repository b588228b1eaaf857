"""The safety gate between controller and backend: every command passes it, every measurement is watched."""

from pepper_driver.safety.gate import Gated, NotReadyError, SafetyGate
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
    "Gated",
    "NotReadyError",
    "RobotState",
    "SafetyGate",
    "StateError",
]
