"""Ticks in real time: when each begins, what keeps them punctual, and statistics of how punctual they were."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends import Backend
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock

logger = logging.getLogger("pepper_driver")

MAX_PHASE_SHIFT = 0.005
"""Fraction of a cycle by which a tick may be shifted: fifty times as much as clocks run apart."""

TICK_PRIORITY = 40
"""SCHED_FIFO priority: above all usual threads, below those that serve interrupts (50)."""

SWITCH_INTERVAL = 50e-6
"""[s] after which a thread that computes hands the interpreter to the tick.

Each step of the simulation releases the interpreter, and so does a sleep; the tick then waits as long as this for
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

RECENT = 100
"""Ticks over which a running robot shows the times of its stages."""

WARNING_PERIOD = 5.0
"""[s] between two warnings about missed ticks, at least."""


# -- when ticks begin ---------------------------------------------------------------------------------------------


class Pacer:
    """No pacing: a tick begins when the one before is over. For simulations.

    Attributes:
        clock: Time by which ticks are paced.
        due: Due time of the current tick [ns of the clock]; None where ticks do not wait.
        paced: True where ticks wait.
    """

    clock: Clock = SYSTEM_CLOCK
    due: int | None = None
    paced = False

    def wait(self) -> int:
        """Return when the next tick is to begin, with the number of ticks missed before it."""
        return 0


