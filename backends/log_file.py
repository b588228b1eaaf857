"""A log as its file has it: metadata, tables of rows, messages as text; whole, or as far as it was written.

It stands this low because a recording is a robot as well: :mod:`pepper_driver.backends.replay`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from pepper_driver.config import PepperError

TICK_TOPIC = "/tick"
UNANSWERED_TOPIC = "/unanswered"

CDR_HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, no options."""

LAYOUT_VERSION = "4"

FieldType = Literal["float64", "int64", "bool", "int8"]

Column = NDArray[Any]
"""float64, int64, int8 or bool, as the field was appended."""

_RECORD_HEADER = struct.Struct("<BQ")  # opcode, length of what follows
_CHANNEL_ID = struct.Struct("<H")
_MESSAGE_HEADER = 22  # channel, sequence, two time stamps [bytes]


class LogError(PepperError, OSError):
    """A log cannot be written or read; the message is one line with path and reason."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field of a row.

    Attributes:
        name: Name in the message and in ``LogData``.
        elements: Names of its values; None for a scalar.
        type: Of its values.
        meaning: Unit and meaning, for the comment in the message definition.
    """

    name: str
    elements: tuple[str, ...] | None
    type: FieldType
    meaning: str


@dataclass(frozen=True, kw_only=True)
class LogFile:
    """The contents of a log file.

    Attributes:
        path: Where it was read.
        metadata: Text about the run.
        layout: What the writer said of robot and rows, each value as JSON.
        complete: False when the file ends early.
        fields: Of the rows of each table, by topic.
        tables: Arrays over the rows, (n,) or (n, width), by topic and field.
        messages: Of the other topics, as they were written.
    """

    path: Path
    metadata: dict[str, str]
    layout: dict[str, str]
    complete: bool
    fields: dict[str, tuple[Field, ...]] = field(repr=False)
    tables: dict[str, dict[str, Column]] = field(repr=False)
    messages: dict[str, list[bytes]] = field(repr=False)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Order of every joint vector."""
        return tuple(json.loads(self.layout["joint_names"]))


def row_type(fields: Iterable[Field]) -> np.dtype[Any]:
    """A message of ``fields``, behind the CDR header, as a NumPy record."""
    return np.dtype(
        [
            (
                f.name,
                np.dtype(f.type).newbyteorder("<"),
                () if f.elements is None else (len(f.elements),),
            )
            for f in fields
        ]
    )


def reason(error: Exception) -> str:
    """What went wrong, without the path that an OSError repeats."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def read_log_file(path: Path) -> LogFile:
    """Read a log, also one that was cut short.

    Raises:
        LogError: The file is missing, damaged, or no log of this package.
    """
    try:
        data = memoryview(path.read_bytes())
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({reason(error)})") from error
    if not bytes(data[: len(MCAP0_MAGIC)]) == MCAP0_MAGIC:
        raise LogError(f"{path}: is {'not an MCAP file' if len(data) else 'empty'}")
    contents = _Contents()
    position = 0
    try:
        for position, opcode, body in _records(data, len(MCAP0_MAGIC)):
            if opcode == Opcode.FOOTER:
                end = position + _RECORD_HEADER.size + len(body)
                contents.complete = bytes(data[end:]) == MCAP0_MAGIC
                break
            contents.take(opcode, body)
    except Exception as error:  # whatever the decoders make of damaged bytes
        what = (str(error) or type(error).__name__).splitlines()[0]
        raise LogError(f"{path}: damaged at byte {position} ({what})") from error
    try:
        return contents.result(path)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    except Exception as error:
        raise misfit(path, error) from error


def misfit(path: Path, error: Exception) -> LogError:
    """The error of a log whose messages are not what its layout says."""
    what = (str(error) or type(error).__name__).splitlines()[0]
    return LogError(f"{path}: its rows do not fit its layout ({what})")


def _records(data: memoryview, position: int) -> Iterator[tuple[int, int, memoryview]]:
    """Position, opcode and body of every record that is there to its end."""
    while position + _RECORD_HEADER.size <= len(data):
        opcode, length = _RECORD_HEADER.unpack_from(data, position)
        start = position + _RECORD_HEADER.size
        if start + length > len(data):
            return
        yield position, opcode, data[start : start + length]
        position = start + length


class _Contents:
    """Records sorted by what they are, while a file is read."""

    def __init__(self) -> None:
        self.complete = False
        self._metadata: dict[str, dict[str, str]] = {}
        self._topics: dict[int, str] = {}
        self._messages: dict[str, list[memoryview]] = {}

    def take(self, opcode: int, body: memoryview) -> None:
        """Take in one record; kinds that do not matter here are passed over.

        Zeros, which a loss of power may leave at the end, read as empty records of no known kind.
        """
        if opcode == Opcode.MESSAGE:
            topic = self._topics.get(_CHANNEL_ID.unpack_from(body)[0], "")
            self._messages.setdefault(topic, []).append(body[_MESSAGE_HEADER:])
        elif opcode == Opcode.CHUNK:
            stream, length = get_chunk_data_stream(Chunk.read(_stream(body)), validate_crc=True)
            for _, inner, inner_body in _records(memoryview(stream.read(length)), 0):
                self.take(inner, inner_body)
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(_stream(body))
            self._topics[channel.id] = channel.topic
        elif opcode == Opcode.METADATA:
            record = Metadata.read(_stream(body))
            self._metadata.setdefault(record.name, record.metadata)

    def result(self, path: Path) -> LogFile:
        """All of it."""
        layout = self._metadata.get("layout")
        if layout is None or "run" not in self._metadata:
            raise LogError(
                "is an MCAP file, but not a log of this package, or cut before its first row"
            )
        if layout["version"] != LAYOUT_VERSION:
            raise LogError(f"has layout {layout['version']}, this version reads {LAYOUT_VERSION}")
        fields = {
            topic: tuple(_field(entry) for entry in table)
            for topic, table in json.loads(layout["fields"]).items()
        }
        return LogFile(
            path=path,
            metadata=self._metadata["run"],
            layout=layout,
            complete=self.complete,
            fields=fields,
            tables={topic: self._table(topic, table) for topic, table in fields.items()},
            messages={
                topic: [bytes(message) for message in messages]
                for topic, messages in self._messages.items()
                if topic not in fields
            },
        )

    def _table(self, topic: str, fields: tuple[Field, ...]) -> dict[str, Column]:
        messages = self._messages.get(topic, [])
        head, kind = len(CDR_HEADER), row_type(fields)
        for message in messages:
            if len(message) != head + kind.itemsize or message[:head] != CDR_HEADER:
                raise LogError(f"{topic} holds a message of {len(message)} bytes that is not a row")
        rows = np.frombuffer(b"".join(m[head:] for m in messages), dtype=kind)
        return {field.name: rows[field.name].astype(field.type) for field in fields}


def _field(entry: dict[str, Any]) -> Field:
    elements = entry.pop("elements")
    return Field(elements=None if elements is None else tuple(elements), **entry)


def _stream(body: memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
