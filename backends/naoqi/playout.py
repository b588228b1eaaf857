"""Which sample a tick gets: on a way that varies, samples come in bunches and with gaps."""

from __future__ import annotations

from collections import deque

from pepper_driver.backends.naoqi.keys import Values

LATER, SOONER = 25, 5
"""Ticks in a row with all samples late, or early, before that is taken for usual."""


class Playout:
    """Gives each tick the sample of its own cycle of the robot, or the last before it.

    Cycles go on by one a tick, as in a simulation: a sample that comes early waits for its tick, and one that does not
    come is missed, which the tick is told. Where all come early or late for some time, cycles are counted anew.

    Args:
        length: Of a cycle [ms].
        first: A sample, of cycle 0.

    Attributes:
        cycle: Of the tick.
        late: Cycles by which its sample is too old.
        sample: That sample.
    """

    def __init__(self, length: float, first: Values) -> None:
        self._length = length
        self.cycle = self.late = 0
        self.sample = first
        self._of = self._newest = 0
        self._waiting: deque[tuple[int, Values]] = deque()
        self._least_late = self._least_early = 0
        self._late_ticks = self._early_ticks = 0

    def add(self, cycle: int, sample: Values) -> None:
        """Take in a sample of a cycle, younger than all before."""
        self._newest = cycle
        self._waiting.append((cycle, sample))

    def step(self, elapsed: float, age: float) -> None:
        """Begin a tick.

        Args:
            elapsed: Time since the last one [ms].
            age: Time since the cycle of the newest sample [ms]: no tick can be of a cycle that is still to come.
        """
        # One that begins late and one that then begins in time again are one each; one that was missed counts.
        passed = max(1, int(elapsed / self._length + 0.25))
        latest = self._newest + int(age / self._length)
        self.cycle = max(self.cycle, min(self.cycle + passed, latest))
        self._count_anew()
        while self._waiting and self._waiting[0][0] <= self.cycle:
            self._of, self.sample = self._waiting.popleft()
        self.late = self.cycle - self._of

    def _count_anew(self) -> None:
        late = self.cycle - self._newest
        self._late_ticks, self._least_late = _lasting(late, self._late_ticks, self._least_late)
        self._early_ticks, self._least_early = _lasting(-late, self._early_ticks, self._least_early)
        if self._late_ticks == LATER:
            self.cycle -= self._least_late
            self._late_ticks = 0
        elif self._early_ticks == SOONER:
            self.cycle += self._least_early
            self._early_ticks = 0


def _lasting(size: int, ticks: int, least: int) -> tuple[int, int]:
    """For how many ticks something has been positive, and its least value in them."""
    if size <= 0:
        return 0, 0
    return ticks + 1, size if ticks == 0 else min(least, size)
