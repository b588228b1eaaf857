"""Hands events to user callbacks and to others that wait for them, from inside the tick."""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pepper_driver.callback_thread import CallbackStatistics, CallbackThread, Deadline
from pepper_driver.config import PepperError
from pepper_driver.events import Event

logger = logging.getLogger("pepper_driver")

QUEUE = 1000
"""Events that may wait for one callback; ticks of 12 s."""


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


Offer = Callable[[Any], None]


class Dispatcher:
    """Hands each event to those that want its type.

    A callback sees its events in order and never runs twice at a time, even when it wants events of several types.
    Others neither delay it nor cost it an event. Callbacks may publish, subscribe, flush and close.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()  # re-entrant, for signal handlers
        self._threads: tuple[CallbackThread, ...] = ()
        # By type: whose each offer is, and the offer. Replaced, never changed: a tick that publishes needs no lock.
        self._offers: dict[type[Event], tuple[tuple[object, Offer], ...]] = {}
        self._closed = False

    def subscribe(self, subscription: Subscription) -> None:
        """Call a callback for every event from now on that the subscription wants.

        Raises:
            DispatcherClosedError: The dispatcher is closed.
        """
        with self._lock:
            self._check_open()
            callback = subscription.callback
            thread = next((t for t in self._threads if t.callback == callback), None)
            if thread is None:
                thread = CallbackThread(callback)
                self._threads = (*self._threads, thread)
            wanted, limit, put = subscription.wanted, subscription.queue, thread.put

            def offer(event: Event) -> None:
                if wanted(event):
                    put(event, limit)

            self._add(thread, subscription.event, offer)

    def attach(self, receiver: Receiver, *events: type[Event]) -> None:
        """Offer all events of these types to a receiver from now on.

        Raises:
            DispatcherClosedError: The dispatcher is closed.
        """
        with self._lock:
            self._check_open()
            for event in events:
                self._add(receiver, event, receiver.offer)

    def detach(self, receiver: Receiver) -> None:
        """Offer a receiver nothing more. Does nothing for one that is not attached."""
        with self._lock:
            self._offers = {
                event: tuple(pair for pair in pairs if pair[0] is not receiver)
                for event, pairs in self._offers.items()
            }

    def wants(self, event: type[Event]) -> bool:
        """Whether anybody wants events of a type; others need not be made."""
        return bool(self._offers.get(event))

    def publish(self, event: Event) -> None:
        """Offer an event to all that want its type now. Never waits, never raises."""
        for _, offer in self._offers.get(type(event), ()):
            try:
                offer(event)
            except (
                Exception
            ):  # a field of another type than it should be, from a third party's observer
                logger.exception("an event is lost: %r", event)

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until every event published so far is handled.

        Args:
            timeout: Longest wait for all callbacks together [s]; None waits for ever.

        Returns:
            Whether all are handled. Inside a callback False at once: it would wait for itself.
        """
        threads = self._threads
        if any(thread.current for thread in threads):
            return False
        deadline = Deadline(timeout)
        marks = [(thread, thread.mark()) for thread in threads]
        return all([thread.wait_for(mark, deadline) for thread, mark in marks])

    def close(self, timeout: float | None = None) -> bool:
        """Take no more events, handle those that wait, end the threads. Does nothing when closed.

        Args:
            timeout: Longest wait for all callbacks together [s]; then the events that still wait are dropped, and
                callbacks that run are left to themselves. None waits for ever.

        Returns:
            Whether all threads have ended. Inside a callback False at once: they end afterwards.
        """
        with self._lock:
            if not self._closed:
                self._closed = True
                owners = {id(owner): owner for pairs in self._offers.values() for owner, _ in pairs}
                for owner in owners.values():
                    if isinstance(owner, Receiver):
                        owner.end()
                for thread in self._threads:
                    thread.close()
        if any(thread.current for thread in self._threads):
            return False
        deadline = Deadline(timeout)
        return all([thread.join(deadline) for thread in self._threads])

    def statistics(self) -> tuple[CallbackStatistics, ...]:
        """Counts and times of every callback, in the order they were first subscribed."""
        return tuple(thread.statistics() for thread in self._threads)

    def _check_open(self) -> None:
        if self._closed:
            raise DispatcherClosedError("the run is over: there will be no more events")

    def _add(self, owner: object, event: type[Event], offer: Offer) -> None:
        pairs = (*self._offers.get(event, ()), (owner, offer))
        self._offers = {**self._offers, event: pairs}
