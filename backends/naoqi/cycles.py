"""The DCM's cycles by number, which command is for which of them, and which of them a sample should be of."""

from __future__ import annotations

from collections import deque
from math import ceil

KEPT = 128
"""Commands remembered: beyond a second the gate has long stopped the robot."""

FOLLOW = 0.1
"""Share of a deviation by which the grid of cycles follows the dates of samples."""

PATIENCE = 25
"""Samples in a row that must all be late before lateness is taken for usual: 0.3 s."""


class Cycles:
    """Numbers of the DCM's cycles, by date; the first sample's is 0.

    Dates lie on a grid, which follows slowly where the robot's cycle is not exactly as long as documented.

    Args:
        length: Of a cycle [ms].
        first: Date of the first sample.
    """

    def __init__(self, length: float, first: int) -> None:
        self.length = length
        self._first = float(first)

    def number(self, date: float) -> int:
        """The cycle nearest to a date [ms]."""
        return round((date - self._first) / self.length)

    def date(self, number: int) -> int:
        """Date of a cycle [ms]."""
        return round(self._first + number * self.length)

    def since(self, date: float) -> float:
        """Time from the last cycle to a date [ms], 0 up to the length of a cycle."""
        return (date - self._first) % self.length

    def see(self, date: int) -> int:
        """The number of the cycle that a sample of this date is of."""
        number = self.number(date)
        self._first += FOLLOW * (date - self._first - number * self.length)
        return number


class Dating:
    """Gives each command the cycle at which it is to be reached: one cycle after that of the command before.

    So the DCM is at the commanded value exactly at a cycle, and samples answer whole commands. Where this computer's
    ticks and the robot's cycles run apart, or a tick was missed, the commands find their lead again by a jump.

    Args:
        cycles: Of the robot.
        lead: Least time from a tick to the date of its command [ms].
        delay: Cycles from the date of a command to the sample that shows it.
    """

    def __init__(self, cycles: Cycles, lead: float, delay: int) -> None:
        self._cycles, self._lead, self._delay = cycles, lead, delay
        self._number: int | None = None
        self._sent: deque[tuple[int, int]] = deque(maxlen=KEPT)

    def next(self, now: float) -> int | None:
        """The cycle for the command of a tick, which begins at the DCM's date ``now`` [ms].

        None where the commands have come to lie too far ahead: this one is left out, and the next one takes its place.
        """
        length, number = self._cycles.length, self._number
        if number is not None:
            lead = self._cycles.date(number + 1) - now
            if lead > self._lead + 2 * length:
                return None
            # A tick that begins late by less is followed by one in time.
            if lead >= self._lead - length / 4:
                self._number = number + 1
                return self._number
        # In the middle of what is allowed.
        begin = now + self._lead + length / 2
        nearest = self._cycles.number(begin)
        ahead = nearest + ceil((begin - self._cycles.date(nearest)) / length)
        self._number = ahead if number is None else max(ahead, number + 1)
        return self._number

    def sent(self, step: int, number: int) -> None:
        """The command of a step really went on its way, for this cycle."""
        self._sent.append((number, step))

    def refused(self, number: int) -> None:
        """The robot did not take the command for this cycle."""
        self._sent = deque((sent for sent in self._sent if sent[0] != number), maxlen=KEPT)

    def answers(self, step: int, sample: int) -> int | None:
        """How many steps before ``step`` the command was given that the sample of a cycle answers.

        None where no command is as old as that.
        """
        reached = sample - self._delay
        for number, then in reversed(self._sent):
            if number <= reached:
                return step - then
        return None


class Lateness:
    """How many cycles the newest sample is later than samples usually are.

    Every step expects the sample of the next cycle. A younger one moves what is expected on; where all are late for a
    while, that is what is usual.

    Args:
        length: Of a cycle [ms].
        newest: Cycle of the first sample.

    Attributes:
        expected: Cycle of which the sample should be now.
    """

    def __init__(self, length: float, newest: int) -> None:
        self._length = length
        self.expected = newest
        self._least, self._seen = PATIENCE, 0

    def step(self, elapsed: float, newest: int, age: float) -> int:
        """Cycles by which the newest sample is late, now.

        Args:
            elapsed: Time since the last step [ms].
            newest: Cycle of the newest sample.
            age: Time since that cycle [ms]; a sample cannot be later than that.
        """
        # A tick that begins late and one that then begins in time again are one each; a missed one counts.
        self.expected += max(1, int(elapsed / self._length + 0.25))
        late = min(self.expected - newest, int(age / self._length))
        if late <= 0:
            late, self._seen, self._least = 0, 0, PATIENCE
        else:
            self._seen += 1
            self._least = min(self._least, late)
            if self._seen >= PATIENCE:
                late -= self._least
                self._seen, self._least = 0, PATIENCE
        self.expected = newest + late
        return late
