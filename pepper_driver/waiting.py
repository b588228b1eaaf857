"""Waits for a contact: by running the robot, or while another thread runs it."""

from __future__ import annotations

import threading
from itertools import count

from pepper_driver.callbacks import Receiver
from pepper_driver.events import Event, FaultEvent, TickEvent
from pepper_driver.filters import ContactFilter, ListeningError
from pepper_driver.observer import Contact
from pepper_driver.safety import Fault, FaultError
from pepper_driver.session import Session


def wait_for_contact(
    session: Session, wanted: ContactFilter, timeout: float | None
) -> Contact | None:
    """The first contact from now on that ``wanted`` picks.

    The thread that activated the robot runs it meanwhile, unless another one does; all others wait for the ticks that
    somebody runs, over any number of runs.

    Args:
        session: Active.
        wanted: Picks contacts.
        timeout: Longest wait [s] on the robot's clock, or on the wall's while nobody runs it; None waits for ever.

    Returns:
        The contact; None after the timeout, or when the robot was closed meanwhile.

    Raises:
        ListeningError: There is no observer, which alone could feel one.
        FaultError: The robot was stopped.
        BackendError: Called inside a tick, which would wait for itself.
    """
    if not session.feels:
        raise ListeningError("without an observer no contact is felt: waiting for one has no end")
    runs_here = session.runner.is_mine()
    end = None if timeout is None else session.loop.time + timeout - 0.5 * session.cycle
    waiter = _Waiter(wanted, end)
    session.dispatcher.attach(waiter, Contact, TickEvent, FaultEvent)
    try:
        session.check_fault()  # one that came before the waiter is told by nobody
        if runs_here:
            ticks = count() if timeout is None else range(round(timeout / session.cycle))
            session.run(ticks, None, lambda _: waiter.over.is_set())
        else:
            waiter.wait(timeout)
    finally:
        session.dispatcher.detach(waiter)
    return waiter.result()


class _Waiter(Receiver):
    """Takes the first contact up to ``end`` on the robot's clock."""

    def __init__(self, wanted: ContactFilter, end: float | None) -> None:
        self._wanted = wanted
        self._end = end
        self._ticks = 0
        self._contact: Contact | None = None
        self._fault: Fault | None = None
        self.over = threading.Event()

    def offer(self, event: Event) -> None:
        """Take an event; a tick comes behind its contacts."""
        if self.over.is_set():
            return
        if isinstance(event, Contact):
            if not self._wanted(event):
                return
            self._contact = event
        elif isinstance(event, FaultEvent):
            self._fault = event.fault
        elif isinstance(event, TickEvent):
            self._ticks += 1
            if self._end is None or event.tick.measurement.time < self._end:
                return
        self.over.set()

    def end(self) -> None:
        """The robot was closed."""
        self.over.set()

    def wait(self, timeout: float | None) -> None:
        """Wait until it is over, or until nobody has run the robot for ``timeout`` [s] of the wall's clock."""
        seen = -1
        while self._ticks != seen:
            seen = self._ticks
            if self.over.wait(timeout):
                return

    def result(self) -> Contact | None:
        """The contact, if there was one.

        Raises:
            FaultError: The robot was stopped.
        """
        if self._fault is not None:
            raise FaultError(self._fault)
        return self._contact
