"""What was changed on a robot, and has to be as it was before."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from pepper_driver.backends.interface import NotConnectedError
from pepper_driver.backends.naoqi.connection import (
    CallTimeoutError,
    Connection,
    MissingServiceError,
    ServiceError,
)
from pepper_driver.config import PepperError

logger = logging.getLogger("pepper_driver")

ALIVE = 0.3
"""[s] in which a robot that does not hang answers the simplest of questions. A program that ends cannot wait longer."""


@dataclass(frozen=True, kw_only=True)
class _Change:
    """Undone by calling ``method`` of ``service``; ``text`` says what that gives back."""

    text: str
    service: str
    method: str
    arguments: tuple[object, ...]
    timeout: float


class Restoration:
    """Changes in their order, undone in reverse."""

    def __init__(self) -> None:
        self._changes: list[_Change] = []

    def note(
        self, text: str, service: str, method: str, *arguments: object, timeout: float
    ) -> None:
        """How a change is undone. To be said before it is made: what is half done is undone too.

        Args:
            text: What is given back, for people.
            service: That does it.
            method: Of the service.
            arguments: For the method.
            timeout: How long it may take [s].
        """
        change = _Change(
            text=text, service=service, method=method, arguments=arguments, timeout=timeout
        )
        self._changes.append(change)

    def undo(self, connection: Connection) -> tuple[str, ...]:
        """Undo all, each whether or not another fails, and forget them; returns what could not be undone.

        A robot that hangs, or is gone, is not waited for. Raises nothing.
        """
        left = []
        answers = _alive(connection)
        for change in reversed(self._changes):
            if not answers:
                left.append(change.text)
                continue
            try:
                connection.call(
                    change.service, change.method, *change.arguments, timeout=change.timeout
                )
            except PepperError as error:
                left.append(change.text)
                logger.warning("not given back: %s (%s)", change.text, error)
                answers = not isinstance(error, CallTimeoutError | NotConnectedError) or _alive(
                    connection
                )
        self._changes.clear()
        if left:
            logger.error(
                "'%s': NAOqi did not get back: %s; restart the robot to have it as it was",
                connection.address.uri,
                ", ".join(left),
            )
        return tuple(left)


def _alive(connection: Connection) -> bool:
    try:
        connection.call("ALMotion", "robotIsWakeUp", timeout=ALIVE)
    except (MissingServiceError, ServiceError):
        return True
    except PepperError:
        return False
    return True
