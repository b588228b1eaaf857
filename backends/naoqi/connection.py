"""A connection with NAOqi: calls with a time-out, errors of this project, and a word when it is lost."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

from pepper_driver.backends.interface import BackendError, NotConnectedError
from pepper_driver.backends.naoqi.address import Address
from pepper_driver.backends.naoqi.library import (
    Answer,
    Future,
    Proxy,
    Session,
    load_qi,
    one_line,
)
from pepper_driver.backends.naoqi.peer import check_listening, refusal
from pepper_driver.backends.naoqi.secret import Secret
from pepper_driver.backends.signals import check_signals
from pepper_driver.config import NaoqiSettings, load_naoqi_settings

logger = logging.getLogger("pepper_driver")

LOOK = 0.05
"""[s] between two looks at a call: while the library waits, Python hears no Ctrl-C."""


class ServiceError(BackendError):
    """A service of the robot refused what it was asked.

    Attributes:
        reason: What it says; the message holds it too.
    """

    def __init__(self, message: str, reason: str = "") -> None:
        self.reason = reason
        super().__init__(message)


class CallTimeoutError(BackendError, TimeoutError):
    """A service of the robot gave no answer in time. It may still do as it was told."""


class MissingServiceError(BackendError, LookupError):
    """The robot has no such service, or the service no such method."""


class Connection:
    """With one NAOqi, made by :func:`connect`. Once lost it does not come back; make another.

    All methods may be called from any thread, but not from the tick: they wait. The tick takes ``service`` once, and
    then calls its methods with ``_async=True``.

    Attributes:
        address: Where the robot is.
        call_time: How long a call may take, where nothing else is said [s].
    """

    def __init__(
        self,
        address: Address,
        session: Session,
        on_lost: Callable[[], None] | None,
        call_time: float,
    ) -> None:
        self.address = address
        self.call_time = call_time
        self._qi = load_qi()
        self._session = session  # services do not keep it alive
        self._on_lost = on_lost
        self._closed = False
        self._services: dict[str, Proxy] = {}
        session.disconnected.connect(self._lost)

    @property
    def connected(self) -> bool:
        """Whether the link stands, as far as the library noticed.

        It notices at once that the robot's program ended, after 10 s that a network was cut, never that a robot hangs.
        """
        return not self._closed and bool(self._session.isConnected())

    @property
    def services(self) -> list[Mapping[str, Any]]:
        """All services, as the robot's directory has them: ``name``, ``serviceId``, ``processId`` and more."""
        return list(self._wait(lambda: self._session.services(_async=True), "its services", None))

    @property
    def service_names(self) -> frozenset[str]:
        """Names of all services."""
        return frozenset(service["name"] for service in self.services)

    def register(self, name: str, service: object) -> int:
        """Offer a service to other programs of the robot; returns its number.

        The library then listens at a port of this computer that others cannot reach. The service is gone with the
        connection.

        Raises:
            ServiceError: There is one of this name already, or the robot allows none.
            CallTimeoutError: No answer in time.
            NotConnectedError: The connection is lost.
        """
        what = f"registering {name}"
        return int(
            self._wait(
                lambda: self._session.registerService(name, service, _async=True), what, None
            )
        )

    def unregister(self, number: int, timeout: float | None = None) -> None:
        """Take a service out again.

        Raises:
            ServiceError: There is none of this number.
            CallTimeoutError: No answer in ``timeout`` [s].
            NotConnectedError: The connection is lost.
        """
        what = f"unregistering service {number}"
        self._wait(lambda: self._session.unregisterService(number, _async=True), what, timeout)

    def service(self, name: str, timeout: float | None = None) -> Proxy:
        """The proxy of a service, as ``qi`` makes it: its errors are RuntimeErrors.

        Raises:
            MissingServiceError: The robot has none of this name.
            CallTimeoutError: No answer in ``timeout`` [s].
            NotConnectedError: The connection is lost.
        """
        if name not in self._services:
            self._services[name] = self._wait(
                lambda: self._session.service(name, _async=True), name, timeout
            )
        return self._services[name]

    def call(
        self, service: str, method: str, *arguments: object, timeout: float | None = None
    ) -> Answer:
        """What a method of a service answers.

        Args:
            service: Its name.
            method: The method's.
            arguments: Plain Python values; ``tolist()`` those of NumPy.
            timeout: How long it may take [s], by default ``call_time``.

        Raises:
            ServiceError: The service refuses.
            MissingServiceError: There is no such service or method.
            CallTimeoutError: No answer in time.
            NotConnectedError: The connection is lost.
        """
        proxy = self.service(service, timeout)
        return self._wait(
            lambda: getattr(proxy, method)(*arguments, _async=True), f"{service}.{method}", timeout
        )

    def begin(self, service: str, method: str, *arguments: object) -> None:
        """Call a method of a service and do not wait for its end: what it refuses is logged.

        Raises:
            MissingServiceError: There is no such service or method.
            CallTimeoutError: The robot does not say whether there is one.
            NotConnectedError: The connection is lost.
        """
        what = f"'{self.address.uri}': {service}.{method}"
        proxy = self.service(service)
        if not self.connected:
            raise NotConnectedError(f"{what}: not connected any more")
        try:
            future = getattr(proxy, method)(*arguments, _async=True)
        except AttributeError as error:
            raise MissingServiceError(f"{what}: this robot has none") from error

        def ended(future: Future) -> None:
            if future.hasError() and not self._closed:
                logger.warning("%s failed: %s", what, one_line(future.error()))

        future.addCallback(ended)

    def close(self) -> None:
        """Disconnect. ``on_lost`` is not called."""
        if not self._closed:
            self._closed = True
            self._session.close()

    def _lost(self, *_: object) -> None:
        if not self._closed and self._on_lost is not None:
            self._on_lost()

    def _wait(self, start: Callable[[], Future], what: str, timeout: float | None) -> Answer:
        """The value of the future that ``start`` gives."""
        limit = self.call_time if timeout is None else timeout
        uri = self.address.uri
        if not self.connected:
            raise NotConnectedError(f"'{uri}': not connected any more, so no {what}")
        try:
            future = start()
            in_time = finished(future, limit)
            value = future.value() if in_time else None
        except AttributeError as error:
            raise MissingServiceError(f"'{uri}': this robot has no {what}") from error
        except RuntimeError as error:
            reason = one_line(str(error))
            if not self.connected:
                raise NotConnectedError(f"'{uri}': the connection was lost at {what}") from error
            if "Cannot find service" in reason:
                raise MissingServiceError(f"'{uri}': this robot has no service {what}") from error
            raise ServiceError(f"'{uri}': {what} refused: {reason}", reason) from error
        if not in_time:
            raise CallTimeoutError(f"'{uri}': {what} gave no answer in {limit:g} s")
        return value


