"""Connection to NAOqi: who answers, calls with time-outs, who refused."""

from __future__ import annotations

import logging
import math
import socket
import ssl
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeAlias

from pepper_driver.backends.interface import BackendError, NotConnectedError
from pepper_driver.backends.naoqi.address import PORTS, USER, Address, Secret
from pepper_driver.backends.naoqi.qi_library import (
    Answer,
    Future,
    Proxy,
    QiSession,
    load_qi,
    one_line,
)
from pepper_driver.config import NaoqiSettings, load_naoqi_settings
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.signals import check_signals


class NoAnswerError(NotConnectedError, TimeoutError):
    """A server listens, but does not answer."""


class LoginError(NotConnectedError, PermissionError):
    """The robot refuses this user."""


def check_listening(address: Address, timeout: float) -> None:
    """Raise a NotConnectedError with the reason if no server listens at ``address`` within ``timeout`` [s]."""
    try:
        socket.create_connection((address.host, address.port), timeout=timeout).close()
    except socket.gaierror as error:
        raise NotConnectedError(
            f"'{address.uri}': no computer is called '{address.host}'; press the robot's chest button once and use "
            "the address it says"
        ) from error
    except ConnectionRefusedError as error:
        raise NotConnectedError(
            f"'{address.uri}': {address.host} is there, but no server listens at port {address.port}; NAOqi 2.5 "
            f"listens at {PORTS['naoqi']} (naoqi://), 2.9 at {PORTS['naoqis']} (naoqis://), minutes after its start"
        ) from error
    # UnicodeError: Python cannot encode a host name whose labels are empty or too long.
    except (OSError, UnicodeError) as error:
        raise NotConnectedError(
            f"'{address.uri}': {address.host} does not answer; is the robot on, and in the same network? Its chest "
            "button, pressed once, says its address"
        ) from error


def refusal(address: Address, probe_time: float, *, silent: bool) -> NotConnectedError:
    """Reason why ``qi`` did not connect to a server that listens.

    Args:
        address: Where.
        probe_time: How long the peer may take to begin with TLS [s].
        silent: Whether it still waited for an answer, and was not turned away.
    """
    peer = _peer(address, probe_time)
    place = f"{address.host}:{address.port}"
    if peer == "tls" and not address.secure:
        return NotConnectedError(
            f"'{address.uri}': {place} speaks TLS, as NAOqi 2.9 does; write naoqis://{USER}@{place}"
        )
    if peer == "plain" and address.secure:
        return NotConnectedError(
            f"'{address.uri}': {place} speaks no TLS; NAOqi 2.5 has none: write naoqi://{address.host}"
        )
    if silent or peer == "silent":
        return NoAnswerError(
            f"'{address.uri}': {place} takes connections and says nothing; NAOqi hangs or is starting: wait for the "
            "robot's voice, or restart it"
        )
    if address.secure:
        return LoginError(
            f"'{address.uri}': {place} refuses the user '{address.user}': wrong password, or no robot. The password is "
            "that of the robot's web page"
        )
    return NotConnectedError(
        f"'{address.uri}': what listens at {place} is no NAOqi; is it the robot's address and port?"
    )


