"""A log back from its file: whole, or as far as it was written."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from pepper_driver.config import UnknownNameError
from pepper_driver.log.contacts import CONTACTS
from pepper_driver.log.errors import LogError
from pepper_driver.log.event import EVENTS, LogEvent
from pepper_driver.log.json_topic import JsonTopic
from pepper_driver.log.label import LABELS, Label
from pepper_driver.log.mcap_file import reason
from pepper_driver.log.schema import (
    CDR_HEADER,
    LAYOUT_VERSION,
    TICK_TOPIC,
    TRUTH_TOPIC,
    Field,
    row_type,
)
from pepper_driver.observer.contact import Contact

Column = NDArray[Any]
"""float64, int64, int8 or bool, as the field was appended."""

T = TypeVar("T")


_RECORD_HEADER = struct.Struct("<BQ")  # opcode, length of what follows
_CHANNEL_ID = struct.Struct("<H")
_MESSAGE_HEADER = 22  # channel, sequence, two time stamps [bytes]


@dataclass(frozen=True, kw_only=True)
class LogData:
    """The contents of a log.

    Attributes:
        metadata: Text about the run, as given to ``LogWriter``.
        complete: False when the file ends early, because the process was killed or the disk failed.
        joint_names: Order of every joint vector.
        chains: Joints of each chain, from the trunk outwards.
        hand_joints: Joints that measure aperture, 0..1, not an angle.
        robot: Name of the robot.
        fields: Arrays over n ticks, (n,) or (n, width), by name; ``log["position"]`` is short for
            it. Units and meaning are in :func:`pepper_driver.log.schema.tick_fields`.
        contacts: Contact events in the order they were raised.
        truth: Arrays of the simulation's ground truth, with a ``time`` of their own; None where
            there is none. Names are in :func:`pepper_driver.log.schema.truth_fields`.
        labels: Ends of touches that ``pepper record`` was told of, in their order.
        events: What else happened, in its order.
        elements: Names of the values of each vector in ``fields``, by its name; in ``truth``, as ``truth.<name>``.
    """

    metadata: dict[str, str]
    complete: bool
    joint_names: tuple[str, ...]
    chains: dict[str, tuple[str, ...]]
    hand_joints: tuple[str, ...]
    robot: str
    fields: dict[str, Column] = field(repr=False)
    contacts: list[Contact] = field(repr=False)
    truth: dict[str, Column] | None = field(repr=False)
    labels: list[Label] = field(repr=False, default_factory=list)
    events: list[LogEvent] = field(repr=False, default_factory=list)
    elements: dict[str, tuple[str, ...]] = field(repr=False, default_factory=dict)

    def __getitem__(self, name: str) -> Column:
        """The array of one field.

        Raises:
            UnknownNameError: No such field.
        """
        try:
            return self.fields[name]
        except KeyError:
            raise UnknownNameError("log field", name, self.fields) from None

    def lasting_contacts(self) -> list[tuple[Contact, float]]:
        """Each contact as it was last seen, and when it ended [s]: at the last tick where the log does not say.

        Where a contact is felt becomes clearer after it began: its last event knows the joint best.
        """
        last = {contact.id: contact for contact in self.contacts}
        end = float(self["time"][-1]) if len(self) else np.nan
        return [(c, c.time if c.phase == "end" else end) for c in last.values()]

    def __len__(self) -> int:
        """Number of ticks."""
        return len(self.fields["time"])


def read_log(path: Path) -> LogData:
    """Read a log, also one that was cut short.

    Raises:
        LogError: The file is missing, damaged, or no log of this package.
    """
    path = Path(path)
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
        return contents.result()
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    except Exception as error:
        what = (str(error) or type(error).__name__).splitlines()[0]
        raise LogError(f"{path}: its rows do not fit its layout ({what})") from error


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

    def result(self) -> LogData:
        """All of it as a log."""
        layout = self._metadata.get("layout")
        if layout is None or "run" not in self._metadata:
            raise LogError(
                "is an MCAP file, but not a log of this package, or cut before its first row"
            )
        if layout["version"] != LAYOUT_VERSION:
            raise LogError(f"has layout {layout['version']}, this version reads {LAYOUT_VERSION}")
        tables = {
            topic: [_field(entry) for entry in table]
            for topic, table in json.loads(layout["fields"]).items()
        }
        ticks, truth = tables[TICK_TOPIC], tables[TRUTH_TOPIC]
        return LogData(
            metadata=self._metadata["run"],
            complete=self.complete,
            joint_names=tuple(json.loads(layout["joint_names"])),
            chains={k: tuple(v) for k, v in json.loads(layout["chains"]).items()},
            hand_joints=tuple(json.loads(layout["hand_joints"])),
            robot=json.loads(layout["robot"]),
            fields=self._table(TICK_TOPIC, ticks),
            contacts=self._items(CONTACTS),
            truth=self._table(TRUTH_TOPIC, truth) if self._of(TRUTH_TOPIC) else None,
            labels=self._items(LABELS),
            events=self._items(EVENTS),
            elements={
                **{f.name: f.elements for f in ticks if f.elements is not None},
                **{f"truth.{f.name}": f.elements for f in truth if f.elements is not None},
            },
        )

    def _of(self, topic: str) -> list[memoryview]:
        return self._messages.get(topic, [])

    def _items(self, topic: JsonTopic[T]) -> list[T]:
        return [topic.decode(bytes(message)) for message in self._of(topic.topic)]

    def _table(self, topic: str, fields: list[Field]) -> dict[str, Column]:
        messages = self._of(topic)
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
