"""Ticks in real time: when each begins, what keeps them punctual, and statistics of how punctual they were."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends import Backend

logger = logging.getLogger("pepper_driver")

MAX_PHASE_SHIFT = 0.005
"""Fraction of a cycle by which a tick may be shifted: fifty times as much as clocks run apart."""

PRIORITY = 40
"""SCHED_FIFO priority: above all usual threads, below those that serve interrupts (50)."""

SWITCH_INTERVAL = 50e-6
"""[s] after which a thread that computes hands the interpreter to the tick.

Each of the simulation's steps lets go of the interpreter, and so does a sleep; the tick then waits as long as this for
each. With Python's own 5 ms, one computing callback costs two ticks of three; below 20 us, switching costs more.
"""

COLLECTION_PERIOD = 400
"""[ticks] between two collections of young garbage by the loop thread, right after a tick."""

MAX_FROZEN_BY_PYTHON = 1000
"""Frozen objects that may be Python's own: 3.12 starts with some hundred. A program that freezes has thousands."""

STAGES = ("read", "observer", "arbiter", "controller", "gate", "write", "log", "publish")
"""Stages of a tick, in order; ``read`` and ``write`` are the backend's: the robot, or the physics."""

WAKING = "waking up"
"""Stage before the first: others had the processor, or the interpreter."""

WARNING_PERIOD = 5.0
"""[s] between two warnings about missed ticks, at least."""


# -- when ticks begin ---------------------------------------------------------------------------------------------


class Pacer:
    """No pacing: a tick begins when the one before is over. For simulations.

    Attributes:
        due: Time at which the tick under way was to begin [ns of the clock]; None where ticks do not wait.
        paced: True where ticks wait.
    """

    due: int | None = None
    paced = False

    def clock(self) -> int:
        """Return the time [ns]: monotonic."""
        return time.perf_counter_ns()

    def wait(self) -> int:
        """Return when the next tick is to begin, with the number of ticks missed before it."""
        return 0