def _peer(address: Address, probe_time: float) -> Literal["tls", "plain", "silent"]:
    """Return the peer's answer to the begin of TLS. Nothing is sent in it, and no certificate is trusted."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    # A robot's certificate is self-signed.
    context.verify_mode = ssl.CERT_NONE
    try:
        with (
            socket.create_connection((address.host, address.port), timeout=probe_time) as plain,
            context.wrap_socket(plain),
        ):
            return "tls"
    except TimeoutError:
        return "silent"
    except OSError:  # ssl.SSLError is one
        return "plain"


logger = logging.getLogger("pepper_driver")

POLL_PERIOD = 0.05
"""[s] between two checks of a call: while the library waits, Python handles no Ctrl-C."""


class ServiceError(BackendError):
    """A service of the robot refused what it was asked.

    Attributes:
        reason: What it says; the message holds it too.
    """

    def __init__(self, message: str, reason: str = "") -> None:
        self.reason = reason
        super().__init__(message)


class CallTimeoutError(BackendError, TimeoutError):
    """A service of the robot gave no answer in time. It may still execute the call."""


class MissingServiceError(BackendError, LookupError):
    """The robot has no such service, or the service no such method."""


class Connection:
    """With one NAOqi, made by :func:`connect`. Once lost it does not come back; make another.

    All methods may be called from any thread, but not from the tick: they wait. The tick takes ``service`` once, and
    then calls its methods with ``_async=True``.

    Attributes:
        address: Where the robot is.
        call_time: Default timeout of a call [s].

    Timeouts are counted on ``clock``, by which the futures of the session must wait.
    """

    def __init__(
        self,
        address: Address,
        session: QiSession,
        on_lost: Callable[[], None] | None,
        call_time: float,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.address = address
        self.call_time, self._clock = call_time, clock
        self._session = session  # services do not keep it alive
        self._on_lost = on_lost
        self._closed = False
        self._services: dict[str, Proxy] = {}
        session.disconnected.connect(self._lost)

    @property
    def connected(self) -> bool:
        """True while the connection stands, as far as the library noticed.

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

        The library then listens at a port of this computer that others cannot reach. The service ends with the
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
            ServiceError: No service has this number.
            CallTimeoutError: No answer in ``timeout`` [s].
            NotConnectedError: The connection is lost.
        """
        what = f"unregistering service {number}"
        self._wait(lambda: self._session.unregisterService(number, _async=True), what, timeout)

    def service(self, name: str, timeout: float | None = None) -> Proxy:
        """Return the proxy of a service, as ``qi`` makes it: its errors are RuntimeErrors.

        Raises:
            MissingServiceError: The robot has none of this name.
            CallTimeoutError: No answer in ``timeout`` [s].
            NotConnectedError: The connection is lost.
        """
        if name not in self._services:
            # Kept: looking a service up is one more round trip.
            self._services[name] = self._wait(
                lambda: self._session.service(name, _async=True), name, timeout
            )
        return self._services[name]

    def call(
        self, service: str, method: str, *arguments: object, timeout: float | None = None
    ) -> Answer:
        """Return the answer of a method of a service.

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
            # close() makes calls in flight fail, which needs no warning.
            if future.hasError() and not self._closed:
                logger.warning("%s failed: %s", what, one_line(future.error()))

        future.addCallback(ended)

    def close(self) -> None:
        """Disconnect. ``on_lost`` is not called."""
        if not self._closed:
            # First: libqi calls `_lost` on a thread of its own while the session closes.
            self._closed = True
            self._session.close()

    def _lost(self, *_: object) -> None:
        if not self._closed and self._on_lost is not None:
            self._on_lost()

    def _wait(self, start: Callable[[], Future], what: str, timeout: float | None) -> Answer:
        """Return the value of the future that ``start`` gives."""
        limit = self.call_time if timeout is None else timeout
        uri = self.address.uri
        if not self.connected:
            raise NotConnectedError(f"'{uri}': not connected any more, so no {what}")
        try:
            future = start()
            in_time = finished(future, limit, self._clock)
            # value() of a call that still runs would wait without limit.
            value = future.value() if in_time else None
        except AttributeError as error:
            raise MissingServiceError(f"'{uri}': this robot has no {what}") from error
        except RuntimeError as error:
            reason = one_line(str(error))
            if not self.connected:
                raise NotConnectedError(f"'{uri}': the connection was lost at {what}") from error
            # libqi raises RuntimeError for every failure: only the text shows that the service does not exist.
            if "Cannot find service" in reason:
                raise MissingServiceError(f"'{uri}': this robot has no service {what}") from error
            raise ServiceError(f"'{uri}': {what} refused: {reason}", reason) from error
        if not in_time:
            raise CallTimeoutError(f"'{uri}': {what} gave no answer in {limit:g} s")
        return value


def finished(future: Future, timeout: float, clock: Clock = SYSTEM_CLOCK) -> bool:
    """Wait until a future of ``qi`` has finished, with or without success, at most ``timeout`` [s]; handles Ctrl-C."""
    end = clock.seconds() + timeout
    while (left := end - clock.seconds()) > 0 and future.isRunning():
        check_signals()
        # At least 1 ms: with 0 the loop would spin.
        future.wait(max(1, round(min(left, POLL_PERIOD) * 1000)))
    return not future.isRunning()


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
        NotConnectedError: No host, no answer, no NAOqi, TLS on one side alone, or a wrong password.
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
        raise refusal(address, settings.probe_time, silent=not answered)
    return Connection(address, session, on_lost, settings.call_time)


Connect: TypeAlias = Callable[
    [Address, Secret | None, Callable[[], None] | None, NaoqiSettings | None], Connection
]
"""Makes a connection, as :func:`connect` does."""


class _Login:
    """Factory and authenticator in one, as ``qi`` asks for them."""

    def __init__(self, user: str, secret: Secret | None) -> None:
        self._user, self._secret = user, secret

    def newAuthenticator(self) -> _Login:
        return self

    def initialAuthData(self) -> dict[str, str]:
        return {"user": self._user, "token": self._secret.value if self._secret else ""}


WARNING_PERIOD = 5.0
"""[s] between two warnings about the same call."""


class Call:
    """One method of a service, with at most one call in flight.

    Args:
        proxy: Of the service.
        method: Its name.
        uri: Of the robot, for messages.
        clock: Time between warnings.
    """

    def __init__(self, proxy: Proxy, method: str, uri: str, *, clock: Clock = SYSTEM_CLOCK) -> None:
        self._proxy, self._method, self._what = proxy, method, f"'{uri}': {method}"
        self._future: Future | None = None
        self._clock, self._warned = clock, -math.inf

    def begin(self, *arguments: object) -> bool:
        """Call it, unless a call is in flight; return True if it was called."""
        # A result that was never read must not count as a call in flight.
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
        """True if no call is in flight."""
        return self._future is None or not self._future.isRunning()

    def answer(self) -> Answer:
        """Return the result of the last call, once; None while it is in flight or if it failed."""
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
        now = self._clock.seconds()
        if now - self._warned >= WARNING_PERIOD:
            self._warned = now
            logger.warning("%s failed: %s", self._what, one_line(str(error)))
