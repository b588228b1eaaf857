"""The gate that every command passes between controller and backend. It fails towards standing still."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends import Command, Measurement
from pepper_driver.config import (
    ControllerSettings,
    PepperError,
    RobotConfig,
    SafetySettings,
)
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Reference, desaturated


class FaultError(PepperError, RuntimeError):
    """The safety gate stopped the robot. It stands still, and stays so until it is opened anew.

    Attributes:
        reason: What the gate saw.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"the robot was stopped: {reason}")


class RobotState(Enum):
    """INACTIVE: sensors can be read. ACTIVE: takes commands. FAULT: stands still; never left by itself."""

    INACTIVE = "inactive"
    ACTIVE = "active"
    FAULT = "fault"


@dataclass(frozen=True, kw_only=True, slots=True)
class Gated:
    """What leaves the gate: the ``command`` to send, and (17,) where its position is not the reference's."""

    command: Command
    changed: NDArray[np.bool_]


class SafetyGate:
    """Checks each reference against the robot's limits and the last measurement.

    A reference outside position or speed limits is clamped and flagged; wheels too fast are slowed together, so that
    the base keeps its direction. Data that cannot be trusted (not finite, old, or far from what was commanded) hold the
    last command and, when it lasts, put the robot into FAULT.
    """

    def __init__(
        self, robot: RobotConfig, settings: SafetySettings, controller: ControllerSettings
    ) -> None:
        self._robot = robot
        self._settings = settings
        speed = controller.joint_velocity(robot)
        self._largest_step = settings.speed_margin * speed * robot.cycle
        self._divergence_ticks = round(settings.divergence_time / robot.cycle)
        self._largest_stiffness_step = robot.cycle / settings.stiffness_ramp
        self._state = RobotState.INACTIVE
        self._fault = ""
        n = len(robot.joint_names)
        self._sent = Command(position=np.zeros(n), stiffness=np.zeros(n), wheel_speed=np.zeros(3))
        self._diverging = np.zeros(n, dtype=np.int64)

    @property
    def state(self) -> RobotState:
        """INACTIVE, ACTIVE or FAULT."""
        return self._state

    @property
    def fault(self) -> str:
        """Why the state is FAULT; empty otherwise."""
        return self._fault

    @property
    def sent(self) -> Command:
        """The last command that left the gate."""
        return self._sent

    def activate(self, position: FloatArray) -> None:
        """Start to pass commands, from a robot that stands stiff at ``position`` (17,) [rad].

        Raises:
            FaultError: The gate is in FAULT.
        """
        if self._state is RobotState.FAULT:
            raise FaultError(self._fault)
        self._sent = Command(
            position=position.copy(), stiffness=np.ones(len(position)), wheel_speed=np.zeros(3)
        )
        self._diverging[:] = 0
        self._state = RobotState.ACTIVE

    def deactivate(self) -> None:
        """No command passes any more; a FAULT stays."""
        if self._state is RobotState.ACTIVE:
            self._state = RobotState.INACTIVE

    def stop(self, reason: str) -> None:
        """Go to FAULT now: hold the joints, stop the wheels."""
        if self._state is not RobotState.FAULT:
            self._state, self._fault = RobotState.FAULT, reason

    def hold(self) -> Command:
        """The command that holds the joints where they were last sent and stops the wheels."""
        last = self._sent
        self._sent = Command(
            position=last.position, stiffness=last.stiffness, wheel_speed=np.zeros(3)
        )
        return self._sent

    def watch(self, measurement: Measurement, answered: Command) -> None:
        """Compare a measurement with the command it answers; goes to FAULT when the robot cannot be trusted."""
        if not measurement.age <= self._settings.stale_fault:  # NaN is old too
            self.stop(f"the newest sample is {measurement.age * 1e3:.0f} ms old")
        if not np.isfinite(measurement.position).all():
            self.stop("a joint position is not a number")
            return
        distance = np.abs(answered.position - measurement.position)
        far = (distance > self._settings.divergence) & (answered.stiffness > 0.5)
        self._diverging = np.where(far, self._diverging + 1, 0)
        if self._diverging.max() > self._divergence_ticks:
            name = self._robot.joint_names[int(self._diverging.argmax())]
            self.stop(
                f"{name} stays {np.degrees(distance[self._robot.joint_index(name)]):.0f} deg from its command"
            )

    def gate(
        self, reference: Reference, stiffness: FloatArray, wheel_speed: FloatArray, age: float
    ) -> Gated:
        """The command to send for a reference.

        Args:
            reference: What the controller wants.
            stiffness: (17,) wanted stiffness, 0..1.
            wheel_speed: (3,) wanted wheel speed [rad/s].
            age: Age of the newest sample [s].
        """
        last, robot = self._sent, self._robot
        for wanted, before in (
            (reference.position, last.position),
            (stiffness, last.stiffness),
            (wheel_speed, last.wheel_speed),
        ):
            if np.shape(wanted) != before.shape:
                self.stop(f"asked for {np.shape(wanted)} values in place of {before.shape}")
                return Gated(command=self.hold(), changed=np.ones(len(last.position), np.bool_))
            if not np.isfinite(wanted).all():
                self.stop("asked for something that is not a number")
        if self._state is not RobotState.ACTIVE or not age <= self._settings.stale_hold:
            held = self.hold()
            return Gated(command=held, changed=held.position != reference.position)
        step = self._largest_step
        position = np.clip(reference.position, last.position - step, last.position + step)
        np.clip(position, robot.lower, robot.upper, out=position)
        changed = np.abs(position - reference.position) > self._settings.position_tolerance
        ramp = self._largest_stiffness_step
        stiffness = np.clip(stiffness, last.stiffness - ramp, last.stiffness + ramp)
        self._sent = Command(
            position=position,
            stiffness=np.clip(stiffness, 0.0, 1.0),
            wheel_speed=desaturated(wheel_speed, robot.wheels.speed_limit),
        )
        return Gated(command=self._sent, changed=changed)
