"""One driver at a time: while one drives, it offers a service in the robot's directory, where a name is there but once.

The directory is NAOqi's own. It takes a service out when the connection of its owner ends, also by ``kill -9``.
"""

from __future__ import annotations

import logging
import os
from datetime import UTC, datetime

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.config import PepperError
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock

logger = logging.getLogger("pepper_driver")

NAME = "PepperDriver"

ASK_TIME = 0.3
"""[s] in which another driver on this computer answers. On another computer it cannot be asked."""

ATTEMPTS, RETRY_PERIOD = 4, 0.02
"""To register, and [s] between two of them."""


class SecondDriverError(BackendError):
    """Another program of this package drives the robot."""


class DriverService:
    """Service by which other programs can ask the driving one; nothing of it is secret."""

    def __init__(self) -> None:
        self._since = datetime.now(UTC).isoformat(timespec="seconds")

    def pid(self) -> int:
        """Return the process of the driver, on its computer."""
        return os.getpid()

    def since(self) -> str:
        """Return when it began to drive: UTC, ISO 8601."""
        return self._since


class Presence:
    """The service, registered by :meth:`begin` and unregistered by :meth:`end`.

    Args:
        connection: With the robot.
        force: Drive also where another one does.
        clock: Time between two attempts.
    """

    def __init__(self, connection: Connection, *, force: bool, clock: Clock = SYSTEM_CLOCK) -> None:
        self._connection, self._force, self._clock = connection, force, clock
        self._number: int | None = None

    def begin(self) -> None:
        """Register. A robot that does not allow that is driven all the same, with a warning.

        Raises:
            SecondDriverError: Another program drives it, and this one was not started with the option to take over.
            NotConnectedError: The connection is lost.
        """
        for _ in range(ATTEMPTS):
            try:
                self._number = self._connection.register(NAME, DriverService())
            except BackendError as error:
                refusal = error
            else:
                return
            other = self._other()
            if other is not None:
                self._replace(*other)
                return
            self._clock.sleep(
                RETRY_PERIOD
            )  # NAOqi reserves a name some milliseconds before it lists it
        logger.warning(
            "a second driver would not be noticed, as the robot keeps no service of ours: %s",
            refusal,
        )

    def _replace(self, number: int, text: str) -> None:
        """Replace another driver's service, if the caller asks for it."""
        uri = self._connection.address.uri
        if not self._force:
            raise SecondDriverError(
                f"'{uri}' is driven by another pepper_driver already: {text}; end that program, or add ?force=1 to "
                "drive it all the same"
            )
        logger.warning("'%s' is driven by another pepper_driver as well: %s", uri, text)
        try:
            self._connection.unregister(number, ASK_TIME)
            self._number = self._connection.register(NAME, DriverService())
        except PepperError as error:
            logger.warning("a third driver would not be noticed: %s", error)

    def end(self) -> None:
        """Take the service out. Does nothing where it is not there; raises nothing."""
        number, self._number = self._number, None
        if number is not None:
            try:
                self._connection.unregister(number, ASK_TIME)
            except PepperError as error:  # it ends with the connection
                logger.debug("%s", error)

    def _other(self) -> tuple[int, str] | None:
        """Return the number of the other driver's service and a name of its program; None if there is none."""
        found = [service for service in self._connection.services if service["name"] == NAME]
        if not found:
            return None
        number, pid = int(found[0]["serviceId"]), found[0]["processId"]
        if pid == os.getpid():
            return number, "this very program, by another connection"
        try:
            since = self._connection.call(NAME, "since", timeout=ASK_TIME)
        except PepperError:
            return number, (
                f"process {pid}, which does not answer; it is on another computer, was stopped, or lost its connection "
                "and is forgotten within a minute"
            )
        return number, f"process {pid} of this computer, since {since}"
