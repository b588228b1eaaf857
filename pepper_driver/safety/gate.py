"""The gate that every command passes: limits, stiffness ramp, faults. It fails towards standing still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Command, Measurement
from pepper_driver.backends.readiness import check_readiness, refuse_failed
from pepper_driver.config import ControllerSettings, RobotConfig, SafetySettings
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller import Reference
from pepper_driver.safety.limits import BaseGuard, JointLimits
from pepper_driver.safety.monitor import MeasurementMonitor
from pepper_driver.safety.states import Fault, FaultReason, RobotState, StateMachine

FLOAT = np.dtype(np.float64)


@dataclass(frozen=True, kw_only=True, slots=True)
class GatedCommand:
    """Command that leaves the gate, and its changes.

    Attributes:
        command: To send.
        limited: (17,) where its position is not the reference's; not to be written to.
        joints_changed: Whether there is any such joint.
        wheels_changed: Whether its wheel speeds are not the requested ones.
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
        self._joints = JointLimits(
            robot.lower,
            robot.upper,
            settings.speed_margin * controller.joint_velocity(robot),
            settings.acceleration_margin * controller.joint_acceleration(robot),
            robot.cycle,
        )
        self._base = BaseGuard(robot, settings)
        self._watch = MeasurementMonitor(robot, settings)
        self._largest_stiffness_step = robot.cycle / settings.stiffness_ramp
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
        self._joints.start(position)
        self._base.reset()
        self._watch.reset()
        self._sent = Command(
            position=self._joints.position, stiffness=np.ones(self._n), wheel_speed=np.zeros(3)
        )

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
        before, joints, n = self._sent, self._joints, self._n
        requested, stiff, rolling = reference.position, stiffness, wheel_speed
        if not (_is_vector(requested, n) and _is_vector(stiff, n) and _is_vector(rolling, 3)):
            position = self._array("position", requested, n)
            stiffnesses = self._array("stiffness", stiff, n)
            speeds = self._array("wheel speed", rolling, 3)
            if position is None or stiffnesses is None or speeds is None:
                return self._held(self._all)
            requested, stiff, rolling = position, stiffnesses, speeds
        if self._machine.state is not RobotState.ACTIVE:
            return self._held(before.position != requested)
        limited = self._none
        # The usual cases first; what is not finite is never among them.
        if np.count_nonzero(stiff == before.stiffness) == n:
            stiff = before.stiffness
        elif not self._finite("stiffness", stiff):
            return self._held(self._all)
        else:
            ramp = self._largest_stiffness_step
            stiff = np.clip(stiff, before.stiffness - ramp, before.stiffness + ramp)
            stiff = np.clip(stiff, 0.0, 1.0)
        wheels = self._base.limit(rolling)
        if wheels is None:
            self._finite("wheel speed", rolling)
            return self._held(self._all)
        if not age <= self._settings.stale_hold:  # NaN is old too
            if not self._finite("position", requested):
                return self._held(self._all)
            joints.clamp(before.position)
            limited, wheels = joints.position != requested, self._base.stop()
        elif not joints.keep(requested):
            if not self._finite("position", requested):
                return self._held(self._all)
            limited = joints.clamp(requested)
        self._sent = Command(position=joints.position, stiffness=stiff, wheel_speed=wheels)
        return GatedCommand(
            command=self._sent,
            limited=limited,
            joints_limited=limited is not self._none and bool(limited.any()),
            wheels_limited=wheels is not wheel_speed,
        )

    def _array(self, what: str, values: FloatArray, n: int) -> FloatArray | None:
        """``values`` as (n,) numbers; None, and FAULT, where they are not: reflexes may give anything."""
        try:
            values = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            self.stop(FaultReason.COMMAND, f"asked for a {what} that is no array of numbers")
            return None
        if values.shape != (n,):
            self.stop(FaultReason.COMMAND, f"asked for a {what} of {values.shape} values, not {n}")
            return None
        return values

    def _finite(self, what: str, values: FloatArray) -> bool:
        """Return True if all values are finite; otherwise enter FAULT."""
        if np.isfinite(values).all():
            return True
        self.stop(FaultReason.COMMAND, f"asked for a {what} that is not a number")
        return False

    def _held(self, limited: BoolArray) -> GatedCommand:
        command = self.hold()
        return GatedCommand(
            command=command,
            limited=limited,
            joints_limited=bool(limited.any()),
            wheels_limited=True,
        )


def _is_vector(values: FloatArray, n: int) -> bool:
    return type(values) is np.ndarray and values.dtype is FLOAT and values.shape == (n,)


def _constant(values: BoolArray) -> BoolArray:
    values.setflags(write=False)
    return values
