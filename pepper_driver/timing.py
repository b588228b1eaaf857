"""How long the stages of the ticks take, and whether ticks come in time."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

logger = logging.getLogger("pepper_driver")

STAGES = ("backend", "observer", "reflexes", "controller", "gate", "log", "deliver")
"""What a tick consists of, in order; the backend's part is the robot, or the physics."""

WAKING = "waking up"
"""What a tick is late by before it begins: others had the processor, or the interpreter."""

WARNING_PERIOD = 5.0
"""[s] between two warnings about missed ticks, at least."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Median, 99th percentile and largest of many values."""

    median: float
    p99: float
    largest: float

    @classmethod
    def of(cls, values: NDArray[np.floating[Any]]) -> Self:
        """Of (n,) values; NaN where there are none."""
        if not len(values):
            return cls(median=np.nan, p99=np.nan, largest=np.nan)
        median, p99, largest = np.percentile(values, [50, 99, 100])
        return cls(median=float(median), p99=float(p99), largest=float(largest))


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """How the ticks of a run went; ``print`` shows it all.

    Attributes:
        cycle: Between two ticks [s].
        ticks: How many there were.
        missed: How many more there should have been in real time.
        late: Ticks that ended after the next was to begin, by what took longest in each: a stage, or "waking up".
        stages: How long each stage took [us].
        tick: All stages but the backend [us].
        begin: From the time a tick was to begin to when it did [ms]; None where ticks do not wait.
        end: From the same time to its end [ms]: beyond the cycle it costs the next tick.
        sample_age: Of the measurements [ms].
    """

    cycle: float
    ticks: int
    missed: int
    late: Mapping[str, int]
    stages: Mapping[str, Spread]
    tick: Spread
    begin: Spread | None
    end: Spread | None
    sample_age: Spread

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
        """All figures by name."""
        return asdict(self)

    def __str__(self) -> str:
        rows = [(name, spread, "us") for name, spread in self.stages.items()]
        rows.append(("all but backend", self.tick, "us"))
        if self.begin is not None and self.end is not None:
            rows += [("begins late by", self.begin, "ms"), ("ends after", self.end, "ms")]
        rows.append(("age of samples", self.sample_age, "ms"))
        lines = [self.summary, f"{'':16}{'median':>10}{'p99':>10}{'max':>10}"]
        for name, s, unit in rows:
            digits = 1 if unit == "us" else 2
            figures = "".join(f"{v:10.{digits}f}" for v in (s.median, s.p99, s.largest))
            lines.append(f"{name:16}{figures} {unit}")
        return "\n".join(lines)


class StageTimes:
    """Collects what :class:`Statistics` tells. Counts are of all ticks, times of the newest ``capacity``.

    Args:
        cycle: Between two ticks [s].
        capacity: Ticks kept; by default those of an hour.
    """

    def __init__(self, cycle: float, capacity: int = 300_000) -> None:
        self._cycle = cycle
        self._cycle_ns = round(cycle * 1e9)
        # [ns] of the clock. Pages of memory are taken when they are first written.
        self._marks = np.zeros((capacity, len(STAGES) + 1), dtype=np.int64)
        self._due = np.zeros(capacity, dtype=np.int64)
        self._ages = np.zeros(capacity)
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
        self._count = 0
        self.missed = 0
        self._late: Counter[str] = Counter()
        self._longest = ""
        self._paced = self._overran = False

    @property
    def statistics(self) -> Statistics:
        """Of the ticks so far."""
        kept = min(self._count, len(self._marks))
        marks, due = self._marks[:kept], self._due[:kept]
        stages = np.diff(marks, axis=1) * 1e-3
        others = [i for i, stage in enumerate(STAGES) if stage != "backend"]
        paced = self._paced
        return Statistics(
            cycle=self._cycle,
            ticks=self._count,
            missed=self.missed,
            late=dict(self._late),
            stages={stage: Spread.of(stages[:, i]) for i, stage in enumerate(STAGES)},
            tick=Spread.of(stages[:, others].sum(axis=1)),
            begin=Spread.of(1e-6 * (marks[:, 0] - due)) if paced else None,
            end=Spread.of(1e-6 * (marks[:, -1] - due)) if paced else None,
            sample_age=Spread.of(self._ages[:kept] * 1e3),
        )

    def _warn(self, now: int) -> None:
        if self._warned is None or now - self._warned >= WARNING_PERIOD * 1e9:
            self._warned = now
            logger.warning(
                "%d ticks missed so far; longest before the last: %s", self.missed, self._longest
            )