class RealTimePacer(Pacer):
    """Ticks begin at absolute times, whole cycles apart: a late one shifts no other.

    A tick that is not over when the next is to begin costs that one, and every other until it is over. So does a
    thread that wakes up a whole cycle late. Nothing is missed before the first tick.

    Sleeping ends 0.1 ms late at normal priority. Spinning through the last 0.3 ms would take that away and keep the
    interpreter from all other threads meanwhile; a robot that samples every 12 ms at a phase of its own gains nothing.

    A robot's clock is not this computer's. The first tick is put where its cycles want it, and the others follow them
    by at most ``MAX_PHASE_SHIFT`` of a cycle each. The sample of a tick is requested shortly before it.

    Args:
        cycle: Between two ticks [s].
        phase_error: How much later than a time [ns] a tick best begins [s]; see :meth:`Backend.phase_error`.
        request: Requests the sample of the coming tick; see :meth:`Backend.request`.
        request_lead: How long before the tick it is called [s]; 0 for never.
        clock: Monotonic [ns].
        sleep: Waits [s].
    """

    paced = True

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

    def clock(self) -> int:
        """Return the time [ns] of the clock that ticks are paced by."""
        return self._clock()

    @classmethod
    def from_backend(cls, backend: Backend, cycle: float) -> Self:
        """Return a pacer that follows a robot's cycles and requests its samples."""
        return cls(
            cycle,
            phase_error=backend.phase_error,
            request=backend.request,
            request_lead=lambda: backend.request_lead,
        )

    def wait(self) -> int:
        """Return when the next tick is to begin, with the number of ticks missed before it."""
        now = self._clock()
        if self._fresh:
            self._fresh = False
            if self._next <= now:
                self._next = now + round(1e9 * self._phase_error(now)) % self._cycle
        missed = max(0, -((self._next - now) // self._cycle))  # rounded up: begun is too late
        due = self._next + missed * self._cycle
        if due > now:
            lead = round(1e9 * self._request_lead())
            if lead:
                if due - lead > now:
                    self._sleep((due - lead - now) * 1e-9)
                self._request()
                now = self._clock()
            if due > now:
                self._sleep((due - now) * 1e-9)
            overslept = max(0, (self._clock() - due) // self._cycle)
            missed += overslept
            due += overslept * self._cycle
        self.due, self._next = due, due + self._cycle
        most = MAX_PHASE_SHIFT * self._cycle
        self._next += round(max(-most, min(most, 1e9 * self._phase_error(self._next))))
        return missed


# -- what keeps them punctual -------------------------------------------------------------------------------------


@contextmanager
def realtime_process() -> Iterator[None]:
    """Set up the process for ticks in real time; all is put back at the end.

    The collector of reference cycles leaves alone what is there, and does not run by itself; what came since is
    collected at the end. Threads switch more often. Blocks may be nested, and entered by several threads.
    """
    _process.enter()
    try:
        yield
    finally:
        _process.leave()


@contextmanager
def realtime_thread() -> Iterator[None]:
    """Give this thread real-time priority, or log once how to permit it. Threads that it starts do not inherit that."""
    try:
        before = _raise_priority()
    except _RefusedError as error:
        before = None
        if str(error) not in _logged:
            _logged.add(str(error))
            logger.warning("ticks run at normal priority and may come late: %s", error)
    try:
        yield
    finally:
        if before is not None:
            _set_scheduler(*before)


def priority_obstacle() -> str:
    """Return why this thread cannot have real-time priority, and what permits it; empty when it can."""
    try:
        before = _raise_priority()
    except _RefusedError as error:
        return str(error)
    if before is not None:
        _set_scheduler(*before)
    return ""


class _Process:
    """What all threads share: set by the first block that begins, put back by the last that ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._blocks = 0

    def enter(self) -> None:
        with self._lock:
            self._blocks += 1
            if self._blocks > 1:
                return
            self._switch_interval = sys.getswitchinterval()
            self._collecting = gc.isenabled()
            self._frozen = gc.get_freeze_count() > MAX_FROZEN_BY_PYTHON  # by the user: stays so
            sys.setswitchinterval(min(SWITCH_INTERVAL, self._switch_interval))
            gc.freeze()
            gc.disable()

    def leave(self) -> None:
        with self._lock:
            self._blocks -= 1
            if self._blocks:
                return
            sys.setswitchinterval(self._switch_interval)
            if self._collecting:
                gc.collect()  # quick: what is frozen is not looked at
                gc.enable()
            if not self._frozen:
                gc.unfreeze()


_process = _Process()
_logged: set[str] = set()


class _RefusedError(Exception):
    """The system gives no real-time priority, for the reason given."""


def _raise_priority() -> tuple[int, int] | None:
    """Raise the priority; return scheduler and priority before, None where nothing has changed."""
    if not hasattr(os, "sched_setscheduler"):
        raise _RefusedError("this system knows no real-time priority")
    before, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    if before & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR):
        return None  # given from outside, such as by chrt
    try:
        _set_scheduler(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, PRIORITY)
    except OSError as error:  # a container may refuse with other errors than PermissionError
        raise _RefusedError(
            "real-time priority is not permitted; a line like '@realtime - rtprio 50' in "
            "/etc/security/limits.d/pepper.conf permits it to the group realtime"
        ) from error
    return before, priority


def _set_scheduler(scheduler: int, priority: int) -> None:
    """Set those of this thread: 0 is the thread that calls."""
    try:
        os.sched_setscheduler(0, scheduler, os.sched_param(priority))
    except PermissionError:
        if scheduler & os.SCHED_RESET_ON_FORK:
            raise
        # Only root may take this flag away again; without a priority above others it means nothing.
        scheduler |= os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, scheduler, os.sched_param(priority))


# -- how punctual they were ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Quantiles:
    """Median, 99th percentile and maximum of many values; NaN of none."""

    median: float
    p99: float
    max: float

    @classmethod
    def from_values(cls, values: NDArray[np.floating[Any]]) -> Self:
        """Return those of (n,) values."""
        median, p99, top = np.percentile(values, [50, 99, 100]) if len(values) else [np.nan] * 3
        return cls(median=float(median), p99=float(p99), max=float(top))


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """Timing of the ticks of a run; ``print`` shows it all.

    Attributes:
        cycle: Between two ticks [s].
        ticks: Number of ticks.
        missed: Number of ticks that should have been in real time, and were not.
        late: Ticks that ended after the next was to begin, by what took longest in each: a stage, or "waking up".
        stages: Time of each stage [us].
        tick: Time of all stages but those of the backend [us].
        begin: From the time a tick was to begin to when it did [ms]; None where ticks do not wait.
        end: From the same time to its end [ms]: beyond the cycle it costs the next tick.
        sample_age: Age of the measurements [ms].
    """

    cycle: float
    ticks: int
    missed: int
    late: Mapping[str, int]
    stages: Mapping[str, Quantiles]
    tick: Quantiles
    begin: Quantiles | None
    end: Quantiles | None
    sample_age: Quantiles

    @property
    def summary(self) -> str:
        """One line: how many ticks were missed, and what was longest in those that were late."""
        text = f"{self.ticks} ticks of {1e3 * self.cycle:g} ms"
        if self.end is None:
            return f"{text}, as fast as they go"
        text += f" in real time, {self.missed or 'none'} missed"
        if self.late:
            parts = sorted(self.late.items(), key=lambda part: -part[1])
            text += f"; longest in late ones: {', '.join(f'{k} ({n})' for k, n in parts)}"
        return text

    def as_json(self) -> dict[str, Any]:
        """Return all figures by name."""
        return asdict(self)

    def __str__(self) -> str:
        rows = [(name, of, "us") for name, of in self.stages.items()]
        rows.append(("all but backend", self.tick, "us"))
        if self.begin is not None and self.end is not None:
            rows += [("begins late by", self.begin, "ms"), ("ends after", self.end, "ms")]
        rows.append(("age of samples", self.sample_age, "ms"))
        lines = [self.summary, f"{'':16}{'median':>10}{'p99':>10}{'max':>10}"]
        for name, of, unit in rows:
            digits = 1 if unit == "us" else 2
            figures = "".join(f"{value:10.{digits}f}" for value in asdict(of).values())
            lines.append(f"{name:16}{figures} {unit}")
        return "\n".join(lines)


class StageTimes:
    """Collects what :class:`Statistics` reports. Counts are of all ticks, times of the newest ``capacity``.

    Args:
        cycle: Between two ticks [s].
        capacity: Ticks kept; by default those of an hour.
    """

    def __init__(self, cycle: float, capacity: int = 300_000) -> None:
        self._cycle, self._cycle_ns = cycle, round(cycle * 1e9)
        # [ns] of the clock. Pages of memory are taken when they are first written.
        self._marks = np.zeros((capacity, len(STAGES) + 1), dtype=np.int64)
        self._due, self._ages = np.zeros(capacity, dtype=np.int64), np.zeros(capacity)
        self._warned: int | None = None
        self._paced = self._overran = False
        self.clear()

    def add(
        self, marks: Sequence[int], *, age: float, due: int | None = None, missed: int = 0
    ) -> None:
        """Take in one tick.

        Args:
            marks: The clock before the first and after each stage [ns].
            age: Of its measurement [s].
            due: When it was to begin, by the same clock; None where ticks do not wait.
            missed: Ticks before it that never began.
        """
        slot = self._count % len(self._marks)
        self._marks[slot] = marks
        self._ages[slot] = age
        self._due[slot] = marks[0] if due is None else due
        self._count += 1
        if missed:
            self.missed += missed
            if not self._overran:  # not the tick before, but the waiting took too long
                self._late[WAKING] += 1
                self._longest = WAKING
            self._warn(marks[0])
        self._paced = due is not None
        self._overran = due is not None and marks[-1] - due > self._cycle_ns
        if due is not None and self._overran:
            times = [b - a for a, b in zip((due, *marks), marks, strict=False)]
            self._longest = (WAKING, *STAGES)[times.index(max(times))]
            self._late[self._longest] += 1

    def clear(self) -> None:
        """Forget all ticks."""
        self._count = self.missed = 0
        self._late: Counter[str] = Counter()
        self._longest = ""
        self._paced = self._overran = False

    @property
    def statistics(self) -> Statistics:
        """Statistics of the ticks so far."""
        kept = min(self._count, len(self._marks))
        marks, due = self._marks[:kept], self._due[:kept]
        times = np.diff(marks, axis=1) * 1e-3
        of = Quantiles.from_values
        own = [i for i, stage in enumerate(STAGES) if stage not in ("read", "write")]
        return Statistics(
            cycle=self._cycle,
            ticks=self._count,
            missed=self.missed,
            late=dict(self._late),
            stages={stage: of(times[:, i]) for i, stage in enumerate(STAGES)},
            tick=of(times[:, own].sum(axis=1)),
            begin=of(1e-6 * (marks[:, 0] - due)) if self._paced else None,
            end=of(1e-6 * (marks[:, -1] - due)) if self._paced else None,
            sample_age=of(self._ages[:kept] * 1e3),
        )

    def _warn(self, now: int) -> None:
        if self._warned is None or now - self._warned >= WARNING_PERIOD * 1e9:
            self._warned = now
            logger.warning(
                "%d ticks missed so far; longest before the last: %s", self.missed, self._longest
            )
