"""The other end of the stream, in another process or program."""

from __future__ import annotations

import socket
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from select import select
from types import TracebackType
from typing import Any, Self

from pepper_driver.config.errors import reason
from pepper_driver.telemetry.protocol import (
    Kind,
    Message,
    MessageBuffer,
    TelemetryError,
    pack_json,
)

RECEIVE = 2**16
"""[bytes] received at once, at most."""


class TelemetryClient:
    """Receives the stream of a robot, and requests things of it.

    Args:
        address: Host and port of a :class:`~pepper_driver.telemetry.TelemetryServer`.
        token: Its token.
        timeout: Longest wait for the connection [s].

    Raises:
        TelemetryError: Nothing answers there.
    """

    def __init__(self, address: tuple[str, int], token: str, *, timeout: float = 5.0) -> None:
        host, port = address
        try:
            self._socket = socket.create_connection(address, timeout=timeout)
        except OSError as error:
            raise TelemetryError(f"no telemetry at {host}:{port} ({reason(error)})") from error
        self._socket.settimeout(None)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = MessageBuffer()
        self._messages: deque[Message] = deque()
        self._sending = threading.Lock()
        self._numbers = count(1)
        self._send(pack_json(Kind.HELLO, token=token))

    def receive(self, timeout: float | None = None) -> Message | None:
        """Return the next message; None where none comes within ``timeout`` [s]. For one thread.

        Raises:
            TelemetryError: The stream has ended.
        """
        while not self._messages:
            try:
                ready, _, _ = select([self._socket], [], [], timeout)
                if not ready:
                    return None
                data = self._socket.recv(RECEIVE)
            except (OSError, ValueError) as error:  # ValueError: closed here
                raise TelemetryError(f"the telemetry has ended ({reason(error)})") from error
            if not data:
                raise TelemetryError("the telemetry has ended")
            self._messages.extend(self._buffer.feed(data))
        return self._messages.popleft()

    def __iter__(self) -> Iterator[Message]:
        """Yield messages until the stream ends."""
        while True:
            try:
                message = self.receive()
            except TelemetryError:
                return
            assert message is not None
            yield message

    def request(self, do: str, **arguments: Any) -> int:  # noqa: ANN401 whatever JSON has
        """Ask for something; return the number that the ``ANSWER`` will have. Any thread may call.

        Raises:
            TelemetryError: The stream has ended.
        """
        number = next(self._numbers)
        self._send(pack_json(Kind.REQUEST, number=number, do=do, **arguments))
        return number

    def _send(self, data: bytes) -> None:
        try:
            with self._sending:
                self._socket.sendall(data)
        except OSError as error:
            raise TelemetryError(f"the telemetry has ended ({reason(error)})") from error

    def close(self) -> None:
        """End the connection; a wait in another thread ends too."""
        with suppress(OSError):  # it has ended already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
