"""Messages of the stream: a head with length and kind, then a row of the log or JSON.

From the robot's process: ``ABOUT`` once a run, ``TICK`` and ``POSE`` some 25 times a second, ``CONTACT`` and ``EVENT``
as they occur, ``STATUS`` a few times a second, ``ANSWER`` to each request. To it: ``HELLO`` first, then ``REQUEST``.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from enum import IntEnum
from typing import Any, NamedTuple

from pepper_driver.config import PepperError

MAX_MESSAGE = 2**22
"""[bytes] Longest message; a longer one is a mistake, or another program."""

_HEAD = struct.Struct("<IB")


class TelemetryError(PepperError, ConnectionError):
    """A stream cannot be opened, or has ended; the message is one line."""


class Kind(IntEnum):
    """Kind of a message, and its contents."""

    HELLO = 1
    """JSON: ``token``."""
    REQUEST = 2
    """JSON: ``number``, ``do``, and the arguments of what is to be done."""
    ABOUT = 3
    """JSON: ``layout`` of the rows as in a log, ``run`` as in a log's metadata, ``can``: what may be requested."""
    TICK = 4
    """A row of ``/tick`` as in a log."""
    POSE = 5
    """JSON: ``base`` (x, y [m], yaw [rad]), ``tilt`` (pitch, roll [rad]), ``forces``: contacts of a simulation."""
    CONTACT = 6
    """JSON as in a log."""
    EVENT = 7
    """JSON as in a log."""
    STATUS = 8
    """JSON: ``state``, ``fault``, ``reflexes`` that act, ``stages`` [us], ``missed``."""
    ANSWER = 9
    """JSON: ``number``; ``error`` as one line, or ``result``."""


_KINDS = frozenset(kind.value for kind in Kind)


class Message(NamedTuple):
    """A message as it came."""

    kind: Kind
    data: bytes

    @property
    def json(self) -> dict[str, Any]:
        """Contents of a message in JSON.

        Raises:
            ValueError: They are no JSON object.
        """
        contents = json.loads(self.data)
        if not isinstance(contents, dict):
            raise ValueError("no JSON object")
        return contents


def pack(kind: Kind, data: bytes) -> bytes:
    """Return a message with its head."""
    return _HEAD.pack(len(data), kind) + data


def pack_json(kind: Kind, **contents: object) -> bytes:
    """Return a message in JSON with its head."""
    return pack(kind, json.dumps(contents).encode())


class MessageBuffer:
    """Puts the bytes of a stream together to messages."""

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Take in bytes; yield the messages that are whole.

        Raises:
            TelemetryError: They are no messages.
        """
        self._data += data
        while len(self._data) >= _HEAD.size:
            length, kind = _HEAD.unpack_from(self._data)
            if length > MAX_MESSAGE or kind not in _KINDS:
                raise TelemetryError("what came is no telemetry of this version")
            end = _HEAD.size + length
            if len(self._data) < end:
                return
            message = Message(Kind(kind), bytes(self._data[_HEAD.size : end]))
            del self._data[:end]
            yield message
