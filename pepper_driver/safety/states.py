"""States of the robot, the transitions between them that are allowed, and why a robot is in FAULT."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from pepper_driver.config import PepperError


class RobotState(Enum):
    """INACTIVE: sensors can be read. ACTIVE: takes commands. FAULT: stands still; never left by itself."""

    INACTIVE = "inactive"
    ACTIVE = "active"
    FAULT = "fault"


TRANSITIONS: Mapping[RobotState, frozenset[RobotState]] = MappingProxyType(
    {
        RobotState.INACTIVE: frozenset({RobotState.ACTIVE, RobotState.FAULT}),
        RobotState.ACTIVE: frozenset({RobotState.INACTIVE, RobotState.FAULT}),
        RobotState.FAULT: frozenset(),  # a new start makes a new gate
    }
)
"""From each state to which others."""


class FaultReason(Enum):
    """Reason for a stop of the robot."""

    EMERGENCY_STOP = "emergency stop"
    CHEST_BUTTON = "chest button"
    STALE_SAMPLE = "stale sample"
    SENSOR = "sensor"
    FOLLOWING_ERROR = "following error"
    STIFFNESS = "stiffness"
    FROZEN_JOINT = "frozen joint"
    FOREIGN_COMMAND = "foreign command"
    COMMAND = "command"
    TEMPERATURE = "temperature"
    BATTERY = "battery"
    EXCEPTION = "exception"
    LOST = "robot lost"


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """Cause of a stop of the robot: the kind of ``reason``, and a human-readable ``text``."""

    reason: FaultReason
    text: str


class FaultError(PepperError, RuntimeError):
    """The safety gate stopped the robot. It stands still, and stays so until it is opened again.

    Attributes:
        fault: What the gate saw.
    """

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        super().__init__(f"the robot was stopped: {fault.text}")


class StateError(PepperError, RuntimeError):
    """A transition between two states that is not allowed."""

    def __init__(self, before: RobotState, after: RobotState) -> None:
        self.before, self.after = before, after
        possible = ", ".join(sorted(state.value for state in TRANSITIONS[before])) or "none"
        super().__init__(
            f"the robot cannot go from {before.value} to {after.value} (possible: {possible})"
        )


class StateMachine:
    """The state of one robot. Transitions may come from any thread; reading the state never waits.

    Attributes:
        state: INACTIVE at the start.
        fault: Why the state is FAULT, the first reason if there were several; None otherwise.
    """

    def __init__(self) -> None:
        self.state = RobotState.INACTIVE
        self.fault: Fault | None = None
        self._lock = threading.RLock()  # a signal handler may stop the robot inside a transition

    def activate(self) -> None:
        """To ACTIVE.

        Raises:
            FaultError: The state is FAULT.
            StateError: It is ACTIVE already.
        """
        with self._lock:
            if self.fault is not None:
                raise FaultError(self.fault)
            self._go(RobotState.ACTIVE)

    def deactivate(self) -> None:
        """To INACTIVE from ACTIVE; other states stay."""
        with self._lock:
            if self.state is RobotState.ACTIVE:
                self._go(RobotState.INACTIVE)

    def fail(self, fault: Fault) -> None:
        """To FAULT; a fault that is there already stays."""
        with self._lock:
            if self.state is not RobotState.FAULT:
                self.fault = fault  # first: a thread that sees FAULT finds the reason
                self._go(RobotState.FAULT)

    def _go(self, after: RobotState) -> None:
        if after not in TRANSITIONS[self.state]:
            raise StateError(self.state, after)
        self.state = after
