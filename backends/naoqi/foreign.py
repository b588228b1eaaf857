"""Other programs that command joints or wheels meanwhile: the DCM has no lock, and takes the orders of all.

Two signs. The commands of the DCM to the motors are read back, and compared with those sent to it. And ALMotion,
through which most programs move a robot, reports its joint targets and whether it drives: our commands may override its
own in every cycle, and the robot then jerks once we end. ALMotion does not see commands to the DCM (NAOqi 2.5 page
"ALMotion advanced"); a joint without stiffness it takes to be where it is measured.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from pepper_driver.backends.naoqi.connection import Call, Connection, MissingServiceError
from pepper_driver.backends.naoqi.timing import CommandHistory
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.naoqi import ForeignCommandSettings

MEASURED_TICKS = 6
"""In which a joint without stiffness was where ALMotion says that it lies: both are sampled at different moments."""

SETTLING_CHECKS = 3
"""Checks in which ALMotion comes to rest after its tasks were ended."""


class ForeignCommands:
    """Detects them, in checks of some ticks each.

    Args:
        robot: Names joints and wheels.
        settings: What counts.
        positions: Ours, of joints.
        speeds: Ours, of wheels.
        connection: With the robot.
        clock: Time between warnings.

    Attributes:
        found: Joints and wheels that others commanded in the last two checks, by name.
    """

    def __init__(
        self,
        robot: RobotConfig,
        settings: ForeignCommandSettings,
        positions: CommandHistory,
        speeds: CommandHistory,
        connection: Connection,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.found: tuple[str, ...] = ()
        self._names = (*robot.joint_names, *robot.wheels.names)
        self._joints = len(robot.joint_names)
        self._settings = settings
        self._positions, self._speeds = positions, speeds
        self._check_ticks = round(settings.check_time / robot.cycle)
        self._ticks = self._checks = 0
        self._seen = np.zeros(len(self._names), dtype=np.bool_)
        self._seen_before = self._seen
        self._joint_names = list(robot.joint_names)
        self._measured: deque[FloatArray] = deque(maxlen=MEASURED_TICKS)
        self._targets: FloatArray | None = None
        self._angles: Call | None = None
        self._drives: Call | None = None
        try:
            motion = connection.service("ALMotion")
        # Only the read-back of the DCM is then left.
        except MissingServiceError:
            return
        self._angles = Call(motion, "getAngles", connection.address.uri, clock=clock)
        self._drives = Call(motion, "moveIsActive", connection.address.uri, clock=clock)

    def read_back(self, commanded: FloatArray, date: int) -> None:
        """Compare the DCM's commands to joints and wheels with those sent to it.

        Args:
            commanded: (20,) its commands [rad], [rad/s]; NaN where unknown.
            date: Of the cycle in which it did [ms].
        """
        settings, joints = self._settings, self._joints
        bounds = self._positions.bounds(date)
        if bounds is not None:
            off = _outside(commanded[:joints], *bounds)
            self._seen[:joints] |= off > settings.joint_tolerance
        bounds = self._speeds.bounds(date)
        if bounds is not None:
            # Without a command in time the DCM stops the wheels.
            lower, upper = np.minimum(bounds[0], 0.0), np.maximum(bounds[1], 0.0)
            off = _outside(commanded[joints:], lower, upper)
            self._seen[joints:] |= off > settings.wheel_tolerance

    def tick(self, position: FloatArray) -> None:
        """Ask ALMotion, read its replies, and end a check when it is complete; never waits.

        Args:
            position: (17,) where the joints are measured [rad].
        """
        self._measured.append(position)
        self._ask_almotion()
        self._ticks += 1
        if self._ticks >= self._check_ticks:
            # Two checks in a row: a single odd value must not stop the robot.
            both = self._seen & self._seen_before
            self.found = tuple(self._names[place] for place in np.flatnonzero(both).tolist())
            self._seen_before, self._seen = self._seen, np.zeros_like(self._seen)
            self._ticks = 0
            self._checks += 1

    def _ask_almotion(self) -> None:
        angles, drives = self._angles, self._drives
        if angles is None or drives is None:
            return
        if (answer := angles.answer()) is not None:
            self._compare_targets(answer)
        if drives.answer() is True:
            self._seen[self._joints :] = True
        if self._ticks == 0:
            angles.begin(self._joint_names, False)
        elif self._ticks == self._check_ticks // 2:
            drives.begin()

    def _compare_targets(self, answer: object) -> None:
        """Compare ALMotion's joint targets with its first ones, and with the joints."""
        try:
            targets = np.array(answer, dtype=np.float64)
        except (TypeError, ValueError):
            return
        if targets.shape != (self._joints,):
            return
        if self._targets is None or self._checks < SETTLING_CHECKS:
            self._targets = targets
        tolerance = self._settings.joint_tolerance
        measured = np.array(self._measured)
        lies = _outside(targets, measured.min(axis=0), measured.max(axis=0)) <= tolerance
        # ALMotion's targets of joints without stiffness follow the measurement, also when a person moves them.
        self._targets = np.where(lies, targets, self._targets)
        self._seen[: self._joints] |= np.abs(targets - self._targets) > tolerance


def _outside(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return by how much values lie outside of bounds; NaN where they are."""
    return np.maximum(lower - values, values - upper)
