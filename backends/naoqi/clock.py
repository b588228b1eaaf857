"""What the DCM's clock shows now, from a few questions and answers.

The DCM counts milliseconds in 32 bits with a sign (NAOqi 2.5.10, page "DCM": "can roll-over"). Dates here are whole
counts that do not roll over; only what is sent to the robot, and what it shows, does.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

SPAN = 1 << 32
"""[ms] after which the robot's clock shows the same again."""

DRIFT = 100e-6
"""Two clocks of ordinary quartz run apart by this much at most."""

KEPT = 8
"""Answers kept: with one a second, the best of the last seconds."""


def shown(date: int) -> int:
    """A date as the robot's clock shows it: -2^31 to 2^31 - 1."""
    return (date + SPAN // 2) % SPAN - SPAN // 2


def dated(shown_: int, near: float) -> int:
    """The date nearest to ``near`` that the robot's clock shows as ``shown_``."""
    base = round(near)
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


class DcmClock:
    """This computer's clock and the DCM's, side by side.

    The robot read its clock at some time between question and answer: the shorter that was, the better. An answer
    gets worse as it grows old, since the clocks run apart. The best of the last few counts.

    Args:
        first: The first answer; the date of the robot's clock then is what it shows.
    """

    def __init__(self, first: TimeReply) -> None:
        self._replies: deque[tuple[TimeReply, float]] = deque(maxlen=KEPT)
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
            return known[0].round_trip / 2 + DRIFT * (now - known[0].received * 1e-6)

        self._offset = min(self._replies, key=doubt)[1]

    def now(self, here: int) -> float:
        """The DCM's date [ms] when this computer's clock shows ``here`` [ns]."""
        return here * 1e-6 + self._offset

    def date(self, shown_: int, here: int) -> int:
        """The date near ``here`` [ns of this computer's clock] that the robot's clock shows as ``shown_``."""
        return dated(shown_, self.now(here))


def _middle(reply: TimeReply) -> float:
    return (reply.asked + reply.received) * 0.5e-6
