"""Whether motors do as they were told: none was made soft or commanded by others, and none has stopped answering."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.backends import Command, Measurement
from pepper_driver.config import RobotConfig, SafetySettings
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.safety.states import Fault, FaultReason

FULL_STIFFNESS = 0.5
"""Of a joint below it, no one expects that it follows its command."""

NAMED = 3
"""Joints and wheels that a message names, at most."""


class MotorWatch:
    """Compares the stiffness that boards are told with what was sent, and looks for joints of which nothing changes.

    Args:
        robot: Its description.
        settings: Of the gate.
    """

    def __init__(self, robot: RobotConfig, settings: SafetySettings) -> None:
        self._names = robot.joint_names
        self._settings = settings
        self._taken_ticks = round(settings.stiffness_time / robot.cycle)
        self._silent_ticks = round(settings.silent_time / robot.cycle)
        # A hand stands still around what it holds, far from where it was to close.
        self._judged = np.array([name not in robot.hands.joints for name in robot.joint_names])
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self._taken = 0
        self._silent = np.zeros(len(self._names), dtype=np.int64)
        self._last: Measurement | None = None

    def stiffness(
        self, measurement: Measurement, answered: Command, newest: Command
    ) -> Fault | None:
        """Whether somebody else made joints softer than any command did that may have got there by now.

        Positions are sent for later than stiffness is, so the boards may be at any command from the one that the sample
        answers up to the newest. Between these the gate's own ramp goes one way.
        """
        told = measurement.stiffness
        if told is None:
            return None
        wanted = np.minimum(answered.stiffness, newest.stiffness)
        less = told < wanted - self._settings.stiffness_taken  # never where nobody knows: NaN
        if not np.count_nonzero(less):
            self._taken = 0
            return None
        self._taken += 1
        if self._taken <= self._taken_ticks:
            return None
        text = (
            f"somebody took the stiffness of {self._listed(less)} away ({told[less].min():.2f} in place of "
            f"{wanted[less].max():.2f}): the robot fell asleep or was sent to rest (button on the chest, heat, a fall, "
            "ALMotion.rest), or another program lowered it (setStiffnesses); end that program, wake the robot up, then "
            "start again"
        )
        return Fault(reason=FaultReason.STIFFNESS, text=text)

    def foreign(self, measurement: Measurement) -> Fault | None:
        """Return the fault where the backend sees another program command joints or wheels."""
        names = measurement.commanded_by_others
        if not names:
            return None
        text = (
            f"another program commands {_list(names)}: end it, or what moves the robot by itself (autonomous life, "
            "basic awareness, animated speech, Choregraphe), then start again"
        )
        return Fault(reason=FaultReason.FOREIGN_COMMAND, text=text)

    def silent(
        self, measurement: Measurement, answered: Command, distance: FloatArray
    ) -> Fault | None:
        """Whether a joint, (17,) ``distance`` from its command [rad], should move and does not change by a count.

        At rest an encoder may stand for minutes. A motor that is far from its command has a current, which trembles,
        however firmly the joint is held. Only samples in which some other current changed are new ones.
        """
        last = self._last
        self._last = measurement
        if last is None:
            return None
        stands = measurement.current == last.current
        if np.count_nonzero(stands) == len(stands):
            return None  # the same sample once more
        far = np.abs(distance) > self._settings.silent
        should = far & self._judged & (answered.stiffness > FULL_STIFFNESS)
        stands &= should & (measurement.position == last.position)
        self._silent = np.where(stands, self._silent + 1, 0)
        worst = int(self._silent.argmax())
        if self._silent[worst] <= self._silent_ticks:
            return None
        text = (
            f"{self._names[worst]} does not answer: {np.degrees(abs(distance[worst])):.0f} deg from its command, and "
            "neither its position nor its current changes any more; its board is off or unplugged: restart the robot, "
            "or have it repaired"
        )
        return Fault(reason=FaultReason.SILENT_JOINT, text=text)

    def _listed(self, joints: BoolArray) -> str:
        names = [self._names[index] for index in np.flatnonzero(joints).tolist()]
        return "all joints" if len(names) == len(self._names) else _list(names)


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}"
