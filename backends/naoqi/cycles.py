"""The DCM's cycles by number, and which command is for which of them."""

from __future__ import annotations

from math import ceil

KEPT = 128
"""[cycles] for which commands are remembered: after a second the gate has long stopped the robot."""

FOLLOW = 0.1
"""Share of a deviation by which the grid of cycles follows the dates of samples."""

RECOVERY_COMMANDS = 400
"""Commands in a row that could all have been for the cycle before, until one is left out: five seconds."""


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


class CommandScheduler:
    """Gives each command the cycle at which it is to be reached: one cycle after that of the command before.

    So the DCM is at the commanded value exactly at a cycle, and samples answer whole commands. The first command gets
    the earliest cycle that the lead time allows. One that would come too late for its cycle gets a later one, and so do
    all after it. Once there has been a cycle to spare for long, a command is left out.

    Args:
        cycles: Of the robot.
        lead: Least time from a command to its date [ms].
        delay: Cycles from the date of a command to the sample that shows it.
    """

    def __init__(self, cycles: Cycles, lead: float, delay: int) -> None:
        self._cycles, self._lead, self._delay = cycles, lead, delay
        self._number: int | None = None
        self._spare = 0
        self._given: dict[int, tuple[int, bool]] = {}

    def next(self, now: float) -> int | None:
        """Return the cycle for a command that is sent at the DCM's date ``now`` [ms].

        None where it is left out, and the next one takes its place: the commands lie too far ahead, or could all have
        been for the cycle before for some time.
        """
        length, number = self._cycles.length, self._number
        if number is not None:
            lead = self._cycles.date(number + 1) - now
            self._spare = self._spare + 1 if lead - length >= self._lead else 0
            if lead > self._lead + 2 * length or self._spare == RECOVERY_COMMANDS:
                self._spare = 0
                return None
            # A command that is late by less is followed by one in time.
            if lead >= self._lead - length / 4:
                self._number = number + 1
                return self._number
        self._spare = 0
        earliest = now + self._lead
        nearest = self._cycles.number(earliest)
        self._number = nearest + ceil((earliest - self._cycles.date(nearest)) / length)
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
        """Return how many commands before ``step`` the one was given that the sample of a cycle answers.

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
