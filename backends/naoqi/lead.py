"""How far ahead commands must be sent: from the round trips of a burst of calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.clock import TimeReply
from pepper_driver.config.naoqi import TimingSettings

LEAST_CALLS = 20
"""Of a burst: fewer say nothing about the slowest in a hundred."""

LONGEST_BURST = 3.0
"""[s] for them, on the slowest of links."""

ATTEMPTS = 3
"""Bursts before a link is refused: one may have met something else that happened."""

CURE = (
    "connect the robot by cable, or go nearer to the access point and end other traffic; "
    "else move it through ALMotion, slower, by ?mode=angles"
)


class SlowLinkError(BackendError):
    """The way to the robot takes too long, or its length varies too much, for control in every cycle."""


@dataclass(frozen=True, kw_only=True)
class RoundTrips:
    """Of calls to the robot [s]."""

    calls: int
    median: float
    p95: float
    p99: float
    jitter: float

    @classmethod
    def of(cls, replies: Sequence[TimeReply]) -> Self:
        """Of answers; ``jitter`` is what the slowest in a hundred took longer than the quickest.

        The quickest and this one together bound how much one way can vary. The very slowest call says more of what else
        the two computers did at that moment than of the way.
        """
        times = np.array([reply.round_trip for reply in replies]) * 1e-3
        least, median, p95, p99 = np.percentile(times, [0, 50, 95, 99]).tolist()
        return cls(calls=len(times), median=median, p95=p95, p99=p99, jitter=p99 - least)

    def lead(self, settings: TimingSettings) -> float:
        """[s] from sending a command to its date, so that it arrives before."""
        return max(self.jitter + settings.lead_margin, settings.least_lead)


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
        if spent >= LONGEST_BURST or (spent >= seconds and len(replies) >= LEAST_CALLS):
            return replies


def measure(
    ask: Callable[[], int],
    settings: TimingSettings,
    uri: str,
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> tuple[RoundTrips, list[TimeReply]]:
    """Measure the way to the robot, and what its clock shows.

    Args:
        ask: Asks the robot for its time [ms], and waits for the answer.
        settings: What is borne.
        uri: For the message.
        clock: Monotonic [ns].

    Raises:
        SlowLinkError: It does not allow control in every cycle.
    """
    for _ in range(ATTEMPTS):
        replies = burst(ask, settings.burst, clock)
        trips = RoundTrips.of(replies)
        lead = trips.lead(settings)
        if trips.p99 <= settings.longest_round_trip and lead <= settings.longest_lead:
            return trips, replies
    slow = trips.p99 > settings.longest_round_trip
    what = (
        f"one call in a hundred takes {1e3 * trips.p99:.0f} ms or more"
        if slow
        else f"calls vary by {1e3 * trips.jitter:.0f} ms, so commands would have to be sent {1e3 * lead:.0f} ms ahead"
    )
    limit = settings.longest_round_trip if slow else settings.longest_lead
    raise SlowLinkError(
        f"'{uri}' is too slow for control every 12 ms: {what}, and at most {1e3 * limit:.0f} ms are possible; {CURE}"
    )
