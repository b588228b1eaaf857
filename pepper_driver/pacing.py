"""When ticks begin: at absolute times, a cycle apart, or as fast as they go."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from pepper_driver.backends import Backend
from pepper_driver.realtime import realtime

FOLLOW = 0.005
"""Share of a cycle by which a tick may be put off or forward: fifty times as much as clocks run apart."""


class Pacer:
    """No pacing: a tick begins when the one before is over. For simulations.

    Attributes:
        due: When the tick under way was to begin [ns of the clock]; None where nobody waits for it.
    """

    due: int | None = None

    def running(self) -> AbstractContextManager[None]:
        """The ticks of one run are inside this block."""
        return nullcontext()

    def wait(self) -> int:
        """Return when the next tick is to begin, with the number of ticks missed before it."""
        return 0


class RealTimePacer(Pacer):
    """Ticks begin at absolute times, whole cycles apart: a late one shifts no other.

    A tick that is not over when the next is to begin costs that one, and every other until it is over. So does a
    thread that wakes up a whole cycle late. The times go on from run to run: short runs one after the other keep the
    beat. Between runs nothing is missed.

    Sleeping ends 0.1 ms late at normal priority. Spinning through the last 0.3 ms would take that away and keep the
    interpreter from all other threads meanwhile; a robot that samples every 12 ms at a phase of its own gains nothing.

    A robot's clock is not this computer's. The first tick after a pause is put where its cycles want it, and the others
    follow them by at most ``FOLLOW`` of a cycle each.

    Args:
        cycle: Between two ticks [s].
        phase_error: How much later than a time [ns] a tick best begins [s]; see :meth:`Backend.phase_error`.
        request: Asks for the sample of the coming tick.
        request_lead: How long before the tick it is called [s]; 0 for never.
        clock: Monotonic [ns].
        sleep: Waits [s].
    """

    def __init__(
        self,
        cycle: float,
        *,
        phase_error: Callable[[int], float] = lambda _: 0.0,
        request: Callable[[], None] = lambda: None,
        request_lead: Callable[[], float] = lambda: 0.0,
        clock: Callable[[], int] = time.perf_counter_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._cycle = round(cycle * 1e9)
        self._phase_error, self._clock, self._sleep = phase_error, clock, sleep
        self._request, self._request_lead = request, request_lead
        self._next = clock()
        self._fresh = True

    def running(self) -> AbstractContextManager[None]:
        """The ticks of one run are inside this block; the process is set up for them meanwhile."""
        self._fresh = True
        return realtime()

    def wait(self) -> int:
        """Return when the next tick is to begin, with the number of ticks missed before it."""
        now, lead = self._clock(), round(1e9 * self._request_lead())
        if self._fresh:
            self._fresh = False
            if self._next <= now:  # else the run before has kept the beat up to here
                self._next = now + round(1e9 * self._phase_error(now)) % self._cycle
                if lead and self._next - now < lead:  # the sample would come too late
                    self._next += self._cycle
        missed = max(0, -((self._next - now) // self._cycle))  # rounded up: begun is too late
        due = self._next + missed * self._cycle
        if lead:
            self._sleep_until(due - lead)
            self._request()
        self._sleep_until(due)
        overslept = max(0, (self._clock() - due) // self._cycle)
        missed += overslept
        due += overslept * self._cycle
        self.due, self._next = due, due + self._cycle
        most = FOLLOW * self._cycle
        self._next += round(max(-most, min(most, 1e9 * self._phase_error(self._next))))
        return missed

    def _sleep_until(self, moment: int) -> None:
        rest = moment - self._clock()
        if rest > 0:
            self._sleep(rest * 1e-9)


def robot_pacer(backend: Backend, cycle: float) -> RealTimePacer:
    """Return a pacer that follows the cycles of a robot and requests each sample in time."""
    return RealTimePacer(
        cycle,
        phase_error=backend.phase_error,
        request=backend.request,
        request_lead=lambda: backend.request_lead,
    )
