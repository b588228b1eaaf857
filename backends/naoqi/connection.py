"""A connection with NAOqi: calls with a time-out, errors of this project, and a word when it is lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pepper_driver.backends.interface import BackendError, NotConnectedError
from pepper_driver.backends.naoqi.address import Address
from pepper_driver.backends.naoqi.library import load_qi
from pepper_driver.backends.naoqi.secret import Secret

CONNECT_TIME = 3.0
"""[s] a robot may take to answer."""

CALL_TIME = 2.0
"""[s] a call off the tick may take."""


class ServiceError(BackendError):
    """A service of the robot refused what it was asked; the message holds its reason."""


class CallTimeoutError(BackendError, TimeoutError):
    """A service of the robot gave no answer in time."""


class MissingServiceError(BackendError, LookupError):
    """The robot has no such service."""


class Connection:
    """With one NAOqi. Made by :func:`connect`; it does not come back: a new one is made after a loss.

    Calls come from any thread. ``service`` gives what the tick needs, which must call it with ``_async=True`` alone.
    """

    def __init__(self, address: Address, session: Any, on_lost: Callable[[], None] | None) -> None:  # noqa: ANN401
        self.address = address
        self._session = session
        self._on_lost = on_lost
        self._closing = False
        self._services: dict[str, Any] = {}
        session.disconnected.connect(self._lost)

    @property
    def connected(self) -> bool:
        """Whether the link stands, as far as the library has noticed. A robot that hangs counts as connected."""
        return not self._closing and bool(self._session.isConnected())

    @property
    def service_names(self) -> frozenset[str]:
        """Names of all services."""
        found = self._wait(self._session.services(_async=True), "list of services", CALL_TIME)
        return frozenset(service["name"] for service in found)

    def service(self, name: str, timeout: float = CALL_TIME) -> Any:  # noqa: ANN401
        """The proxy of a service.

        Raises:
            MissingServiceError: The robot has none of this name.
            CallTimeoutError: No answer in ``timeout`` [s].
            NotConnectedError: The connection is lost.
        """
        if name not in self._services:
            self._services[name] = self._wait(
                self._session.service(name, _async=True), name, timeout
            )
        return self._services[name]

    def call(self, service: str, method: str, *arguments: Any, timeout: float = CALL_TIME) -> Any:  # noqa: ANN401
        """The answer of a service; waits at most ``timeout`` [s].

        Raises:
            ServiceError: The service refuses.
            MissingServiceError: There is no such service or method.
            CallTimeoutError: No answer in time.
            NotConnectedError: The connection is lost.
        """
        proxy = self.service(service, timeout)
        what = f"{service}.{method}"
        try:
            future = getattr(proxy, method)(*arguments, _async=True)
        except AttributeError as error:
            raise MissingServiceError(f"'{self.address.uri}' has no {what}") from error
        return self._wait(future, what, timeout)

    def close(self) -> None:
        """Disconnect; ``on_lost`` is not called."""
        self._closing = True
        self._session.close()

    def _lost(self, *_: object) -> None:
        if not self._closing and self._on_lost is not None:
            self._on_lost()

    def _wait(self, future: Any, what: str, timeout: float) -> Any:  # noqa: ANN401
        """The value of a future, or one of the project's errors."""
        qi = load_qi()
        if future.wait(round(timeout * 1000)) == qi.FutureState.Running:
            raise CallTimeoutError(f"'{self.address.uri}': {what} gave no answer in {timeout:g} s")
        try:
            return future.value()
        except RuntimeError as error:
            reason = str(error).strip().partition("\n")[0]
            if not self._session.isConnected():
                raise NotConnectedError(
                    f"'{self.address.uri}': the connection was lost at {what}"
                ) from error
            if "Cannot find service" in reason:
                raise MissingServiceError(f"'{self.address.uri}' has no service {what}") from error
            raise ServiceError(f"'{self.address.uri}': {what} refused: {reason}") from error


def connect(
    address: Address, secret: Secret | None = None, on_lost: Callable[[], None] | None = None
) -> Connection:
    """Connect with the NAOqi at ``address``.

    Args:
        address: Where it is.
        secret: Password of ``address.user``, for TLS; see :func:`~pepper_driver.backends.naoqi.secret.find_secret`.
        on_lost: Called once, on a thread of the library, when the link is lost.

    Raises:
        NotConnectedError: Nobody there, nobody answers, no NAOqi, TLS on one side alone, or a wrong password.
        NoQiError: No library.
    """
    qi = load_qi()
    session = qi.Session()
    future = session.connect(address.url, _async=True)
    state = future.wait(round(CONNECT_TIME * 1000))
    if state == qi.FutureState.Running or future.hasError():
        session.close()
        raise NotConnectedError(f"'{address.uri}': no connection")
    return Connection(address, session, on_lost)
