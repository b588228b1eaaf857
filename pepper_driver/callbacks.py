"""User callbacks for contacts: run on a thread of their own, never inside the tick."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.observer.contact import Contact, Kind, Phase

logger = logging.getLogger("pepper_driver")

ContactCallback = Callable[[Contact], object]
ContactPredicate = Callable[[Contact], bool]


class DispatcherClosedError(PepperError, RuntimeError):
    """A callback was registered after ``close``: nothing would ever call it."""


@dataclass(frozen=True, kw_only=True)
class CallbackStatistics:
    """What one callback has cost so far.

    Attributes:
        name: Its qualified name.
        calls: How often it was called.
        failures: How many of these calls raised.
        total_time: Time spent in it [s].
        longest_time: Longest single call [s].
    """

    name: str
    calls: int
    failures: int
    total_time: float
    longest_time: float


class _Subscription:
    """A callback with its predicate and its counters; only the dispatcher thread counts."""

    def __init__(self, callback: ContactCallback, predicate: ContactPredicate | None) -> None:
        self.callback = callback
        self.predicate = predicate
        self.name = getattr(callback, "__qualname__", None) or type(callback).__name__
        self.active = True
        self.calls = 0
        self.failures = 0
        self.total_time = 0.0
        self.longest_time = 0.0

    def handle(self, event: Contact) -> None:
        """Call the callback if it wants the event; what it raises goes to the logging."""
        try:
            if not self.active or (self.predicate is not None and not self.predicate(event)):
                return
            start = time.perf_counter()
            self.calls += 1
            try:
                self.callback(event)
            finally:
                elapsed = time.perf_counter() - start
                self.total_time += elapsed
                self.longest_time = max(self.longest_time, elapsed)
        except BaseException:  # SystemExit too: it would end this thread and silence all others
            self.failures += 1
            logger.exception("callback %s failed", self.name)


class _Marker:
    """Travels through the queue behind the events that ``flush`` waits for."""

    def __init__(self) -> None:
        self.passed = threading.Event()
        self.handled = False


_Entry = tuple[Contact, tuple[_Subscription, ...]] | _Marker


class Dispatcher:
    """Calls callbacks in the order of events, on one thread that starts when the first comes.

    Callbacks may be late when others are slow. They may publish, subscribe, flush and close.

    Args:
        maxsize: Events that may wait; more are dropped and counted.

    Raises:
        ValueError: A ``maxsize`` below 1.
    """

    def __init__(self, maxsize: int = 1000) -> None:
        if maxsize < 1:
            raise ValueError(f"a queue needs room for at least one event, got maxsize {maxsize}")
        self._maxsize = maxsize
        self._queue: deque[_Entry] = deque()
        self._waiting = 0  # events in the queue, markers not counted
        # Guards all fields, held for single statements only. Re-entrant, for signal handlers.
        self._condition = threading.Condition(threading.RLock())
        self._subscriptions: tuple[_Subscription, ...] = ()
        self._thread: threading.Thread | None = None
        self._dropped = 0
        self._closed = False
        self._abandoned = False
        self._ended = False

    @property
    def dropped(self) -> int:
        """Events that no callback will see: the queue was full, or closed too early."""
        return self._dropped

    def subscribe(
        self, callback: ContactCallback, predicate: ContactPredicate | None = None
    ) -> None:
        """Call ``callback`` for every event published from now on that ``predicate`` accepts.

        Args:
            callback: Takes a contact; its result is ignored.
            predicate: Runs on the dispatcher thread as well. None accepts everything.

        Raises:
            DispatcherClosedError: The dispatcher is closed.
        """
        with self._condition:
            if self._closed:
                raise DispatcherClosedError("the dispatcher is closed: it calls no more callbacks")
            self._subscriptions = (*self._subscriptions, _Subscription(callback, predicate))
            if self._thread is None:
                self._thread = threading.Thread(
                    target=self._run, name="pepper_driver.callbacks", daemon=True
                )
                self._thread.start()

    def unsubscribe(self, callback: ContactCallback) -> None:
        """Stop calling ``callback``, also for events that wait. Does nothing for an unknown one."""
        with self._condition:
            for subscription in self._subscriptions:
                if subscription.callback == callback:
                    subscription.active = False
            self._subscriptions = tuple(s for s in self._subscriptions if s.active)

    def publish(self, event: Contact) -> None:
        """Queue an event for those subscribed now. Never blocks, never raises."""
        with self._condition:
            if not self._subscriptions:
                return
            if self._closed or self._waiting >= self._maxsize:
                self._dropped += 1
                return
            self._queue.append((event, self._subscriptions))
            self._waiting += 1
            self._condition.notify()

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until every event published so far is handled.

        Args:
            timeout: Longest wait [s]; None waits for ever.

        Returns:
            Whether all are handled. Inside a callback False at once: it would wait for itself.
        """
        with self._condition:
            thread = self._thread
            if thread is None:
                return True
            if thread is threading.current_thread():
                return False
            if self._ended or self._abandoned:
                return not self._abandoned
            marker = _Marker()
            self._queue.append(marker)
            self._condition.notify()
        marker.passed.wait(timeout)
        return marker.handled

    def close(self, timeout: float | None = None) -> bool:
        """Take no more events, handle those that wait, end the thread. Does nothing when closed.

        Args:
            timeout: Longest wait [s]; then the events that still wait are dropped, and the callback
                that runs is left to itself. None waits for ever.

        Returns:
            Whether the thread has ended. Inside a callback False at once: it ends afterwards.
        """
        with self._condition:
            self._closed = True
            thread = self._thread
            self._condition.notify()
        if thread is None:
            return True
        if thread is threading.current_thread():
            return False
        thread.join(timeout)
        if not thread.is_alive():
            return True
        with self._condition:
            self._abandoned = True
            self._dropped += self._waiting
            self._waiting = 0
            for entry in self._queue:
                if isinstance(entry, _Marker):
                    entry.passed.set()
            self._queue.clear()
            self._condition.notify()
        return False

    def statistics(self) -> tuple[CallbackStatistics, ...]:
        """Counts and times of every subscription, in the order they were made."""
        return tuple(
            CallbackStatistics(
                name=s.name,
                calls=s.calls,
                failures=s.failures,
                total_time=s.total_time,
                longest_time=s.longest_time,
            )
            for s in self._subscriptions
        )

    def _run(self) -> None:
        while True:
            with self._condition:
                while not self._queue:
                    if self._closed:
                        self._ended = True
                        return
                    self._condition.wait()
                entry = self._queue.popleft()
                if not isinstance(entry, _Marker):
                    self._waiting -= 1
            if isinstance(entry, _Marker):
                entry.handled = True
                entry.passed.set()
                continue
            event, subscriptions = entry
            for subscription in subscriptions:
                if not self._abandoned:
                    subscription.handle(event)


