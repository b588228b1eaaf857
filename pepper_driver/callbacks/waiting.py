"""Waiting for contacts: in a thread, which may tick meanwhile, and in asyncio."""

from __future__ import annotations

import math
import threading
from collections.abc import AsyncGenerator
from contextlib import suppress

from pepper_driver.callbacks.dispatcher import QUEUE, Dispatcher, EventSink, Subscription
from pepper_driver.callbacks.events import EndEvent, FaultEvent, TickEvent
from pepper_driver.callbacks.filters import ContactPredicate, SubscriptionError
from pepper_driver.config.arguments import is_number
from pepper_driver.config.errors import shown
from pepper_driver.observer import Contact
from pepper_driver.session import Session


def wait_for_contact(
    session: Session, predicate: ContactPredicate, timeout: float | None
) -> Contact | None:
    """Wait for the first contact from now on that a predicate picks.

    Args:
        session: Active.
        predicate: Picks contacts.
        timeout: Longest wait [s] on the robot's clock, or on the wall's while no thread ticks; None waits for ever.

    Returns:
        The contact; None after the timeout, or when the robot was closed meanwhile.

    Raises:
        SubscriptionError: The timeout is no time, or there is no observer, which alone could detect a contact.
        FaultError: The robot was stopped.
        BackendError: Called inside a tick.
    """
    if timeout is not None and not (is_number(timeout) and 0 <= timeout < math.inf):
        raise SubscriptionError(
            f"timeout must be a time [s] from 0 up, or None, got {shown(timeout)}"
        )
    loop = session.loop
    if loop.observer is None:
        raise SubscriptionError("without an observer no contact is detected: none can be awaited")
    ticks_here = session.ticks_here()
    end = math.inf if timeout is None else loop.time + timeout - 0.5 * session.cycle
    bell = threading.Semaphore(0)
    sink = EventSink("wait_for_contact()", bell.release)
    with session.dispatcher.attached(
        sink,  # for the first of these; a tick comes behind its contacts
        Subscription(Contact, predicate, 1),
        Subscription(TickEvent, lambda event: event.tick.measurement.time >= end, 1),
        Subscription(FaultEvent, queue=1),
        Subscription(EndEvent, queue=1),
    ):
        session.check_fault()  # a fault from before is published no more
        if ticks_here:
            ticks = math.inf if timeout is None else round(timeout / session.cycle)
            session.run(ticks, until=lambda: bool(sink.events))
        time = -math.inf
        while not (ticks_here or sink.events) and time != loop.time:
            time = loop.time
            bell.acquire(timeout=timeout)
    event = sink.take()
    if isinstance(event, Contact):
        return event
    session.check_fault()
    return None


async def stream_contacts(
    dispatcher: Dispatcher, predicate: ContactPredicate
) -> AsyncGenerator[Contact, None]:
    """Yield contacts from the first step on, until the robot is closed or stopped; what waits then still comes.

    At most ``QUEUE`` of them wait; those that come then are lost, and a warning says so.
    """
    import asyncio  # slow: only programs that use it need it

    loop, woken = asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        with suppress(RuntimeError):  # the event loop is closed
            loop.call_soon_threadsafe(woken.set)

    sink = EventSink("'async for contact in contacts()'", wake)
    ends = [Subscription(event, queue=QUEUE + 1) for event in (FaultEvent, EndEvent)]
    with dispatcher.attached(sink, Subscription(Contact, predicate), *ends):
        while True:
            event = sink.take()
            if isinstance(event, Contact):
                yield event
            elif event is not None:
                return
            else:
                await woken.wait()
                woken.clear()
