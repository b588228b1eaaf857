"""Hands events to user callbacks and to others that wait for them, from inside the tick."""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pepper_driver.callback_thread import CallbackStatistics, CallbackThread
from pepper_driver.config import PepperError
from pepper_driver.events import Event
from pepper_driver.queue_thread import Deadline, QueueThread

logger = logging.getLogger("pepper_driver")

QUEUE = 1000
"""Events that may wait for one callback; ticks of 12 s."""
BACKLOG = 10_000
"""Events that may wait to be handed out; more only if Python runs no other thread for long."""


class DispatcherClosedError(PepperError, RuntimeError):
    """Somebody wants events after ``close``: there will be none."""


@dataclass(frozen=True, kw_only=True)
class Subscription:
    """Which events a callback is called for.

    Attributes:
        callback: Takes an event; its result is ignored.
        event: Type of the events.
        wanted: Picks among them inside the tick: quick, and without code of the user.
        queue: How many events may wait for the callback; one that comes then is dropped.
    """

    callback: Callable[[Any], object]
    event: type[Event]
    wanted: Callable[[Any], bool]
    queue: int = QUEUE


class Receiver(ABC):
    """Takes events inside the tick: in microseconds, without waiting, without raising."""

    @abstractmethod
    def offer(self, event: Event) -> None:
        """Take an event."""

    @abstractmethod
    def end(self) -> None:
        """No more events will come. Called once, from any thread."""


class _Route(NamedTuple):
    """Where events of one type go."""

    wanted: Callable[[Any], bool]
    thread: CallbackThread
    limit: int


_Parcel = tuple[Event, Sequence[_Route]]


class _Distributor(QueueThread[_Parcel]):
    """Puts events into the queues of the callbacks: to wake threads takes time, so the tick wakes only this one."""

    def handle(self, entry: _Parcel) -> None:
        event, routes = entry
        for route in routes:
            route.thread.put(event, route.limit)

    def lose(self, entry: _Parcel) -> None:
        event, routes = entry
        for route in routes:
            route.thread.lose(event)


class Dispatcher:
    """Hands each event to those that want it: receivers at once, callbacks by way of threads.

    A callback sees its events in order and never runs twice at a time, even when it wants events of several types.
    Others neither delay it nor cost it an event. Callbacks may publish, subscribe, flush and close.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # re-entrant, for signal handlers
        self._threads: tuple[CallbackThread, ...] = ()
        self._distributor: _Distributor | None = None  # there once there is a callback
        # By type; replaced, never changed: a tick that publishes needs no lock.
        self._routes: dict[type[Event], tuple[_Route, ...]] = {}
        self._receivers: dict[type[Event], tuple[Receiver, ...]] = {}
        self._closed = False

    def subscribe(self, subscription: Subscription) -> None:
        """Call a callback for every event from now on that the subscription wants.

        Raises:
            DispatcherClosedError: The dispatcher is closed.
        """
        with self._lock:
            self._check_open()
            callback, event = subscription.callback, subscription.event
            thread = next((t for t in self._threads if t.callback == callback), None)
            if thread is None:
                thread = CallbackThread(callback)
                self._threads = (*self._threads, thread)
            if self._distributor is None:
                self._distributor = _Distributor("callbacks")
            route = _Route(subscription.wanted, thread, subscription.queue)
            self._routes = {**self._routes, event: (*self._routes.get(event, ()), route)}

    def attach(self, receiver: Receiver, *events: type[Event]) -> None:
        """Offer all events of these types to a receiver from now on.

        Raises:
            DispatcherClosedError: The dispatcher is closed.
        """
        with self._lock:
            self._check_open()
            added = {event: (*self._receivers.get(event, ()), receiver) for event in events}
            self._receivers = {**self._receivers, **added}

    def detach(self, receiver: Receiver) -> None:
        """Offer a receiver nothing more. Does nothing for one that is not attached."""
        with self._lock:
            self._receivers = {
                event: tuple(one for one in receivers if one is not receiver)
                for event, receivers in self._receivers.items()
            }

    def wants(self, event: type[Event]) -> bool:
        """Whether anybody wants events of a type; others need not be made."""
        return bool(self._routes.get(event) or self._receivers.get(event))

    def publish(self, event: Event) -> None:
        """Hand an event to all that want it now. Never waits, never raises."""
        try:
            for receiver in self._receivers.get(type(event), ()):
                receiver.offer(event)
            routes = [r for r in self._routes.get(type(event), ()) if r.wanted(event)]
        except (
            Exception
        ):  # a field of another type than it should be, from a third party's observer
            logger.exception("an event is lost: %r", event)
            return
        if routes and self._distributor is not None:
            self._distributor.put((event, routes), BACKLOG)

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until every event published so far is handled.

        Args:
            timeout: Longest wait for all callbacks together [s]; None waits for ever.

        Returns:
            Whether all are handled. Inside a callback False at once: it would wait for itself.
        """
        if self._inside():
            return False
        deadline = Deadline(timeout)
        if self._distributor is not None:
            self._distributor.wait_for(self._distributor.mark(), deadline)
        marks = [(thread, thread.mark()) for thread in self._threads]
        return all([thread.wait_for(mark, deadline) for thread, mark in marks])

    def close(self, timeout: float | None = None) -> bool:
        """Take no more events, handle those that wait, end the threads. Does nothing when closed.

        Args:
            timeout: Longest wait for all callbacks together [s]; then the events that still wait are dropped, and
                callbacks that run are left to themselves. None waits for ever.

        Returns:
            Whether all threads have ended. Inside a callback False at once: they end afterwards.
        """
        deadline = Deadline(timeout)
        with self._lock:
            first, self._closed = not self._closed, True
        if first:
            for receiver in {id(r): r for rs in self._receivers.values() for r in rs}.values():
                receiver.end()
            if self._distributor is not None:
                self._distributor.close()
        if self._distributor is not None:  # the user's code does not run there: it ends soon
            self._distributor.join(deadline)
        for thread in self._threads:
            thread.close()
        if self._inside():
            return False
        return all([thread.join(deadline) for thread in self._threads])

    def statistics(self) -> tuple[CallbackStatistics, ...]:
        """Counts and times of every callback, in the order they were first subscribed."""
        return tuple(thread.statistics() for thread in self._threads)

    def _check_open(self) -> None:
        if self._closed:
            raise DispatcherClosedError("the run is over: there will be no more events")

    def _inside(self) -> bool:
        """Whether the caller is a callback."""
        return any(thread.current for thread in self._threads)
