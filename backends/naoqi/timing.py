"""Times: clock and cycles of the DCM, lead time of commands, jitter buffer, pairing of samples and commands.

The DCM counts milliseconds in 32 bits with a sign (NAOqi 2.5.10, page "DCM": "can roll-over"). Dates here are whole
counts that do not roll over; only what is sent to the robot, and what it shows, does.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf
from typing import Self

import numpy as np

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.memory_keys import Values
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.naoqi import TimingSettings

SPAN = 1 << 32
"""[ms] after which the robot's clock shows the same again."""

DRIFT = 100e-6
"""Two clocks of ordinary quartz run apart by this much at most."""

KEPT_REPLIES = 8
"""Answers kept: with one a second, the best of the last seconds."""


def shown(date: int) -> int:
    """Return a date as the robot's clock shows it: -2^31 to 2^31 - 1."""
    return (date + SPAN // 2) % SPAN - SPAN // 2


def dated(shown_: int, near: float) -> int:
    """Return the date nearest to ``near`` that the robot's clock shows as ``shown_``."""
    base = round(near)
    # The difference wraps at 2^32 ms, so a roll-over between the two has no consequence.
    return base + shown(shown_ - base)


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeReply:
    """An answer to "what time is it", with when it was asked for and received by this computer's clock [ns]."""

    asked: int
    received: int
    shown: int

    @property
    def round_trip(self) -> float:
        """[ms] from the question to the answer."""
        return (self.received - self.asked) * 1e-6


class DcmClockEstimate:
    """This computer's clock and the DCM's, side by side.

    The robot read its clock at some time between question and answer: the shorter that was, the better. An answer
    gets worse as it grows old, since the clocks run apart. The best of the last few counts.

    Args:
        first: The first answer; the date of the robot's clock then is what it shows.
    """

    def __init__(self, first: TimeReply) -> None:
        self._replies: deque[tuple[TimeReply, float]] = deque(maxlen=KEPT_REPLIES)
        self._offset = first.shown + 0.5 - _middle(first)
        self.add(first)

    def add(self, reply: TimeReply) -> None:
        """Take in one more answer, the newest."""
        middle = _middle(reply)
        # It shows whole milliseconds, rounded down.
        date = dated(reply.shown, middle + self._offset) + 0.5
        self._replies.append((reply, date - middle))
        now = reply.received * 1e-6

        def doubt(known: tuple[TimeReply, float]) -> float:
            # The robot may have read its clock at either end of the round trip.
            return known[0].round_trip / 2 + DRIFT * (now - known[0].received * 1e-6)

        self._offset = min(self._replies, key=doubt)[1]

    def now(self, here: int) -> float:
        """Return the DCM's date [ms] when this computer's clock shows ``here`` [ns]."""
        return here * 1e-6 + self._offset

    def date(self, shown_: int, here: int) -> int:
        """Return the date near ``here`` [ns of this computer's clock] that the robot's clock shows as ``shown_``."""
        return dated(shown_, self.now(here))


def _middle(reply: TimeReply) -> float:
    # [ms]; half of the round trip is assumed for each direction.
    return (reply.asked + reply.received) * 0.5e-6


KEPT_CYCLES = 128
"""[cycles] for which commands are remembered: after a second the gate has long stopped the robot."""

GRID_FILTER_GAIN = 0.1
"""Fraction of a deviation by which the grid of cycles follows the times of samples."""

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
        """Return the cycle nearest to a date [ms]."""
        return round((date - self._first) / self.length)

    def date(self, number: int) -> int:
        """Date of a cycle [ms]."""
        return round(self._first + number * self.length)

    def since(self, date: float) -> float:
        """Time from the last cycle to a date [ms], 0 up to the length of a cycle."""
        return (date - self._first) % self.length

    def see(self, date: int) -> int:
        """Return the number of the cycle that a sample of this date is of."""
        number = self.number(date)
        self._first += GRID_FILTER_GAIN * (date - self._first - number * self.length)
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
        self._commands_by_cycle: dict[int, tuple[int, bool]] = {}

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

    def note_command(self, step: int, number: int, *, sent: bool) -> None:
        """Record that the command of a step was for this cycle, and was sent, or dropped."""
        self._commands_by_cycle[number] = (step, sent)
        # Cycles ascend in the order of insertion, so the first one is the oldest.
        while (oldest := next(iter(self._commands_by_cycle))) <= number - KEPT_CYCLES:
            del self._commands_by_cycle[oldest]

    def refused(self, number: int) -> None:
        """Record that the robot did not take the command for this cycle."""
        if number in self._commands_by_cycle:
            self._commands_by_cycle[number] = (self._commands_by_cycle[number][0], False)

    def answers(self, step: int, sample: int) -> int | None:
        """Return how many commands before ``step`` the one was given that the sample of a cycle answers.

        None where no command is as old as that. A single one that was not sent is answered all the same: the DCM goes
        in a straight line from the command before it to the one after.
        """
        reached = sample - self._delay
        between = self._was_sent(reached - 1) and self._was_sent(reached + 1)
        if reached in self._commands_by_cycle and (self._was_sent(reached) or between):
            # The number of commands, not of cycles: one may have been left out between the two.
            return step - self._commands_by_cycle[reached][0]
        for number in reversed(self._commands_by_cycle):
            if number <= reached and self._was_sent(number):
                return step - self._commands_by_cycle[number][0]
        return None

    def _was_sent(self, number: int) -> bool:
        return self._commands_by_cycle.get(number, (0, False))[1]


MIN_CALLS = 20
"""Of a burst: fewer say nothing about the slowest in a hundred."""

MAX_BURST = 3.0
"""[s] for them, on the slowest of links."""

ATTEMPTS = 3
"""Bursts before a connection is refused: one of them may have met a disturbance."""

CURE = (
    "connect the robot by cable, or move it nearer to the access point and end other traffic; "
    "else move it through ALMotion, slower, by ?mode=angles"
)


class SlowLinkError(BackendError):
    """The latency of the connection is too long, or varies too much, for control in every cycle."""


@dataclass(frozen=True, kw_only=True)
class RoundTrips:
    """Round trips of calls to the robot [s]."""

    calls: int
    median: float
    p95: float
    p99: float
    jitter: float

    @classmethod
    def of(cls, replies: Sequence[TimeReply]) -> Self:
        """Compute them from answers; ``jitter`` is the time of the slowest in a hundred beyond that of the quickest.

        The quickest and this one together bound the jitter of one direction. The very slowest call shows other activity
        of the two computers rather than the connection.
        """
        times = np.array([reply.round_trip for reply in replies]) * 1e-3
        least, median, p95, p99 = np.percentile(times, [0, 50, 95, 99]).tolist()
        return cls(calls=len(times), median=median, p95=p95, p99=p99, jitter=p99 - least)

    def lead(self, settings: TimingSettings) -> float:
        """[s] from sending a command to its date, so that it arrives before."""
        return max(self.jitter + settings.lead_margin, settings.min_lead_time)


def burst(ask: Callable[[], int], seconds: float, clock: Callable[[], int]) -> list[TimeReply]:
    """Ask for the time over and over.

    Args:
        ask: Asks the robot for its time [ms], and waits for the answer.
        seconds: For how long; longer where the link is so slow that too few calls would come about.
        clock: Monotonic [ns].
    """
    replies: list[TimeReply] = []
    begin = clock()
    while True:
        asked = clock()
        answer = ask()
        replies.append(TimeReply(asked=asked, received=clock(), shown=answer))
        spent = (replies[-1].received - begin) * 1e-9
        if spent >= MAX_BURST or (spent >= seconds and len(replies) >= MIN_CALLS):
            return replies


def measure(
    ask: Callable[[], int],
    settings: TimingSettings,
    uri: str,
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> tuple[RoundTrips, list[TimeReply]]:
    """Measure the latency of the connection, and read the robot's clock.

    Args:
        ask: Asks the robot for its time [ms], and waits for the answer.
        settings: Limits that are tolerated.
        uri: For the message.
        clock: Monotonic [ns].

    Raises:
        SlowLinkError: It does not allow control in every cycle.
    """
    for _ in range(ATTEMPTS):
        replies = burst(ask, settings.burst, clock)
        trips = RoundTrips.of(replies)
        lead = trips.lead(settings)
        if trips.p99 <= settings.max_round_trip and lead <= settings.max_lead_time:
            return trips, replies
    slow = trips.p99 > settings.max_round_trip
    what = (
        f"one call in a hundred takes {1e3 * trips.p99:.0f} ms or more"
        if slow
        else f"calls vary by {1e3 * trips.jitter:.0f} ms, so commands would have to be sent {1e3 * lead:.0f} ms ahead"
    )
    limit = settings.max_round_trip if slow else settings.max_lead_time
    raise SlowLinkError(
        f"'{uri}' is too slow for control every 12 ms: {what}, and at most {1e3 * limit:.0f} ms are possible; {CURE}"
    )


LATER, SOONER = 25, 5
"""Ticks in a row with all samples late, or early, before that counts as normal."""


class JitterBuffer:
    """Gives each tick the sample of its own cycle of the robot, or the last before it.

    Cycles increase by one a tick, as in a simulation: a sample that comes early waits for its tick, and one that does
    not come is reported as missed. Where all come early or late for some time, cycles are counted again.

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
        self._min_late = self._min_early = 0
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
        self._realign()
        while self._waiting and self._waiting[0][0] <= self.cycle:
            self._of, self.sample = self._waiting.popleft()
        self.late = self.cycle - self._of

    def _realign(self) -> None:
        late = self.cycle - self._newest
        self._late_ticks, self._min_late = _lasting(late, self._late_ticks, self._min_late)
        self._early_ticks, self._min_early = _lasting(-late, self._early_ticks, self._min_early)
        if self._late_ticks == LATER:
            # By the least: the quickest samples of that time are then those of their ticks.
            self.cycle -= self._min_late
            self._late_ticks = 0
        elif self._early_ticks == SOONER:
            self.cycle += self._min_early
            self._early_ticks = 0


def _lasting(size: int, ticks: int, least: int) -> tuple[int, int]:
    """For how many ticks something has been positive, and its least value in them."""
    if size <= 0:
        return 0, 0
    return ticks + 1, size if ticks == 0 else min(least, size)


KEPT_COMMANDS = 128
"""Commands remembered: more than a second of them."""


@dataclass(kw_only=True, slots=True, eq=False)
class ScheduledCommand:
    """A command (n,) that is to be reached at ``date``.

    Dates are of the DCM [ms]: ``sent`` is when it was sent, ``taken`` when its acknowledgement was seen, infinite where
    there was none, or the robot refused it.
    """

    values: FloatArray
    date: int
    sent: float
    acknowledged: float = inf


class CommandHistory:
    """Commands for one group of actuators, in the order in which they were sent.

    The DCM interpolates linearly from the command that it reached last to the next one that it has. So its value lies
    within those from the last one that it surely reached up to the newest that may have come, also if some are late,
    left out or refused.

    Args:
        cycle: Of the DCM [ms]; dates are trusted to that.
    """

    def __init__(self, cycle: float) -> None:
        self._cycle = cycle
        self._commands: deque[ScheduledCommand] = deque(maxlen=KEPT_COMMANDS)

    def add(self, command: ScheduledCommand) -> None:
        """Take in a command that was sent."""
        self._commands.append(command)

    def bounds(self, date: float) -> tuple[FloatArray, FloatArray] | None:
        """Return the least and the largest values (n,) that the DCM may have at a cycle of this date [ms].

        None where it may still follow earlier commands of others. Dates must not decrease.
        """
        # It is uncertain by one cycle in which of them the DCM shows a command.
        sure = date - self._cycle
        reached = None
        for place, command in enumerate(self._commands):
            if command.date <= sure and command.acknowledged <= sure:
                reached = place
        if reached is None:
            return None
        for _ in range(reached):
            # Dates do not decrease, so no later call needs it.
            self._commands.popleft()
        in_flight = np.array([c.values for c in self._commands if c.sent <= date + self._cycle])
        return in_flight.min(axis=0), in_flight.max(axis=0)
