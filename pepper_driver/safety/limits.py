"""Limits that every command is kept within: of joints, and of the base and its wheels.

With s the step of a command from the one before it and A the largest change of that step (acceleration times cycle
squared), a joint that brakes takes the steps s - A, s - 2 A, ... to rest. Of the room D to its limit it needs

    T(s) = n s - A n (n - 1) / 2,   n = ceil(s / A),

so that the largest step it may take is, with n = ceil((sqrt(1 + 8 D / A) - 1) / 2),

    s(D) = D / n + A (n - 1) / 2.

After a step with T(s) <= D the next one can be s - A: T(s - A) = T(s) - s <= D - s. A command inside these limits
therefore always has a successor inside them, for any request.
"""

from __future__ import annotations

import logging
from math import sqrt

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.backends.readiness import PRESSED
from pepper_driver.config import RobotConfig, SafetySettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records

ANGLE_ROUNDING = 1e-9
"""[rad] A reference may lie this far beyond a limit: what rounding does."""


class JointLimit:
    """Limits of a joint, and its last command.

    Attributes:
        lower: Limit of its position [rad].
        upper: The other one [rad].
        max_step: Of the position, from one command to the next [rad].
        max_change: Of such a step, from one command to the next [rad]: A.
        stiffness_step: Largest of the stiffness, from one command to the next.
        position: Of the last command [rad].
        step: From the command before to the last one [rad].
        limited: Whether the last command is not the requested one.
        stiffness: Of the last command, 0..1.
    """

    lower: float
    upper: float
    max_step: float
    max_change: float
    stiffness_step: float
    position: float
    step: float
    limited: bool
    stiffness: float


def joint_limits(
    lower: FloatArray,
    upper: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    stiffness_ramp: float,
    cycle: float,
) -> Records[JointLimit]:
    """Return the limits of n joints.

    Args:
        lower: (n,) limits of the position [rad].
        upper: (n,) the same.
        speed: (n,) limits [rad/s].
        acceleration: (n,) limits [rad/s2].
        stiffness_ramp: Time for the stiffness from 0 to 1 [s].
        cycle: Time between two commands [s].
    """
    return make_records(
        JointLimit,
        len(lower),
        lower=lower,
        upper=upper,
        max_step=speed * cycle,
        max_change=acceleration * cycle**2,
        stiffness_step=cycle / stiffness_ramp,
    )


@kernel
def braking_step(room: float, change: float) -> float:
    """Return the largest step towards a limit ``room`` away from which a joint can still stop: s(D)."""
    n = max(np.ceil((sqrt(1.0 + 8.0 * room / change) - 1.0) / 2.0), 1.0)
    step: float = room / n + change * (n - 1.0) / 2.0
    return step


@kernel
def limit_joints(
    joints: Out[Records[JointLimit]], requested: FloatArray, brake: bool, position: Out[FloatArray]
) -> bool:
    """Move each joint as near to its requested position as its limits allow; return whether any is limited.

    Args:
        joints: (n,) limits and last commands, within the limits.
        requested: (n,) finite positions [rad].
        brake: Come to rest instead.
        position: (n,) of the command [rad].
    """
    limited = False
    for j in range(len(joints)):
        joint = joints[j]
        before, change = joint.position, joint.max_change
        goal = before if brake else requested[j]
        step = goal - before
        low = max(joint.step - change, -joint.max_step)
        high = min(joint.step + change, joint.max_step)
        # Position counts most: it is the last to be asked.
        high = min(high, braking_step(joint.upper - before, change))
        low = max(low, -braking_step(before - joint.lower, change))
        beyond = step > high + ANGLE_ROUNDING or step < low - ANGLE_ROUNDING
        sent = before + min(max(step, low), high) if beyond else goal
        joint.position = min(max(sent, joint.lower), joint.upper)
        joint.limited = joint.position != requested[j] if brake else beyond
        joint.step = joint.position - before
        limited |= joint.limited
        position[j] = joint.position
    return limited


@kernel
def ramp_stiffness(joints: Out[Records[JointLimit]], requested: FloatArray) -> bool:
    """Change the stiffness of each joint towards a requested one, within 0..1; return whether any changes."""
    changed = False
    for j in range(len(joints)):
        joint = joints[j]
        before, step = joint.stiffness, joint.stiffness_step
        ramped = min(max(requested[j], before - step), before + step)
        joint.stiffness = min(max(ramped, 0.0), 1.0)
        changed |= joint.stiffness != before
    return changed


