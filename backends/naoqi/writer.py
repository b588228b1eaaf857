"""Commands on their way to the DCM: never more than two unacknowledged, and harmless should they come late.

A robot that hung takes all that waits for it when it goes on, whatever its date: the DCM applies a command whose date
has passed at its next cycle (NAOqi 2.5.10, page "DCM advanced"). So what is on its way may move no joint by more than a
small step, and every command to the wheels ends in standing still.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pepper_driver.backends.naoqi.clock import shown
from pepper_driver.backends.naoqi.keys import Alias
from pepper_driver.backends.naoqi.library import Future, Proxy, one_line
from pepper_driver.config.arrays import FloatArray

logger = logging.getLogger("pepper_driver")

Update = Literal["ClearAll", "ClearAfter"]

OUTSTANDING = 2
"""Commands that may be on their way."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Sent:
    """A command on its way; ``done`` is told whether the robot took it."""

    future: Future
    at: int
    alias: Alias
    done: Callable[[bool], None] | None


class Writer:
    """Sends commands to the DCM and looks after their acknowledgements, without ever waiting.

    Args:
        dcm: Its proxy.
        largest_step: What commands on their way may move a joint, all together [rad].
        now: This computer's clock [ns].
    """

    def __init__(
        self,
        dcm: Proxy,
        largest_step: float,
        now: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self._dcm, self._largest_step, self._now = dcm, largest_step, now
        self._on_the_way: list[_Sent] = []
        self._unheard: dict[Alias, int] = {}
        self._refused_before: set[Alias] = set()
        self._taken: FloatArray | None = None

    @property
    def free(self) -> int:
        """How many commands may be sent now."""
        return OUTSTANDING - len(self._on_the_way)

    @property
    def idle(self) -> bool:
        """Whether nothing is on its way."""
        return not self._on_the_way

    @property
    def silence(self) -> float:
        """For how long the robot has been taking nothing of some kind of command [s]; 0 where all was taken."""
        if not self._unheard:
            return 0.0
        return (self._now() - min(self._unheard.values())) * 1e-9

    def collect(self) -> None:
        """Take in the acknowledgements that have come meanwhile."""
        waiting = []
        for sent in self._on_the_way:
            if sent.future.isRunning():
                waiting.append(sent)
                continue
            taken = not sent.future.hasError()
            if taken:
                self._unheard.pop(sent.alias, None)
            else:
                self._refused(sent)
            if sent.done is not None:
                sent.done(taken)
        self._on_the_way = waiting
        for sent in waiting:
            self._unheard.setdefault(sent.alias, sent.at)

    def position(self, wanted: FloatArray, date: int, done: Callable[[bool], None]) -> bool:
        """Let the joints be at (17,) positions [rad] at a date [ms]; returns whether the command was sent.

        Not where it could come late together with others, and would then move a joint too far.
        """
        if self.free < 1:
            return False
        waiting = any(sent.alias is Alias.POSITION for sent in self._on_the_way)
        if waiting and not self._near(wanted):
            return False

        def acknowledged(taken: bool) -> None:
            if taken:
                self._taken = wanted
            done(taken)

        values = [[value] for value in wanted.tolist()]
        return self.send(Alias.POSITION, "ClearAfter", [date], values, acknowledged)

    def _near(self, wanted: FloatArray) -> bool:
        """Whether what is on its way, and this, move no joint far from what the robot took last."""
        taken = self._taken
        return taken is not None and float(np.abs(wanted - taken).max()) <= self._largest_step

    def send(
        self,
        alias: Alias,
        update: Update,
        dates: Sequence[int],
        values: Sequence[Sequence[float]],
        done: Callable[[bool], None] | None = None,
    ) -> bool:
        """Send one command; returns whether it is on its way.

        Args:
            alias: Of the actuators.
            update: What becomes of commands that the DCM has already.
            dates: (t) when [ms].
            values: For each actuator, t values.
            done: Is told whether the robot took it.
        """
        if self.free < 1:
            return False
        command = [str(alias), update, "time-separate", 0, [shown(date) for date in dates], values]
        now = self._now()
        try:
            future = self._dcm.setAlias(command, _async=True)
        except RuntimeError as error:  # the connection is lost
            logger.debug("not sent: %s", error)
            return False
        self._on_the_way.append(_Sent(future=future, at=now, alias=alias, done=done))
        self._unheard.setdefault(alias, now)
        return True

    def _refused(self, sent: _Sent) -> None:
        if sent.alias in self._refused_before:
            return
        self._refused_before.add(sent.alias)
        try:
            sent.future.value()
        except RuntimeError as error:
            reason = one_line(str(error))
            logger.warning("the robot refused a command for %s: %s", sent.alias, reason)
