"""Queues of events, and a thread for each callback: a slow or broken one delays neither the tick nor others."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Any, NamedTuple

from pepper_driver.callbacks.events import Event

logger = logging.getLogger("pepper_driver")

QUEUE = 1000
"""Events that may wait for one callback; ticks of 12 s."""


class Subscription(NamedTuple):
    """Choice of events.

    Attributes:
        event: Type of the events.
        predicate: Picks among them inside the tick: quick, and without code of the user.
        queue: Events that may wait for their receiver; one that comes then is dropped.
    """

    event: type[Event]
    predicate: Callable[[Any], bool]
    queue: int = QUEUE


@dataclass(kw_only=True)
class CallbackStatistics:
    """Calls and lost events of one callback.

    Attributes:
        name: Qualified name of the callback.
        calls: Number of calls.
        failures: Number of calls that raised.
        dropped: Events that the callback did not get: too many waited for it, or it was closed before.
        total_time: Time of all calls [s].
        longest_time: Time of the longest call [s].
    """

    name: str
    calls: int = 0
    failures: int = 0
    dropped: int = 0
    total_time: float = 0.0
    longest_time: float = 0.0


class EventSink:
    """Events that wait for one receiver. Filled inside the tick, without a lock; signal handlers may fill it as well.

    Args:
        name: Name of the receiver, for warnings.
        wake: Called for each event, on a thread of the dispatcher, to wake the receiver; must not raise.

    Attributes:
        events: At most as many as the subscription says.
        dropped: Number of events that came while too many waited, or after the end.
        over: No more events will come.
    """

    def __init__(self, name: str, wake: Callable[[_Token], object]) -> None:
        self.name, self.wake = name, wake
        self.events: deque[Event] = deque()
        self.dropped = 0
        self.over = self._warned = False

    def put(self, event: Event, limit: int) -> bool:
        """Queue an event; drop it and return False where ``limit`` wait already, or after the end."""
        if self.over or len(self.events) >= limit:
            self.dropped += 1
            return False
        self.events.append(event)
        return True

    def take(self) -> Event | None:
        """Return the oldest event, or None; warn once of those that were dropped."""
        if self.dropped and not self._warned:
            self._warned = True
            logger.warning("%s is too slow: it has lost events", self.name)
        events = self.events  # may be replaced meanwhile
        return events.popleft() if events else None

    def clear(self) -> None:
        """Drop the events that wait."""
        events, self.events = self.events, deque()
        self.dropped += len(events)


class _CallbackThread(EventSink):
    """Calls one callback, one event after the other."""

    def __init__(self, callback: Callable[[Any], object]) -> None:
        name = getattr(callback, "__qualname__", None) or type(callback).__name__
        self._bell: SimpleQueue[_Token] = SimpleQueue()
        super().__init__(f"callback {name}", self._bell.put)
        self.callback, self.statistics = callback, CallbackStatistics(name=name)
        # A daemon: a callback that hangs does not keep the program alive.
        self.thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while (token := self._bell.get()) is not None:
            if isinstance(token, threading.Semaphore):
                token.release()
            elif (event := self.take()) is not None:
                self._call(event)

    def _call(self, event: Event) -> None:
        statistics, start = self.statistics, time.perf_counter()
        try:
            self.callback(event)
        except BaseException:  # SystemExit too: it would end the thread
            statistics.failures += 1
            logger.exception("%s failed", self.name)
        elapsed = time.perf_counter() - start
        statistics.calls += 1
        statistics.total_time += elapsed
        statistics.longest_time = max(statistics.longest_time, elapsed)


_Token = threading.Semaphore | bool | None
"""Goes to the receivers behind their events: True for an event, a semaphore to be released, None for the end."""


class Dispatcher:
    """Hands each event to the receivers that want it.

    A callback gets its events in order and never runs twice at a time, even when it is subscribed to several types.
    Callbacks may publish, subscribe, flush and close.

    The tick queues an event and wakes one thread, which wakes the receivers: to wake a thread takes several microseconds.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # re-entrant, for signal handlers
        self._callbacks: tuple[_CallbackThread, ...] = ()
        # Replaced, never changed: a tick reads it without the lock.
        self._routes: tuple[tuple[Subscription, EventSink], ...] = ()
        self._wakes: SimpleQueue[tuple[Sequence[EventSink], _Token]] = SimpleQueue()
        self._waker = threading.Thread(target=self._wake, name="callbacks", daemon=True)
        self._waker.start()
        self._closed = False

    def subscribe(self, callback: Callable[[Any], object], subscription: Subscription) -> None:
        """Call a callback for the events of a subscription from now on. Does nothing when closed."""
        with self._lock:
            if self._closed:
                return
            sink = next((known for known in self._callbacks if known.callback == callback), None)
            if sink is None:
                sink = _CallbackThread(callback)
                self._callbacks += (sink,)
            self._routes += ((subscription, sink),)

    @contextmanager
    def attached(self, sink: EventSink, *subscriptions: Subscription) -> Iterator[None]:
        """Put the events of subscriptions into a sink inside this block; when closed, the sink is over."""
        with self._lock:
            sink.over = self._closed
            self._routes += tuple((subscription, sink) for subscription in subscriptions)
        try:
            yield
        finally:
            with self._lock:
                self._routes = tuple(route for route in self._routes if route[1] is not sink)

    def wants(self, event: type[Event]) -> bool:
        """Return whether events of a type have a receiver; others need not be made."""
        return any(subscription.event is event for subscription, _ in self._routes)

    def publish(self, event: Event) -> None:
        """Hand an event to all that want it now. Never waits, never raises."""
        try:
            picked = [
                (sink, subscription.queue)
                for subscription, sink in self._routes
                if subscription.event is type(event) and subscription.predicate(event)
            ]
        except (
            Exception
        ):  # a field of another type than it should be, from a third party's observer
            logger.exception("an event is lost: %r", event)
            return
        sinks = [sink for sink, limit in picked if sink.put(event, limit)]
        if sinks:
            self._wakes.put((sinks, True))

    def flush(self, timeout: float = threading.TIMEOUT_MAX) -> bool:
        """Wait until the callbacks have handled every event published so far. When closed, as :meth:`close`.

        Args:
            timeout: Longest wait for all callbacks together [s].

        Returns:
            Whether all are handled. Inside a callback False at once: it would wait for itself.
        """
        remaining, mark = _countdown(timeout), threading.Semaphore(0)
        with self._lock:
            callbacks, closed = self._callbacks, self._closed
            if not closed:
                self._wakes.put((callbacks, mark))
        if closed or self.inside_callback():
            return closed and self.close(timeout)
        return all([mark.acquire(timeout=remaining()) for _ in callbacks])

    def close(self, timeout: float = threading.TIMEOUT_MAX) -> bool:
        """Take no more events, handle those that wait, end the threads.

        Args:
            timeout: Longest wait for all callbacks together [s]; then the events that still wait are dropped, and
                callbacks that run are left to themselves.

        Returns:
            Whether all threads have ended. Inside a callback False at once: they end afterwards.
        """
        remaining = _countdown(timeout)
        with self._lock:
            if not self._closed:
                self._closed = True
                sinks = tuple(dict.fromkeys(sink for _, sink in self._routes))
                for sink in sinks:
                    sink.over = True
                self._wakes.put((sinks, None))
        if self.inside_callback():
            return False
        self._waker.join(remaining())
        for callback in self._callbacks:
            callback.thread.join(remaining())
            if callback.thread.is_alive():
                callback.clear()
        return not any(callback.thread.is_alive() for callback in self._callbacks)

    def inside_callback(self) -> bool:
        """Return whether the calling thread is that of a callback."""
        return any(known.thread is threading.current_thread() for known in self._callbacks)

    def statistics(self) -> tuple[CallbackStatistics, ...]:
        """Return the present counts and times of every callback, in the order of their first subscription."""
        return tuple(replace(known.statistics, dropped=known.dropped) for known in self._callbacks)

    def _wake(self) -> None:
        token: _Token = True
        while token is not None:
            sinks, token = self._wakes.get()
            for sink in sinks:
                sink.wake(token)


def _countdown(timeout: float) -> Callable[[], float]:
    """Return a function that gives what is left of a time that begins now [s]."""
    end = time.monotonic() + timeout
    return lambda: max(0.0, end - time.monotonic())