logger = logging.getLogger("pepper_driver")

SPEED_ROUNDING = 1e-6
"""[rad/s] Wheels may be so much too fast: what the controller's solver rounds to."""


class WheelLimit:
    """Limit of a wheel, and its last command.

    Attributes:
        speed_limit: [rad/s].
        max_change: Of its speed, from one command to the next [rad/s].
        speed: The last one [rad/s].
        target: Speed towards which it changes [rad/s].
    """

    speed_limit: float
    max_change: float
    speed: float
    target: float


@kernel
def limit_wheels(wheels: Out[Records[WheelLimit]], requested: FloatArray, stop: bool) -> bool:
    """Change the speeds of the wheels towards the requested ones; return whether these are not reached.

    Wheels too fast, or that change their speed too fast, are slowed by one factor: the base keeps its direction, or
    changes it in the requested direction.

    Args:
        wheels: (3,) limits and last speeds.
        requested: (3,) finite speeds [rad/s].
        stop: Stand at once instead.
    """
    fastest, too_fast = 0.0, False
    for w in range(len(wheels)):
        fastest = max(fastest, abs(requested[w]))
        too_fast |= abs(requested[w]) > wheels[w].speed_limit + SPEED_ROUNDING
    if stop:
        for w in range(len(wheels)):
            wheels[w].speed = 0.0
        return fastest > 0.0
    fraction = 1.0
    for w in range(len(wheels)):
        wheel = wheels[w]
        wheel.target = requested[w] / fastest * wheel.speed_limit if too_fast else requested[w]
        change = abs(wheel.target - wheel.speed)
        if change > wheel.max_change:
            fraction = min(fraction, wheel.max_change / change)
    for w in range(len(wheels)):
        wheel = wheels[w]
        if fraction < 1.0:
            wheel.speed += fraction * (wheel.target - wheel.speed)
        else:
            wheel.speed = wheel.target
    return too_fast or fraction < 1.0


class BaseGuard:
    """Stops the base while a bumper is pressed, some time beyond, and over an open charging flap.

    Args:
        robot: Its description.
        settings: Of the gate.

    Attributes:
        stopped: Human-readable reason why the base must stand; empty when it may roll.
        wheels: (3,) limits of the wheels.
    """

    def __init__(self, robot: RobotConfig, settings: SafetySettings) -> None:
        self._names = tuple(robot.sensors.bumpers)
        self._release_ticks = round(settings.bumper_release / robot.cycle)
        base = robot.limits.base
        linear, angular = base.linear_acceleration, base.angular_acceleration
        # The largest that the base's own limits ask of each wheel.
        acceleration = np.abs(robot.wheels.matrix) @ np.array([linear, linear, angular])
        max_change = settings.acceleration_margin * acceleration * robot.cycle
        self.wheels = make_records(
            WheelLimit, 3, speed_limit=robot.wheels.speed_limit, max_change=max_change
        )
        self._still = np.zeros(3)  # shared by many commands
        self._still.setflags(write=False)
        self.reset()

    def reset(self) -> None:
        """Start with a base that stands, and may roll."""
        self.stopped = ""
        self._wait = 0
        self.stop()

    def see(self, measurement: Measurement) -> None:
        """Take in bumpers and charging flap; a bumper that is not a number counts as pressed."""
        if any(measurement.bumpers.tolist()) or measurement.charging_flap > PRESSED:
            blocked = self._blocked(measurement)
            if blocked:
                if not self.stopped:
                    logger.warning("the base stands still: %s", blocked)
                self.stopped, self._wait = blocked, self._release_ticks
                return
        if self.stopped:
            self._wait -= 1
            if self._wait < 0:
                self.stopped = ""

    def _blocked(self, measurement: Measurement) -> str:
        reasons = [
            f"bumper {name} is pressed"
            for name, value in zip(self._names, measurement.bumpers.tolist(), strict=True)
            if not value <= PRESSED
        ]
        if measurement.charging_flap > PRESSED:
            reasons.append("the charging flap is open")
        return " and ".join(reasons)

    def stop(self) -> FloatArray:
        """Stand at once; returns (3,) zeros [rad/s]."""
        self.wheels["speed"] = 0.0
        return self._still
