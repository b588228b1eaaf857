"""Reader of the sensors and writer of the commands of the DCM.

A robot that hung accepts all waiting commands when it continues, at any date: the DCM applies a command whose date
has passed at its next cycle (NAOqi 2.5.10, page "DCM advanced"). So the commands in flight may move no joint by more
than a small step, and every command to the wheels ends in standing still.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pepper_driver.backends.naoqi.memory_keys import Alias, SensorKeys, Values
from pepper_driver.backends.naoqi.qi_library import Future, Proxy, one_line
from pepper_driver.backends.naoqi.timing import DcmClockEstimate, TimeReply, shown
from pepper_driver.config.arrays import FloatArray

logger = logging.getLogger("pepper_driver")

CLOCK_PERIOD = 1_000_000_000
"""[ns] between two questions for the robot's time."""

WARNING_PERIOD = 5_000_000_000
"""[ns] between two warnings about invalid samples."""


class Reader:
    """Asks for samples and takes the answers, each in a tick of its own; now and then asks for the time as well.

    The time is asked for as soon as a sample has come, so that there are never two questions at once.

    Args:
        memory: Proxy of ALMemory.
        dcm: Proxy of the DCM.
        keys: What is read.
        clock: Estimate that is updated with the robot's time.
        first: A sample that was read already.
        date: Of that sample [ms].
        now: This computer's clock [ns].

    Attributes:
        newest: The newest good sample.
        date: Its date [ms].
        missing: Human-readable reason why the last reply was no valid sample; empty if it was.
    """

    def __init__(
        self,
        memory: Proxy,
        dcm: Proxy,
        keys: SensorKeys,
        clock: DcmClockEstimate,
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
        # The same date again: the DCM has made no cycle since, or a busy robot published no sample.
        if date <= self.date:
            return False
        self.newest, self.date = values, date
        return True

    def ask(self, *, commands: bool = False) -> None:
        """Ask for a sample, unless a request is in flight.

        Args:
            commands: Also ask for the DCM's commands to joints and wheels.
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
    """Question for the DCM's time, asked and answered on threads of the library.

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
            # First, because time spent here would count as round trip.
            received = self._now()
            try:
                shown = int(future.value())
                self.reply = TimeReply(asked=asked, received=received, shown=shown)
            except (RuntimeError, TypeError, ValueError):
                pass  # the next one is asked in a second
            # After `reply`, which the tick on another thread takes once this is true.
            self.over = True

        try:
            self._dcm.getTime(0, _async=True).addCallback(answered)
        except RuntimeError:
            self.over = True


Update = Literal["ClearAll", "ClearAfter"]

MAX_OUTSTANDING = 2
"""Largest number of commands in flight."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _CommandInFlight:
    """A command in flight; ``done`` is called with True if the robot accepted it."""

    future: Future
    at: int
    alias: Alias
    done: Callable[[bool], None] | None


class Writer:
    """Sends commands to the DCM and tracks their acknowledgements, without ever waiting.

    Args:
        dcm: Its proxy.
        max_step: Largest motion of a joint by all commands in flight together [rad].
        now: This computer's clock [ns].
    """

    def __init__(
        self,
        dcm: Proxy,
        max_step: float,
        now: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self._dcm, self._max_step, self._now = dcm, max_step, now
        self._in_flight: list[_CommandInFlight] = []
        self._unacknowledged: dict[Alias, int] = {}
        self._refused_before: set[Alias] = set()
        self._last_acknowledged: FloatArray | None = None

    @property
    def free(self) -> int:
        """Return the number of commands that may be sent now."""
        return MAX_OUTSTANDING - len(self._in_flight)

    @property
    def idle(self) -> bool:
        """True while no command is in flight."""
        return not self._in_flight

    @property
    def unacknowledged_time(self) -> float:
        """Longest time without acknowledgement, over the kinds of commands [s]; 0 if all were acknowledged."""
        if not self._unacknowledged:
            return 0.0
        return (self._now() - min(self._unacknowledged.values())) * 1e-9

    def collect(self) -> None:
        """Take in the acknowledgements that have come meanwhile."""
        waiting = []
        for sent in self._in_flight:
            if sent.future.isRunning():
                waiting.append(sent)
                continue
            accepted = not sent.future.hasError()
            if accepted:
                # Commands of this kind that still wait are entered again below, with their own times.
                self._unacknowledged.pop(sent.alias, None)
            else:
                self._refused(sent)
            if sent.done is not None:
                sent.done(accepted)
        self._in_flight = waiting
        for sent in waiting:
            self._unacknowledged.setdefault(sent.alias, sent.at)

    def position(self, target: FloatArray, date: int, done: Callable[[bool], None]) -> bool:
        """Send (17,) joint positions [rad] for an execution time [ms]; return True if they were sent.

        Not where it could come late together with others, and would then move a joint too far.
        """
        if self.free < 1:
            return False
        waiting = any(sent.alias is Alias.POSITION for sent in self._in_flight)
        if waiting and not self._near(target):
            return False

        def acknowledged(accepted: bool) -> None:
            if accepted:
                self._last_acknowledged = target
            done(accepted)

        values = [[value] for value in target.tolist()]
        # ClearAfter keeps the command before, which the DCM still has to reach at its own cycle.
        return self.send(Alias.POSITION, "ClearAfter", [date], values, acknowledged)

    def _near(self, target: FloatArray) -> bool:
        """Check that this command, and those in flight, move no joint far from the last one that the robot took."""
        accepted = self._last_acknowledged
        return accepted is not None and float(np.abs(target - accepted).max()) <= self._max_step

    def send(
        self,
        alias: Alias,
        update: Update,
        dates: Sequence[int],
        values: Sequence[Sequence[float]],
        done: Callable[[bool], None] | None = None,
    ) -> bool:
        """Send one command; return True if it is in flight.

        Args:
            alias: Of the actuators.
            update: What becomes of commands that the DCM has already.
            dates: (t) when [ms].
            values: For each actuator, t values.
            done: Called with True if the robot accepted it.
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
        self._in_flight.append(_CommandInFlight(future=future, at=now, alias=alias, done=done))
        self._unacknowledged.setdefault(alias, now)
        return True

    def _refused(self, sent: _CommandInFlight) -> None:
        if sent.alias in self._refused_before:
            return
        # One warning for each kind: the same refusal may come in every tick.
        self._refused_before.add(sent.alias)
        try:
            sent.future.value()
        except RuntimeError as error:
            reason = one_line(str(error))
            logger.warning("the robot refused a command for %s: %s", sent.alias, reason)
