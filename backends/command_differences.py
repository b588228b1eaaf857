"""Commands of a program beside those of a recording."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends.fields import Command, fields_of
from pepper_driver.config import RobotConfig


class CommandDifferences:
    """Differences between the commands of a program and those of a recording, bit by bit.

    Args:
        robot: Names joints and wheels.

    Attributes:
        compared: How many commands were compared.
        differing: How many of them are not the same.
        first: The first one that is not: time of the sample that answers it [s], and how, for people; None if all are.
        largest: Largest size of a difference, by part of the command: ``position`` [rad], ``stiffness``,
            ``wheel_speed`` [rad/s].
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._names = {field.attribute: field.elements(robot) or () for field in fields_of("sent")}
        self.compared = self.differing = 0
        self.first: tuple[float, str] | None = None
        self.largest = dict.fromkeys(self._names, 0.0)

    def compare(self, time: float, given: Command, recorded: Command) -> None:
        """Take in the two commands of one cycle, those that the sample of ``time`` [s] answers."""
        self.compared += 1
        same = True
        for part, names in self._names.items():
            a, b = np.asarray(getattr(given, part)), getattr(recorded, part)
            if a.tobytes() == b.tobytes():
                continue
            size = np.abs(a - b)
            place = int(size.argmax())
            self.largest[part] = max(self.largest[part], float(size[place]))
            if self.first is None:
                text = f"{part} of {names[place]}: {a[place]!s} in place of {b[place]!s}"
                self.first = (time, text)
            same = False
        self.differing += not same
