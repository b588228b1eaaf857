"""Contacts for asyncio: filled by the tick's thread, emptied by the event loop's."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import suppress

from pepper_driver.callbacks import QUEUE, Dispatcher, DispatcherClosedError, Receiver
from pepper_driver.events import Event, FaultEvent
from pepper_driver.filters import ContactFilter
from pepper_driver.observer import Contact

logger = logging.getLogger("pepper_driver")


async def stream_contacts(
    dispatcher: Dispatcher, wanted: ContactFilter
) -> AsyncGenerator[Contact, None]:
    """Contacts from the first step on, until the robot is closed or stopped; what waits then still comes.

    At most ``QUEUE`` of them wait; those that come then are lost, and a warning says so.
    """
    stream = _Stream(wanted, asyncio.get_running_loop())
    try:
        dispatcher.attach(stream, Contact, FaultEvent)
    except DispatcherClosedError:
        return
    try:
        while (contact := await stream.next()) is not None:
            yield contact
    finally:
        dispatcher.detach(stream)


class _Stream(Receiver):
    """A bounded queue between two threads, of which one must not wait and the other must not block."""

    def __init__(self, wanted: ContactFilter, loop: asyncio.AbstractEventLoop) -> None:
        self._wanted = wanted
        self._loop = loop
        self._contacts: deque[Contact] = deque()
        self._lock = threading.RLock()  # held for single statements only
        self._ended = self._lost = False
        self._waking = False  # one call that waits in the event loop is enough
        self._woken = asyncio.Event()  # belongs to the event loop's thread

    def offer(self, event: Event) -> None:
        """Queue a contact; a fault is the last thing to hear of."""
        if isinstance(event, FaultEvent):
            self.end()
        elif isinstance(event, Contact) and self._wanted(event):
            with self._lock:
                if len(self._contacts) < QUEUE:
                    self._contacts.append(event)
                else:
                    self._lost = True
            self._wake()

    def end(self) -> None:
        """Nothing more will come."""
        self._ended = True
        self._wake()

    async def next(self) -> Contact | None:
        """The next contact; None behind the last one."""
        while True:
            self._woken.clear()
            ended = self._ended  # before the last look: what came before the end is not lost
            with self._lock:
                lost, self._lost = self._lost, False
                contact = self._contacts.popleft() if self._contacts else None
            if lost:
                logger.warning("'async for contact in contacts()' is too slow: it has lost events")
            if contact is not None or ended:
                return contact
            await self._woken.wait()

    def _wake(self) -> None:
        if not self._waking:
            self._waking = True
            with suppress(RuntimeError):  # the event loop is closed: nobody listens any more
                self._loop.call_soon_threadsafe(self._awake)

    def _awake(self) -> None:
        self._waking = False
        self._woken.set()