def contact_filter(
    robot: RobotConfig,
    *,
    link: str | None = None,
    joint: str | None = None,
    kind: Kind | None = None,
    phase: Phase | None = "begin",
    min_intensity: float = 0.0,
) -> ContactPredicate:
    """A predicate that picks contacts; every name is checked here, not when the contact comes.

    Args:
        robot: Whose links and joints are meant.
        link: Only contacts on this link.
        joint: Only contacts felt by this joint.
        kind: Only this kind. None takes contacts and collisions: a rebound is no touch.
        phase: Only this phase. None takes all.
        min_intensity: Only contacts of at least this intensity [deg].

    Raises:
        UnknownNameError: No such link, joint, kind or phase.
        ValueError: An intensity that is negative or not a number.
    """
    for what, name, known in (
        ("link", link, robot.links),
        ("joint", joint, robot.joint_names),
        ("kind of contact", kind, get_args(Kind)),
        ("phase of a contact", phase, get_args(Phase)),
    ):
        if name is not None and name not in known:
            raise UnknownNameError(what, name, known)
    if math.isnan(min_intensity) or min_intensity < 0:
        raise ValueError(f"min_intensity must be an angle [deg] of 0 or more, got {min_intensity}")

    def wanted(contact: Contact) -> bool:
        return (
            (link is None or contact.link == link)
            and (joint is None or contact.joint == joint)
            and (contact.kind == kind if kind is not None else contact.kind != "rebound")
            and (phase is None or contact.phase == phase)
            and contact.intensity >= min_intensity
        )

    return wanted
