"""Cost of callbacks in ticks: robots with one bad callback each, and a robot with none, in turns."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median

from pepper_driver.callbacks.events import TickEvent
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper

ROUND = 2.4
"""[s] for which a robot runs before the next has its turn."""

SLEEP = 10.0
"""[s] a callback sleeps."""


class CallbackError(Exception):
    """Exception of a callback that raises."""


@dataclass(frozen=True, kw_only=True)
class CallbackCost:
    """Ticks of a robot with one kind of callback.

    Attributes:
        tick: Without the physics, median over the rounds of the median [us].
        ratio: Of ``tick`` to that without a callback.
        end: From the time a tick was to begin to its end, median over the rounds of the 99th percentile [ms].
        missed: Ticks that never began.
        ticks: Those that did.
    """

    tick: float
    ratio: float
    end: float
    missed: int
    ticks: int


def run_callback_bench(
    seconds: float = 20.0, *, on_progress: Callable[[float], None] | None = None
) -> dict[str, CallbackCost]:
    """Measure in real time, in rounds of a few seconds, each callback called on every tick; costs by kind.

    Args:
        seconds: For each kind [s].
        on_progress: Called with the fraction done, 0..1.
    """
    report_progress = on_progress or (lambda fraction: None)
    rounds = max(1, round(seconds / ROUND))
    runs: dict[str, list[Statistics]] = {kind: [] for kind in KINDS}
    with _log_to_nowhere():
        for number in range(rounds):
            for place, kind in enumerate(KINDS):
                runs[kind].append(_round(KINDS[kind]))
                report_progress((number + (place + 1) / len(KINDS)) / rounds)
    ticks = {kind: median(s.tick.median for s in of) for kind, of in runs.items()}
    return {
        kind: CallbackCost(
            tick=ticks[kind],
            ratio=ticks[kind] / ticks["none"],
            end=median(s.end.p99 for s in of if s.end is not None),
            missed=sum(s.missed for s in of),
            ticks=sum(s.ticks for s in of),
        )
        for kind, of in runs.items()
    }


def _round(callback: Callable[[threading.Event], object] | None) -> Statistics:
    over = threading.Event()
    with Pepper("mujoco", reflexes=[Hold()], real_time=True) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6, "RElbowRoll": 0.8})
        pepper.run(0.3)
        pepper.clear_statistics()
        if callback is not None:

            @pepper.on_tick()
            def _(event: TickEvent) -> None:
                if not over.is_set():
                    callback(over)

        try:
            pepper.run(ROUND)
        finally:
            over.set()
        return pepper.statistics


def _fail(over: threading.Event) -> None:
    raise CallbackError("as a user's mistake would")


def _compute(over: threading.Event) -> None:
    while not over.is_set():
        sum(range(1000))


KINDS: dict[str, Callable[[threading.Event], object] | None] = {
    "none": None,
    "quick, on every tick": lambda over: None,
    "sleeps 10 s": lambda over: over.wait(SLEEP),
    "raises on every tick": _fail,
    "computes all the time": _compute,
}


@contextmanager
def _log_to_nowhere() -> Iterator[None]:
    """Tracebacks are made and written, but not to the terminal."""
    logger = logging.getLogger("pepper_driver")
    before = logger.propagate
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        handler = logging.StreamHandler(nowhere)
        logger.addHandler(handler)
        logger.propagate = False
        try:
            yield
        finally:
            logger.propagate = before
            logger.removeHandler(handler)
