"""Requests to the robot process and its answers: JSON in packets over a pair of Unix sockets."""

from __future__ import annotations

import json
import socket
from typing import Any

from pepper_driver.backends.interface import BackendError

PACKET = 1 << 18
"""[bytes] of the longest packet."""


def make_pair() -> tuple[socket.socket, socket.socket]:
    """Two ends of a connection that keeps packets whole, whatever happens to who sends them."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * PACKET)
    return pair


def send(end: socket.socket, message: dict[str, Any], *, wait: bool = True) -> None:
    """Send one message.

    Raises:
        BackendError: It is too long.
        OSError: Nobody is at the other end; or, when not to ``wait``, nobody reads there.
    """
    packet = json.dumps(message).encode()
    if len(packet) > PACKET:
        raise BackendError(f"a request of {len(packet)} bytes is too long: {PACKET} is the most")
    end.send(packet, 0 if wait else socket.MSG_DONTWAIT)


def receive(end: socket.socket) -> dict[str, Any] | None:
    """The next message; None once the other end is gone for good."""
    packet = end.recv(PACKET)
    if not packet:
        return None
    message: dict[str, Any] = json.loads(packet)
    return message
