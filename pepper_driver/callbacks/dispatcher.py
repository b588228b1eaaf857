"""Queues of events, and a thread for each callback: a slow or broken one delays neither the tick nor others."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from queue import SimpleQueue
from typing import Any, NamedTuple

from pepper_driver.callbacks.events import EndEvent

logger = logging.getLogger("pepper_driver")

QUEUE = 1000
"""Events that may wait for one callback; ticks of 12 s."""


class Subscription(NamedTuple):
    """Choice of events.

    Attributes:
        event: Type of the events.
        predicate: Picks among them, inside the tick: quick, and without code of the user.
        queue: Events that may wait for their receiver; one that comes then is dropped.
    """

    event: type
    predicate: Callable[[Any], bool] = lambda _: True
    queue: int = QUEUE


@dataclass(kw_only=True)
class CallbackStatistics:
    """Calls and lost events of one callback.

    Attributes:
        name: Qualified name of the callback.
        calls: Number of calls.
        failures: Number of calls that raised.
        dropped: Events that the callback did not get: too many waited for it, or it was closed before it came to them.
        total_time: Time of all calls, and of logging what they raised [s].
        max_time: Time of the longest [s].
    """

    name: str
    calls: int = 0
    failures: int = 0
    dropped: int = 0
    total_time: float = 0.0
    max_time: float = 0.0


class EventSink:
    """Queue of the events that wait for one receiver. Filled inside the tick, without a lock.

    Args:
        name: Name of the receiver, for a warning.
        wake: Wakes the receiver. Called after each event, on a thread of the dispatcher; must not raise.

    Attributes:
        events: Oldest first.
        dropped: Number of events that the receiver does not get.
    """

    def __init__(self, name: str, wake: Callable[[], object]) -> None:
        self.name, self.wake = name, wake
        self.events: deque[object] = deque()
        self.dropped, self._warned = 0, False

    def put(self, event: object, limit: int) -> bool:
        """Queue an event; drop it and return False where ``limit`` wait already."""
        if len(self.events) >= limit:
            self.dropped += 1
            return False
        self.events.append(event)
        return True

    def take(self) -> object:
        """Return the oldest event, or None if no event waits; warn once of dropped ones."""
        if self.dropped and not self._warned:
            self._warned = True
            logger.warning("%s is too slow: it has lost events", self.name)
        events = self.events  # may be replaced meanwhile
        return events.popleft() if events else None

    def clear(self) -> None:
        """Drop the events that wait."""
        events, self.events = self.events, deque()
        self.dropped += len(events)


class _Worker(threading.Thread):
    """Thread that does one job after the other. As a daemon it does not keep the program alive."""

    def __init__(self, name: str) -> None:
        threading.Thread.__init__(self, name=name, daemon=True)
        self.jobs: SimpleQueue[Callable[[], object] | None] = SimpleQueue()  # None is the last
        self.start()

    def run(self) -> None:
        for job in iter(self.jobs.get, None):
            job()


class _CallbackThread(_Worker, EventSink):
    """Calls one callback, one event after the other."""

    def __init__(self, callback: Callable[[Any], object]) -> None:
        name = getattr(callback, "__qualname__", None) or type(callback).__name__
        _Worker.__init__(self, f"callback {name}")
        EventSink.__init__(self, self.name, lambda: self.jobs.put(self._call))
        self.callback, self.statistics = callback, CallbackStatistics(name=name)

    def _call(self) -> None:
        event, statistics, start = self.take(), self.statistics, time.perf_counter()
        if event is None:  # dropped meanwhile
            return
        try:
            self.callback(event)
        except BaseException:  # SystemExit too: it would end the thread
            statistics.failures += 1
            logger.exception("%s failed", self.name)
        elapsed = time.perf_counter() - start
        statistics.calls += 1
        statistics.total_time += elapsed
        statistics.max_time = max(statistics.max_time, elapsed)


class Dispatcher:
    """Distribution of events to the receivers that have subscribed to their types. Starts at once.

    A callback gets its events in order and never runs twice at a time, even when it is subscribed to several types.
    Callbacks may publish, subscribe, flush and close; signal handlers may publish.

    The tick queues an event for each receiver and wakes one thread, which wakes the receivers: to wake a thread costs
    several microseconds.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # re-entrant, for signal handlers
        self._callbacks: tuple[_CallbackThread, ...] = ()
        # Replaced, never changed: a tick reads it without the lock.
        self._routes: tuple[tuple[Subscription, EventSink], ...] = ()
        self._closed = False
        self._waker = _Worker("callbacks")

    def subscribe(self, callback: Callable[[Any], object], subscription: Subscription) -> None:
        """Call a callback for the events of a subscription from now on. Does nothing when closed."""
        with self._lock:
            if self._closed:
                return
            sink = next((one for one in self._callbacks if one.callback == callback), None)
            if sink is None:
                sink = _CallbackThread(callback)
                self._callbacks += (sink,)
            self._routes += ((subscription, sink),)

    @contextmanager
    def attached(self, sink: EventSink, *subscriptions: Subscription) -> Iterator[None]:
        """Put the events of subscriptions into a sink inside this block; when closed, an EndEvent at once."""
        with self._lock:
            self._routes += tuple((subscription, sink) for subscription in subscriptions)
            if self._closed:
                sink.put(EndEvent(), 1)
        try:
            yield
        finally:
            with self._lock:
                self._routes = tuple(route for route in self._routes if route[1] is not sink)

    def has_receiver(self, event: type) -> bool:
        """Return whether events of a type have a receiver; others need not be made."""
        return any(subscription.event is event for subscription, _ in self._routes)

    def publish(self, event: object) -> None:
        """Hand an event to its receivers. Never waits, never raises."""
        for subscription, sink in self._routes:
            if subscription.event is type(event):
                try:
                    if subscription.predicate(event) and sink.put(event, subscription.queue):
                        self._waker.jobs.put(sink.wake)
                except Exception:  # a field of a wrong type, from an observer of another package
                    logger.exception("an event is lost: %r", event)

    def flush(self, timeout: float = threading.TIMEOUT_MAX) -> bool:
        """Wait until the callbacks have handled every event published so far.

        Args:
            timeout: Longest wait for all callbacks together [s].

        Returns:
            Whether all are handled. False at once when closed, and inside a callback, which would wait for itself.
        """
        end, handled = time.monotonic() + timeout, threading.Semaphore(0)
        with self._lock:
            if self._closed or self.inside_callback():
                return False
            callbacks = self._callbacks
            for callback in callbacks:
                self._waker.jobs.put(partial(callback.jobs.put, handled.release))
        return all([handled.acquire(timeout=end - time.monotonic()) for _ in callbacks])

    def close(self, timeout: float = threading.TIMEOUT_MAX) -> bool:
        """Take no more events, handle those that wait, end the threads.

        Args:
            timeout: Longest wait for all callbacks together [s]; then the events that still wait are dropped, and
                callbacks that run are left to themselves.

        Returns:
            Whether all threads have ended. Inside a callback False at once: they end afterwards.
        """
        end = time.monotonic() + timeout
        with self._lock:
            if not self._closed:
                self.publish(EndEvent())
                self._closed, self._routes = True, ()
                for callback in self._callbacks:
                    self._waker.jobs.put(partial(callback.jobs.put, None))
                self._waker.jobs.put(None)
        if self.inside_callback():
            return False
        for thread in (self._waker, *self._callbacks):
            thread.join(end - time.monotonic())
        hanging = [callback for callback in self._callbacks if callback.is_alive()]
        for callback in hanging:
            callback.clear()
        return not hanging

    def inside_callback(self) -> bool:
        """Return whether the calling thread is that of a callback."""
        return threading.current_thread() in self._callbacks

    def statistics(self) -> tuple[CallbackStatistics, ...]:
        """Return the present counts and times of every callback, in the order of their first subscription."""
        return tuple(replace(one.statistics, dropped=one.dropped) for one in self._callbacks)
