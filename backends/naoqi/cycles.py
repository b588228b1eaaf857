"""The DCM's cycles by number, and which command is for which of them."""

from __future__ import annotations

from math import ceil

KEPT = 128
"""[cycles] for which commands are remembered: after a second the gate has long stopped the robot."""

FOLLOW = 0.1
"""Share of a deviation by which the grid of cycles follows the dates of samples."""


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
        self._given: dict[int, tuple[int, bool]] = {}

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
        self._number = nearest + ceil((begin - self._cycles.date(nearest)) / length)
        return self._number

    def given(self, step: int, number: int, *, sent: bool) -> None:
        """The command of a step was for this cycle, and was sent, or withheld."""
        self._given[number] = (step, sent)
        for old in list(self._given):
            if old > number - KEPT:
                break
            del self._given[old]

    def refused(self, number: int) -> None:
        """The robot did not take the command for this cycle."""
        if number in self._given:
            self._given[number] = (self._given[number][0], False)

    def answers(self, step: int, sample: int) -> int | None:
        """How many steps before ``step`` the command was given that the sample of a cycle answers.

        None where no command is as old as that. A single one that was not sent is answered all the same: the DCM goes
        in a straight line from the command before it to the one after.
        """
        reached = sample - self._delay
        between = self._was_sent(reached - 1) and self._was_sent(reached + 1)
        if reached in self._given and (self._was_sent(reached) or between):
            return step - self._given[reached][0]
        for number in reversed(self._given):
            if number <= reached and self._was_sent(number):
                return step - self._given[number][0]
        return None

    def _was_sent(self, number: int) -> bool:
        return self._given.get(number, (0, False))[1]