def finished(future: Future, timeout: float) -> bool:
    """Wait until a future of ``qi`` has finished, one way or another, at most ``timeout`` [s]; hears Ctrl-C."""
    running = load_qi().FutureState.Running
    end = time.monotonic() + timeout
    while (left := end - time.monotonic()) > 0:
        check_signals()
        if future.wait(max(1, round(min(left, LOOK) * 1000))) != running:
            return True
    return bool(future.wait(0) != running)


def connect(
    address: Address,
    secret: Secret | None = None,
    on_lost: Callable[[], None] | None = None,
    settings: NaoqiSettings | None = None,
) -> Connection:
    """Connect with the NAOqi at ``address``.

    Args:
        address: Where it is.
        secret: Password of ``address.user``, where there is TLS.
        on_lost: Called once, on a thread of the library, when the link is lost.
        settings: How long it may take, by default the shipped ones.

    Raises:
        NotConnectedError: Nobody there, nobody who answers, no NAOqi, TLS on one side alone, or a wrong password.
        NoQiError: There is no library.
    """
    settings = settings or load_naoqi_settings()
    qi = load_qi()
    check_listening(address, settings.connect_time)
    session = qi.Session()
    if address.secure:
        session.setClientAuthenticatorFactory(_Login(address.user or "", secret))
    future = session.connect(address.url, _async=True)
    answered = finished(future, settings.connect_time)
    if not answered or future.hasError():
        session.close()
        raise refusal(address, silent=not answered)
    return Connection(address, session, on_lost, settings.call_time)


class _Login:
    """Factory and authenticator in one, as ``qi`` asks for them."""

    def __init__(self, user: str, secret: Secret | None) -> None:
        self._user, self._secret = user, secret

    def newAuthenticator(self) -> _Login:
        return self

    def initialAuthData(self) -> dict[str, str]:
        return {"user": self._user, "token": self._secret.value if self._secret else ""}
