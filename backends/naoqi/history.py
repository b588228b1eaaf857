"""Commands that the DCM may be following: unless other programs command it, what it tells the motors lies between."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import inf

import numpy as np

from pepper_driver.config.arrays import FloatArray

KEPT = 128
"""Commands remembered: more than a second of them."""


@dataclass(kw_only=True, slots=True, eq=False)
class SentCommand:
    """A command (n,) that is to be reached at ``date``.

    Dates are of the DCM [ms]: ``sent`` is when it was sent, ``taken`` when its acknowledgement was seen, infinite where
    there was none, or the robot refused it.
    """

    values: FloatArray
    date: int
    sent: float
    taken: float = inf


class CommandHistory:
    """Commands for one group of actuators, in the order in which they were sent.

    The DCM goes in a straight line from the command that it reached last to the next one that it has. So its value lies
    within those from the last one that it surely reached up to the newest that may have come, whatever is late, left
    out or refused.

    Args:
        cycle: Of the DCM [ms]; dates are trusted to that.
    """

    def __init__(self, cycle: float) -> None:
        self._cycle = cycle
        self._commands: deque[SentCommand] = deque(maxlen=KEPT)

    def add(self, command: SentCommand) -> None:
        """Take in a command that was sent."""
        self._commands.append(command)

    def bounds(self, date: float) -> tuple[FloatArray, FloatArray] | None:
        """Return the least and the largest values (n,) that the DCM may have at a cycle of this date [ms].

        None where it may still be following what others told it before. Dates must not go back.
        """
        sure = date - self._cycle
        reached = None
        for place, command in enumerate(self._commands):
            if command.date <= sure and command.taken <= sure:
                reached = place
        if reached is None:
            return None
        for _ in range(reached):
            self._commands.popleft()
        under_way = np.array([c.values for c in self._commands if c.sent <= date + self._cycle])
        return under_way.min(axis=0), under_way.max(axis=0)