class RealTimePacer(Pacer):
    """Ticks begin at absolute times, whole cycles apart: a late one shifts no other.

    A tick that is not over when the next is to begin costs that one, and every other until it is over. So does a
    thread that wakes up a whole cycle late. Nothing is missed before the first tick.

    Sleeping ends 0.1 ms late at normal priority. Spinning through the last 0.3 ms would take that away and keep the
    interpreter from all other threads meanwhile; a robot that samples every 12 ms at a phase of its own gains nothing.

    A robot's clock is not this computer's. The first tick is put where its cycles need it, and the others follow them
    by at most ``MAX_PHASE_SHIFT`` of a cycle each. The sample of a tick is requested shortly before it.

    Args:
        cycle: Between two ticks [s].
        backend: Robot whose cycles are followed; see :meth:`Backend.phase_error` and :meth:`Backend.request`.
        clock: Time by which ticks are paced.
    """

    paced = True

    def __init__(self, cycle: float, backend: Backend, *, clock: Clock = SYSTEM_CLOCK) -> None:
        self._cycle, self._backend = round(cycle * 1e9), backend
        self.clock = clock
        self._next: int | None = None  # known from the first tick on

    def wait(self) -> int:
        """Return when the next tick is to begin, with the number of ticks missed before it."""
        cycle, backend, now = self._cycle, self._backend, self.clock.now()
        if self._next is None:
            self._next = now + round(1e9 * backend.phase_error(now)) % cycle
        missed = max(0, -((self._next - now) // cycle))  # rounded up: begun is too late
        due = self._next + missed * cycle
        if due > now:
            lead = round(1e9 * backend.request_lead)
            if lead:
                self._sleep_until(due - lead)
                backend.request()
            self._sleep_until(due)
            overslept = max(0, (self.clock.now() - due) // cycle)
            missed += overslept
            due += overslept * cycle
        most = MAX_PHASE_SHIFT * cycle
        shift = 1e9 * backend.phase_error(due + cycle)
        self.due, self._next = due, due + cycle + round(max(-most, min(most, shift)))
        return missed

    def _sleep_until(self, end: int) -> None:
        left = end - self.clock.now()
        if left > 0:
            self.clock.sleep(left * 1e-9)


# -- what keeps them punctual -------------------------------------------------------------------------------------


@contextmanager
def realtime_process() -> Iterator[None]:
    """Set up the process for ticks in real time; all is put back at the end.

    The collector of reference cycles leaves alone what is there, and does not run by itself; what came since is
    collected at the end. Threads switch more often. Blocks may be nested, and entered by several threads: the first
    that begins sets up, the last that ends puts back.
    """
    with _process_lock:
        _blocks.append(None)
        if len(_blocks) == 1:
            if (
                gc.get_freeze_count() <= MAX_FROZEN_BY_PYTHON
            ):  # frozen by the user otherwise: must stay
                _undo.callback(gc.unfreeze)
            if gc.isenabled():
                _undo.callback(gc.enable)
                _undo.callback(gc.collect)  # quick: what is frozen is not looked at
            interval = sys.getswitchinterval()
            _undo.callback(sys.setswitchinterval, interval)
            sys.setswitchinterval(min(SWITCH_INTERVAL, interval))
            gc.freeze()
            gc.disable()
    try:
        yield
    finally:
        with _process_lock:
            _blocks.pop()
            if not _blocks:
                _undo.close()


_process_lock = threading.Lock()
_blocks: list[None] = []  # one for each that is open
_undo = ExitStack()


@contextmanager
def realtime_thread() -> Iterator[None]:
    """Give this thread real-time priority, or log once how to permit it. Threads that it starts do not inherit that."""
    with _priority() as obstacle:
        if obstacle and obstacle not in _logged:
            _logged.add(obstacle)
            logger.warning("ticks run at normal priority and may come late: %s", obstacle)
        yield


def priority_obstacle() -> str:
    """Return why this thread cannot have real-time priority, and what permits it; empty when it can."""
    with _priority() as obstacle:
        return obstacle


_logged: set[str] = set()


@contextmanager
def _priority() -> Iterator[str]:
    """Give this thread real-time priority, or yield why it cannot have it, and what permits it."""
    if not hasattr(os, "sched_setscheduler"):
        yield "this system has no real-time priority"
        return
    before, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    # From outside, such as by chrt.
    given = before & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)
    obstacle = ""
    try:
        if not given:
            _set_scheduler(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, TICK_PRIORITY)
    except OSError:  # a container may refuse with other errors than PermissionError
        obstacle = (
            "real-time priority is not permitted; a line like '@realtime - rtprio 50' in "
            "/etc/security/limits.d/pepper.conf permits it to the group realtime"
        )
    try:
        yield obstacle
    finally:
        if not (given or obstacle):
            _set_scheduler(before, priority)


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


@dataclass(frozen=True)
class Quantiles:
    """Median, 99th percentile and maximum of many values; NaN of none."""

    median: float
    p99: float
    max: float

    @classmethod
    def from_values(cls, values: NDArray[np.floating[Any]]) -> Self:
        """Return those of (n,) values."""
        figures = np.percentile(values, [50, 99, 100]) if len(values) else np.full(3, np.nan)
        return cls(*figures.tolist())


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
            return f"{text}, unpaced"
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
        self._cycle = cycle
        # Begin of WAKING and end of each stage [ns], ages [s]. Pages of memory are taken when they are first written.
        self._marks = np.zeros((capacity, len(STAGES) + 2), dtype=np.int64)
        self._ages = np.zeros(capacity)
        self._warned: int | None = None
        self.clear()

    def clear(self) -> None:
        """Forget all ticks."""
        self._count = self._missed = 0
        self._late: Counter[str] = Counter()
        self._longest = ""
        self._paced = self._overran = False

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
        begin = marks[0] if due is None else due
        row = self._count % len(self._ages)
        self._marks[row], self._ages[row] = (begin, *marks), age
        self._count += 1
        if missed:
            self._missed += missed
            if not self._overran:  # not the tick before, but the waiting took too long
                self._late[WAKING] += 1
                self._longest = WAKING
            if self._warned is None or marks[0] - self._warned >= WARNING_PERIOD * 1e9:
                self._warned = marks[0]
                logger.warning(
                    "%d ticks missed so far; longest before the last: %s",
                    self._missed,
                    self._longest,
                )
        self._paced = due is not None
        self._overran = self._paced and marks[-1] - begin > self._cycle * 1e9
        if self._overran:
            times = [b - a for a, b in pairwise((begin, *marks))]
            self._longest = (WAKING, *STAGES)[times.index(max(times))]
            self._late[self._longest] += 1

    @property
    def missed(self) -> int:
        """Ticks that never began."""
        return self._missed

    def recent(self, ticks: int = RECENT) -> dict[str, float]:
        """Median time of each stage in the newest ticks [us]; none before the first tick."""
        count = min(self._count, ticks, len(self._marks))
        if not count:
            return {}
        rows = np.arange(self._count - count, self._count) % len(self._marks)
        medians = 1e-3 * np.median(np.diff(self._marks[rows]), axis=0)
        return dict(zip(STAGES, medians[1:].tolist(), strict=True))

    @property
    def statistics(self) -> Statistics:
        """Statistics of the ticks so far."""
        of = Quantiles.from_values
        times, ages = np.diff(self._marks[: self._count]).T, self._ages[: self._count]
        stages = dict(zip(STAGES, times[1:], strict=True))
        own = [times for stage, times in stages.items() if stage not in ("read", "write")]
        return Statistics(
            cycle=self._cycle,
            ticks=self._count,
            missed=self._missed,
            late=dict(self._late),
            stages={stage: of(1e-3 * times) for stage, times in stages.items()},
            tick=of(1e-3 * np.sum(own, axis=0)),
            begin=of(1e-6 * times[0]) if self._paced else None,
            end=of(1e-6 * np.sum(times, axis=0)) if self._paced else None,
            sample_age=of(1e3 * ages),
        )
