"""The newest sample, without ever waiting for one: at most one question is on its way."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from pepper_driver.backends.naoqi.clock import DcmClock, TimeReply
from pepper_driver.backends.naoqi.keys import SensorKeys, Values
from pepper_driver.backends.naoqi.library import Future, Proxy, one_line

logger = logging.getLogger("pepper_driver")

CLOCK_PERIOD = 1_000_000_000
"""[ns] between two questions for the robot's time."""

WARNING_PERIOD = 5_000_000_000
"""[ns] between two warnings about samples that are none."""


class Reader:
    """Asks for samples and takes the answers, each in a tick of its own; now and then asks for the time as well.

    The time is asked for as soon as a sample has come, so that there are never two questions at once.

    Args:
        memory: Proxy of ALMemory.
        dcm: Proxy of the DCM.
        keys: What is read.
        clock: Is told what the robot says of the time.
        first: A sample that was read already.
        date: Of that sample [ms].
        now: This computer's clock [ns].

    Attributes:
        newest: The newest good sample.
        date: Its date [ms].
        missing: Why the last answer was no good sample, for people; empty where it was one.
    """

    def __init__(
        self,
        memory: Proxy,
        dcm: Proxy,
        keys: SensorKeys,
        clock: DcmClock,
        *,
        first: Values,
        date: int,
        now: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self._memory, self._dcm, self._keys, self._clock = memory, dcm, keys, clock
        self.newest, self.date, self.missing = first, date, ""
        self._now = now
        self._clock_asked = now()
        self._warned: int | None = None
        self._question: Future | None = None
        self._time_question: _TimeQuestion | None = None

    def take(self) -> bool:
        """Take in the answer that has come meanwhile; returns whether it is a sample younger than the newest."""
        self._take_time()
        question = self._question
        if question is None or question.isRunning():
            return False
        self._question = None
        try:
            values = self._keys.values(question.value())
        except RuntimeError as error:
            values = one_line(str(error))
        if isinstance(values, str):
            self._warn(values)
            return False
        self.missing = ""
        date = self._clock.date(values.shown, self._now())
        if date <= self.date:
            return False
        self.newest, self.date = values, date
        return True

    def ask(self, *, commands: bool = False) -> None:
        """Ask for a sample, unless a question is on its way.

        Args:
            commands: Also ask what the DCM tells joints and wheels.
        """
        if self._question is not None or self._time_question is not None:
            return
        names = self._keys.with_commands if commands else self._keys.names
        try:
            self._question = self._memory.getListData(names, _async=True)
        except RuntimeError as error:  # the connection is lost
            self._warn(one_line(str(error)))
            return
        now = self._now()
        if now - self._clock_asked >= CLOCK_PERIOD:
            self._clock_asked = now
            self._time_question = _TimeQuestion(self._dcm, self._now)
            self._question.addCallback(self._time_question.ask)

    def _take_time(self) -> None:
        question = self._time_question
        if question is not None and question.over:
            self._time_question = None
            if question.reply is not None:
                self._clock.add(question.reply)

    def _warn(self, problem: str) -> None:
        self.missing = problem
        now = self._now()
        if self._warned is None or now - self._warned >= WARNING_PERIOD:
            self._warned = now
            logger.warning("the robot sent no good sample: %s", problem)


class _TimeQuestion:
    """What time is it by the DCM? Asked and answered on threads of the library.

    Attributes:
        over: Whether nothing more is to come.
        reply: The answer, if there was one.
    """

    def __init__(self, dcm: Proxy, now: Callable[[], int]) -> None:
        self._dcm, self._now = dcm, now
        self.over = False
        self.reply: TimeReply | None = None

    def ask(self, _: object) -> None:
        asked = self._now()

        def answered(future: Future) -> None:
            received = self._now()
            try:
                shown = int(future.value())
                self.reply = TimeReply(asked=asked, received=received, shown=shown)
            except (RuntimeError, TypeError, ValueError):
                pass  # the next one is asked in a second
            self.over = True

        try:
            self._dcm.getTime(0, _async=True).addCallback(answered)
        except RuntimeError:
            self.over = True
