"""A method that is called now and then from the tick, which never waits for its answer."""

from __future__ import annotations

import logging
import time

from pepper_driver.backends.naoqi.library import Answer, Future, Proxy, one_line

logger = logging.getLogger("pepper_driver")

WARNING_PERIOD = 5.0
"""[s] between two warnings about the same call."""


class Call:
    """One method of a service, at most once on its way.

    Args:
        proxy: Of the service.
        method: Its name.
        uri: Of the robot, for messages.
    """

    def __init__(self, proxy: Proxy, method: str, uri: str) -> None:
        self._proxy, self._method, self._what = proxy, method, f"'{uri}': {method}"
        self._future: Future | None = None
        self._warned = -WARNING_PERIOD

    def begin(self, *arguments: object) -> bool:
        """Call it, unless the last call is on its way; returns whether it was called."""
        self.answer()
        if self._future is not None:
            return False
        try:
            self._future = getattr(self._proxy, self._method)(*arguments, _async=True)
        except (RuntimeError, AttributeError) as error:  # connection lost, or no such method
            self._warn(error)
            return False
        return True

    @property
    def over(self) -> bool:
        """True where nothing is on its way."""
        return self._future is None or not self._future.isRunning()

    def answer(self) -> Answer:
        """Return what the last call brought; None while it is on its way, where it failed, and the second time."""
        future = self._future
        if future is None or not self.over:
            return None
        self._future = None
        try:
            return future.value()
        except RuntimeError as error:
            self._warn(error)
            return None

    def _warn(self, error: Exception) -> None:
        if time.monotonic() - self._warned >= WARNING_PERIOD:
            self._warned = time.monotonic()
            logger.warning("%s failed: %s", self._what, one_line(str(error)))
