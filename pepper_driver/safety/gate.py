"""The gate that every command passes: limits, stiffness ramp, faults. It fails towards standing still."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from pepper_driver.backends import Command, Measurement
from pepper_driver.backends.readiness import check_readiness, refuse_failed
from pepper_driver.config import ControllerSettings, RobotConfig, SafetySettings
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel
from pepper_driver.controller import Reference
from pepper_driver.safety.limits import (
    BaseGuard,
    JointLimit,
    WheelLimit,
    joint_limits,
    limit_joints,
    limit_wheels,
    ramp_stiffness,
)
from pepper_driver.safety.monitor import MeasurementMonitor
from pepper_driver.safety.states import Fault, FaultReason, RobotState, StateMachine

ACTIVE = RobotState.ACTIVE  # looked up once: each time costs 0.1 us

# What differs between a request and its command: flags; or, negative, why there is no command.
UNCHANGED, JOINTS, WHEELS, STIFFNESS = 0, 1, 2, 4
UNUSABLE, NO_POSITION, NO_STIFFNESS, NO_WHEEL_SPEED = -1, -2, -3, -4

NOT_FINITE = {
    NO_POSITION: "position",
    NO_STIFFNESS: "stiffness",
    NO_WHEEL_SPEED: "wheel speed",
}


@kernel
def all_finite(values: FloatArray) -> bool:
    """Return whether no value is NaN or infinite."""
    finite = True
    for value in values:
        finite &= isfinite(value)
    return finite


@kernel
def limit_command(
    joints: Out[Records[JointLimit]],
    wheels: Out[Records[WheelLimit]],
    requested: FloatArray,
    stiffness: FloatArray,
    wheel_speed: FloatArray,
    old: bool,
    stop_base: bool,
    position: Out[FloatArray],
) -> int:
    """Make the next command of a request; return what differs, or why there is none.

    Args:
        joints: (n,) limits and last commands; then what is limited, and the stiffness of the command.
        wheels: (3,) limits and last commands; then the speeds of the command.
        requested: (n,) positions [rad].
        stiffness: (n,) requested.
        wheel_speed: (3,) requested [rad/s].
        old: Brake joints and wheels to rest: what is measured is too old.
        stop_base: Stop the wheels.
        position: (n,) of the command [rad].
    """
    n = len(joints)
    if len(requested) != n or len(stiffness) != n or len(wheel_speed) != len(wheels):
        return UNUSABLE
    if not all_finite(stiffness):
        return NO_STIFFNESS
    if not all_finite(wheel_speed):
        return NO_WHEEL_SPEED
    if not all_finite(requested):
        return NO_POSITION
    changes = UNCHANGED
    if ramp_stiffness(joints, stiffness):
        changes |= STIFFNESS
    if limit_wheels(wheels, wheel_speed, stop_base or old) or old:
        changes |= WHEELS
    if limit_joints(joints, requested, old, position):
        changes |= JOINTS
    return changes


class GatedCommand(NamedTuple):
    """Command that leaves the gate, and its changes.

    Attributes:
        command: To send.
        limited: (17,) where its position is not the reference's; not to be written to.
        joints_limited: Whether there is any such joint.
        wheels_limited: Whether its wheel speeds are not the requested ones.
    """

    command: Command
    limited: BoolArray
    joints_limited: bool
    wheels_limited: bool


class SafetyGate:
    """Checks each reference against the robot's limits and each measurement against the command it answers.

    A reference outside the limits of position, speed or acceleration is clamped and flagged, so that every joint can
    still stop before its position limit; wheels too fast are slowed together, so that the base keeps its direction. On
    old data the joints brake to rest and the wheels stop. What cannot be trusted any more puts the robot into FAULT:
    joints are held where they were last sent, wheels stop, and nothing but a new gate leaves that state.

    The limits are those of the controller times a margin: nothing that it sends within its own is changed.
    """

    def __init__(
        self, robot: RobotConfig, settings: SafetySettings, controller: ControllerSettings
    ) -> None:
        self._robot, self._settings = robot, settings
        self._machine = StateMachine()
        self._limit = limit_command.load()
        self._joints = joint_limits(
            robot.lower,
            robot.upper,
            settings.speed_margin * controller.joint_velocity(robot),
            settings.acceleration_margin * controller.joint_acceleration(robot),
            settings.stiffness_ramp,
            robot.cycle,
        )
        self._base = BaseGuard(robot, settings)
        self._watch = MeasurementMonitor(robot, settings)
        n = len(robot.joint_names)
        self._n = n
        self._none = _constant(np.zeros(n, dtype=np.bool_))
        self._all = _constant(np.ones(n, dtype=np.bool_))
        self._sent = Command(position=np.zeros(n), stiffness=np.zeros(n), wheel_speed=np.zeros(3))

    @property
    def state(self) -> RobotState:
        """INACTIVE, ACTIVE or FAULT."""
        return self._machine.state

    @property
    def fault(self) -> Fault | None:
        """Why the state is FAULT; None otherwise."""
        return self._machine.fault

    @property
    def sent(self) -> Command:
        """The last command that left the gate."""
        return self._sent

    @property
    def base_stopped(self) -> str:
        """Human-readable reason why the base must stand; empty when it may roll."""
        return self._base.stopped

    # -- states -------------------------------------------------------------------------------------------------

    def check_ready(self, measurement: Measurement) -> None:
        """Check that a robot at rest may start to move.

        Raises:
            NotReadyError: It should not: the message names every reason and its remedy.
        """
        results = check_readiness(measurement, self._robot, self._settings)
        refuse_failed("the robot is not ready to move", results)

    def activate(self, position: FloatArray) -> None:
        """Start to pass commands, from a robot that stands stiff at ``position`` (17,) [rad].

        Raises:
            FaultError: The gate is in FAULT.
            StateError: It is active already.
        """
        self._machine.activate()
        held = np.clip(position, self._robot.lower, self._robot.upper)
        joints = self._joints
        joints["position"], joints["step"], joints["stiffness"] = held, 0.0, 1.0
        self._base.reset()
        self._watch.reset()
        self._sent = Command(position=held, stiffness=np.ones(self._n), wheel_speed=np.zeros(3))

    def deactivate(self) -> None:
        """No command passes any more; a FAULT stays."""
        self._machine.deactivate()

    def stop(self, reason: FaultReason, text: str) -> None:
        """Enter FAULT now: hold the joints, stop the wheels. Any thread may call."""
        self._machine.fail(Fault(reason=reason, text=text))

    def hold(self) -> Command:
        """Return the command that holds the joints where they were last sent and stops the wheels."""
        self._sent = Command(
            position=self._sent.position,
            stiffness=self._sent.stiffness,
            wheel_speed=self._base.stop(),
        )
        return self._sent

    # -- one tick -----------------------------------------------------------------------------------------------

    def watch(self, measurement: Measurement, answered: Command) -> None:
        """Compare a measurement with its command; enter FAULT when the robot cannot be trusted."""
        fault = self._watch.check(measurement, answered, self._sent)
        if fault is not None:
            self._machine.fail(fault)
        self._base.see(measurement)

    def gate(
        self, reference: Reference, stiffness: FloatArray, wheel_speed: FloatArray, age: float
    ) -> GatedCommand:
        """Return the command to send for a reference.

        Args:
            reference: Reference state of the controller.
            stiffness: (17,) requested stiffness, 0..1.
            wheel_speed: (3,) requested wheel speed [rad/s].
            age: Age of the newest sample [s].
        """
        if self._machine.state is not ACTIVE:
            arrays = self._arrays(reference.position, stiffness, wheel_speed)
            return self._held(self._all if arrays is None else self._sent.position != arrays[0])
        before, base, position = self._sent, self._base, np.empty(self._n)
        old = not age <= self._settings.stale_hold  # NaN is old too
        try:
            changes = self._limit(
                self._joints,
                base.wheels,
                reference.position,
                stiffness,
                wheel_speed,
                old,
                base.stopped != "",
                position,
            )
        except TypeError:  # of the kernel: not the arrays that it takes
            changes = UNUSABLE
        if changes == UNCHANGED:
            self._sent = Command(
                position=position, stiffness=before.stiffness, wheel_speed=wheel_speed
            )
            return GatedCommand(self._sent, self._none, False, False)
        if changes == UNUSABLE:
            arrays = self._arrays(reference.position, stiffness, wheel_speed)
            if arrays is None:
                return self._held(self._all)
            return self.gate(replace(reference, position=arrays[0]), arrays[1], arrays[2], age)
        if changes in NOT_FINITE:
            text = f"asked for a {NOT_FINITE[changes]} that is not a number"
            self.stop(FaultReason.COMMAND, text)
            return self._held(self._all)
        joints, wheels = bool(changes & JOINTS), bool(changes & WHEELS)
        self._sent = Command(
            position=position,
            stiffness=self._joints["stiffness"].copy() if changes & STIFFNESS else before.stiffness,
            wheel_speed=base.wheels["speed"].copy() if wheels else wheel_speed,
        )
        limited = self._joints["limited"].copy() if joints else self._none
        return GatedCommand(self._sent, limited, joints, wheels)

    def _arrays(self, *parts: FloatArray) -> list[FloatArray] | None:
        """Position, stiffness and wheel speed as a kernel takes them; None, and FAULT, where they are no such numbers.

        Reflexes may give anything.
        """
        arrays = []
        for what, values, size in zip(
            ("position", "stiffness", "wheel speed"), parts, (self._n, self._n, 3), strict=True
        ):
            try:
                array = np.array(values, dtype=np.float64, order="C")
            except (TypeError, ValueError, OverflowError):
                text = f"asked for a {what} that is no array of numbers"
                self.stop(FaultReason.COMMAND, text)
                return None
            if array.shape != (size,):
                text = f"asked for a {what} of {array.shape} values, not {size}"
                self.stop(FaultReason.COMMAND, text)
                return None
            arrays.append(array)
        return arrays

    def _held(self, limited: BoolArray) -> GatedCommand:
        command = self.hold()
        return GatedCommand(command, limited, bool(limited.any()), True)


def _constant(values: BoolArray) -> BoolArray:
    values.setflags(write=False)
    return values
