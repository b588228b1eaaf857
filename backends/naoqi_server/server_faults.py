"""What can be wrong with NAOqi itself: every call of a client passes here."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar

from pepper_driver.backends.interface import BackendError
from pepper_driver.config import UnknownNameError

Proceed = Callable[[], Any]


class ServerFault:
    """Something wrong; made as ``Kind(**arguments)`` by ``setFault(name, arguments)``. ValueError: they are wrong."""

    def call(self, service: str, method: str, proceed: Proceed) -> Any:  # noqa: ANN401
        """Answer a call in place of the service, or ``proceed`` to it. An exception is the client's error."""
        return proceed()


class Slow(ServerFault):
    """``slow``: calls of a method take ``seconds`` more."""

    def __init__(self, service: str, method: str, seconds: float) -> None:
        self._name, self._seconds = (service, method), float(seconds)

    def call(self, service: str, method: str, proceed: Proceed) -> Any:  # noqa: ANN401
        """Wait, then call."""
        if (service, method) == self._name:
            time.sleep(self._seconds)
        return proceed()


class ServerFaults:
    """The faults that are on. Calls of the service ``StandIn`` pass untouched, so that they can be cleared."""

    KINDS: ClassVar[dict[str, Callable[..., ServerFault]]] = {"slow": Slow}
    """By name; one line for each."""

    def __init__(self) -> None:
        self._on: dict[str, ServerFault] = {}

    def set(self, name: str, arguments: Mapping[str, Any]) -> None:
        """Switch one on, or change how.

        Raises:
            UnknownNameError: No such fault.
            BackendError: Arguments that it does not take.
        """
        if name not in self.KINDS:
            raise UnknownNameError("fault", name, self.KINDS)
        try:
            fault = self.KINDS[name](**arguments)
        except (TypeError, ValueError) as error:
            raise BackendError(f"fault '{name}': {error}") from error
        self._on = {**self._on, name: fault}  # calls on other threads go through the old ones

    def clear(self) -> None:
        """All well again."""
        self._on = {}

    def call(self, service: str, method: str, proceed: Proceed) -> Any:  # noqa: ANN401
        """Answer a call, through all that is on."""
        if service != "StandIn":
            for fault in self._on.values():
                proceed = partial(fault.call, service, method, proceed)
        return proceed()
