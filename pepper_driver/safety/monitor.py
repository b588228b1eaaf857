"""Monitoring of measurements against commands: samples, joints, motors, battery, bumpers, buttons."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from math import isnan

import numpy as np

from pepper_driver.backends import Command, Measurement
from pepper_driver.config import RobotConfig, SafetySettings
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import kernel
from pepper_driver.safety.states import Fault, FaultReason

NAMED = 3
"""Joints and wheels that a message names, at most."""

# What a measurement shows of the joints: flags, or that it does not have these joints.
FAR, SOFT, OTHER_JOINTS = 1, 2, -1


@kernel
def compare_joints(
    position: FloatArray,
    stiffness: FloatArray,
    answered_position: FloatArray,
    answered_stiffness: FloatArray,
    newest_stiffness: FloatArray,
    near: float,
    stiffness_loss: float,
) -> int:
    """Compare measured joints with commands: FAR unless together no further than ``near``, SOFT if any is softer.

    Args:
        position: (n,) measured [rad]; NaN is far.
        stiffness: (n,) at the motor boards, never soft where it is unknown: NaN.
        answered_position: (n,) of the command that the sample answers [rad].
        answered_stiffness: (n,) of the same.
        newest_stiffness: (n,) of the last command.
        near: Largest sum of the squared distances [rad2].
        stiffness_loss: Below the commands a joint may be this soft.
    """
    n = len(position)
    if len(stiffness) != n or len(answered_position) != n:
        return OTHER_JOINTS
    if len(answered_stiffness) != n or len(newest_stiffness) != n:
        return OTHER_JOINTS
    squares, seen = 0.0, 0
    for j in range(n):
        distance = answered_position[j] - position[j]
        squares += distance * distance
        if stiffness[j] < min(answered_stiffness[j], newest_stiffness[j]) - stiffness_loss:
            seen = SOFT
    return seen if squares <= near else seen | FAR


class MotorMonitor:
    """Compares the stiffness at the motor boards with the sent one, and detects joints whose sensor is frozen.

    Args:
        robot: Its description.
        settings: Of the gate.

    Attributes:
        lowered: Samples in a row in which some joint was too soft.
    """

    def __init__(self, robot: RobotConfig, settings: SafetySettings) -> None:
        self._names = robot.joint_names
        self._settings = settings
        self._lowered_ticks = round(settings.stiffness_time / robot.cycle)
        self._silent_ticks = round(settings.frozen_time / robot.cycle)
        # A hand stands still around what it holds, far from where it was to close.
        self._judged = np.array([name not in robot.hands.joints for name in robot.joint_names])
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self.lowered = 0
        self._silent = np.zeros(len(self._names), dtype=np.int64)
        self._last: Measurement | None = None
        self._begun = np.zeros(len(self._names))

    def forget_silence(self) -> None:
        """Begin again: all joints are near their commands, and may have moved unseen."""
        if self._last is not None:
            self._silent[:] = 0
            self._last = None

    def stiffness(
        self, measurement: Measurement, answered: Command, newest: Command, soft: bool
    ) -> Fault | None:
        """Return a fault if joints are ``soft``, more so than any command that may have arrived: another program acts.

        Positions are sent for later than stiffness is, so the boards may be at any command from the one that the sample
        answers up to the newest. Between these the gate's own ramp is monotonic.
        """
        measured = measurement.stiffness
        if measured is None:
            return None
        self.lowered = self.lowered + 1 if soft else 0
        if self.lowered <= self._lowered_ticks:
            return None
        sent = np.minimum(answered.stiffness, newest.stiffness)
        less = measured < sent - self._settings.stiffness_loss
        text = (
            f"the stiffness of {self._listed(less)} was lowered from outside ({measured[less].min():.2f} in place of "
            f"{sent[less].max():.2f}): the robot fell asleep or was sent to rest (button on the chest, heat, a fall, "
            "ALMotion.rest), or another program lowered it (setStiffnesses); end that program, wake the robot up, then "
            "start again"
        )
        return Fault(reason=FaultReason.STIFFNESS, text=text)

    def foreign(self, measurement: Measurement) -> Fault:
        """Return the fault of joints or wheels that another program commands, as the backend sees."""
        names = measurement.commanded_by_others
        text = (
            f"another program commands {_list(names)}: end it, or what moves the robot by itself (autonomous life, "
            "basic awareness, animated speech, Choregraphe), then start again"
        )
        return Fault(reason=FaultReason.FOREIGN_COMMAND, text=text)

    def silent(
        self, measurement: Measurement, answered: Command, distance: FloatArray
    ) -> Fault | None:
        """Return the fault of a joint, (17,) ``distance`` from its command [rad], whose encoder is frozen.

        At rest an encoder may stand for minutes, and so may the current of a motor that holds a load, where it trembles
        by less than a count. A motor that is far from its command has another current for each command. Only samples in
        which some other current changed are new ones.
        """
        last, command = self._last, answered.position
        self._last = measurement
        if last is None:
            self._begun = command
            return None
        stands = measurement.current == last.current
        if np.count_nonzero(stands) == len(stands):
            return None  # the same sample once more
        far = np.abs(distance) > self._settings.frozen_distance
        should = far & self._judged & (answered.stiffness > self._settings.min_driven_stiffness)
        stands &= should & (measurement.position == last.position)
        # Where the command was when the joint began to stand.
        self._begun = np.where(stands, self._begun, command)
        moved = np.abs(command - self._begun) > self._settings.frozen_motion
        self._silent = np.where(stands & moved, self._silent + 1, 0)
        worst = int(self._silent.argmax())
        if self._silent[worst] <= self._silent_ticks:
            return None
        text = (
            f"{self._names[worst]} does not answer: {np.degrees(abs(distance[worst])):.0f} deg from its command, and "
            "neither its position nor its current changes as its command moves; its board is off or unplugged: restart "
            "the robot, or have it repaired"
        )
        return Fault(reason=FaultReason.FROZEN_JOINT, text=text)

    def _listed(self, joints: BoolArray) -> str:
        names = [self._names[index] for index in np.flatnonzero(joints).tolist()]
        return "all joints" if len(names) == len(self._names) else _list(names)


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}"


logger = logging.getLogger("pepper_driver")


class MeasurementMonitor:
    """Compares each measurement with the command it answers.

    Args:
        robot: Its description.
        settings: Of the gate.
    """

    def __init__(self, robot: RobotConfig, settings: SafetySettings) -> None:
        self._names = robot.joint_names
        self._settings = settings
        self._divergence_ticks = round(settings.following_error_time / robot.cycle)
        # Together no further than one alone may be: by far the usual case.
        self._near = min(settings.following_error, settings.frozen_distance) ** 2
        self._compare = compare_joints.load()
        self._motors = MotorMonitor(robot, settings)
        self._check_ticks = round(settings.check_period / robot.cycle)
        self._unknown = np.full(len(self._names), np.nan)
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._diverging = np.zeros(len(self._names), dtype=np.int64)
        self._far = False
        self._motors.reset()
        self._until_check = 1
        self._hot, self._low = np.zeros(len(self._names), dtype=np.int64), 0
        self._warned: set[str] = set()

    def check(self, measurement: Measurement, answered: Command, newest: Command) -> Fault | None:
        """Return the fault of a measurement, or of the robot that it shows; None when the run may continue.

        Args:
            measurement: The newest.
            answered: The command whose effect it shows.
            newest: The last one that was sent.
        """
        settings, motors, stiffness = self._settings, self._motors, measurement.stiffness
        if not measurement.age <= settings.stale_fault:  # NaN is old too
            why = f": {measurement.stale_reason}" if measurement.stale_reason else ""
            text = f"the newest sample is {measurement.age * 1e3:.0f} ms old{why}"
            return Fault(reason=FaultReason.STALE_SAMPLE, text=text)
        if any(measurement.buttons.tolist()) and settings.chest_button:
            fault = self._button(measurement)
            if fault is not None:
                return fault
        try:
            seen = self._compare(
                measurement.position,
                self._unknown if stiffness is None else stiffness,
                answered.position,
                answered.stiffness,
                newest.stiffness,
                self._near,
                settings.stiffness_loss,
            )
        except TypeError:  # of the kernel: not the arrays that it takes
            return self.check(_converted(measurement), answered, newest)
        if seen or self._far or motors.lowered or measurement.commanded_by_others:
            fault = self._judge(measurement, answered, newest, seen)
            if fault is not None:
                return fault
        if not (seen & FAR or self._far):
            motors.forget_silence()
        self._until_check -= 1
        if self._until_check <= 0:
            self._until_check = self._check_ticks
            return self._check(measurement)
        return None

    def _judge(
        self, measurement: Measurement, answered: Command, newest: Command, seen: int
    ) -> Fault | None:
        """Return the fault of joints that are not where, or as stiff as, they should be."""
        if seen == OTHER_JOINTS:
            raise ValueError(f"a measurement does not have {len(self._names)} joints")
        fault = self._motors.stiffness(measurement, answered, newest, bool(seen & SOFT))
        if fault is not None:
            return fault
        if measurement.commanded_by_others:
            return self._motors.foreign(measurement)
        if not (seen & FAR or self._far):
            return None
        distance = answered.position - measurement.position
        return self._motors.silent(measurement, answered, distance) or self._divergence(
            measurement, answered, distance
        )

    def _button(self, measurement: Measurement) -> Fault | None:
        pressed = measurement.buttons
        if np.isnan(pressed).any():
            return Fault(reason=FaultReason.SENSOR, text="the chest button cannot be read")
        if (pressed > 0.5).any():
            return Fault(
                reason=FaultReason.CHEST_BUTTON, text="a person pressed the button on the chest"
            )
        return None

    def _divergence(
        self, measurement: Measurement, answered: Command, distance: FloatArray
    ) -> Fault | None:
        distance = np.abs(distance)
        if not np.isfinite(distance).all():
            text = f"the position of {self._broken(measurement)} is not a number"
            return Fault(reason=FaultReason.SENSOR, text=text)
        far = (distance > self._settings.following_error) & (
            answered.stiffness > self._settings.min_driven_stiffness
        )
        self._diverging = np.where(far, self._diverging + 1, 0)
        self._far = bool(far.any())
        worst = int(self._diverging.argmax())
        if self._diverging[worst] <= self._divergence_ticks:
            return None
        text = f"{self._names[worst]} stays {np.degrees(distance[worst]):.0f} deg from its command"
        return Fault(reason=FaultReason.FOLLOWING_ERROR, text=text)

    def _check(self, measurement: Measurement) -> Fault | None:
        """At what changes slowly. What cannot be read is not judged: no robot is hot for lack of a thermometer."""
        settings = self._settings
        temperature, charge = measurement.temperature, measurement.battery
        for index in np.flatnonzero(temperature >= settings.temperature_warning).tolist():
            name = self._names[index]
            self._warn(
                name,
                f"the motor of {name} has {temperature[index]:.0f} deg C: "
                f"the robot is stopped at {settings.temperature_fault:.0f}",
            )
        hot = temperature >= settings.temperature_fault
        self._hot = np.where(hot, self._hot + 1, 0)
        if self._hot.max() >= self._settings.confirmations:
            index = int(self._hot.argmax())
            text = f"the motor of {self._names[index]} has {temperature[index]:.0f} deg C"
            return Fault(reason=FaultReason.TEMPERATURE, text=text)
        text = f"the battery is at {charge:.0%}"
        if charge < settings.battery_warning:
            self._warn("battery", f"{text}: the robot is stopped at {settings.battery_fault:.0%}")
        self._low = self._low + 1 if charge < settings.battery_fault else 0
        if self._low >= self._settings.confirmations:
            return Fault(reason=FaultReason.BATTERY, text=text)
        if isnan(charge):
            self._warn("charge", "the charge of the battery cannot be read: nothing watches it")
        unknown = np.isnan(temperature)
        if unknown.any():
            names = ", ".join(self._names[index] for index in np.flatnonzero(unknown).tolist())
            self._warn("temperature", f"the temperature of {names} is unknown and not monitored")
        return None

    def _broken(self, measurement: Measurement) -> str:
        return self._names[int(np.argmin(np.isfinite(measurement.position)))]

    def _warn(self, key: str, text: str) -> None:
        """Once for each motor and the battery."""
        if key not in self._warned:
            self._warned.add(key)
            logger.warning("%s", text)


def _converted(measurement: Measurement) -> Measurement:
    """Return a measurement with positions and stiffness as kernels take them."""
    position, stiffness = measurement.position, measurement.stiffness
    return replace(
        measurement,
        position=np.array(position, dtype=np.float64, order="C"),
        stiffness=None if stiffness is None else np.array(stiffness, dtype=np.float64, order="C"),
    )
