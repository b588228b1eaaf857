"""A log as its file has it: metadata, tables of rows, messages as text; whole, or as far as it is intact.

It stands this low because a recording is a robot as well: :mod:`pepper_driver.backends.replay`.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import MCAP0_MAGIC

from pepper_driver.backends.fields import Column, FieldType
from pepper_driver.backends.log_records import Message, Records, find_records
from pepper_driver.config import PepperError
from pepper_driver.config.errors import reason

logger = logging.getLogger("pepper_driver")

TICK_TOPIC = "/tick"
UNMATCHED_TOPIC = "/unmatched"

RUN, LAYOUT, END = "run", "layout", "end"
"""Metadata: text about the run; what the reader must know of robot and rows; how many messages were written."""

UNKNOWN = "unknown"
"""In place of their number in a log that lacks its last messages, but has an end: one that was repaired."""

CDR_HEADER = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, no options."""

LAYOUT_VERSION = "7"

SEQUENCES = 2**32
"""Messages are numbered from 0 up to here, and then from 0 again."""

SHOWN_GAPS = 3
"""Gaps of a log that its description names one by one."""


class LogError(PepperError, OSError):
    """A log cannot be written or read; the message is one line with path and reason."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """One field of a row.

    Attributes:
        name: Name in the message and in ``RunLog``.
        elements: Names of its values; None for a scalar.
        type: Of its values.
        meaning: Unit and meaning, for the comment in the message definition.
    """

    name: str
    elements: tuple[str, ...] | None
    type: FieldType
    meaning: str


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Messages that are missing between two that are there, or before the first.

    Attributes:
        start: Time stamp of the last message before it [s]; None without one.
        stop: Time stamp of the first message after it [s].
        messages: How many are missing.
        chunks: In how many damaged chunks they were, at least.
    """

    start: float | None
    stop: float
    messages: int
    chunks: int

    def __str__(self) -> str:
        start = "up" if self.start is None else f"{self.start:.2f}"
        return f"{start} to {self.stop:.2f} s"


@dataclass(frozen=True, kw_only=True)
class RawLog:
    """The contents of a log file.

    Attributes:
        path: Where it was read.
        metadata: Text about the run; empty where it is damaged.
        layout: What the writer said of robot and rows, each value as JSON.
        complete: False when the file ends early, because it was cut or its end is damaged.
        gaps: What is missing before the end.
        missing: All that is missing, as text in one line; empty for a log that is whole.
        fields: Of the rows of each table, by topic.
        tables: Arrays over the rows, (n,) or (n, width), by topic and field.
        messages: Of the other topics, as they were written.
    """

    path: Path
    metadata: dict[str, str]
    layout: dict[str, str]
    complete: bool
    gaps: tuple[Gap, ...]
    missing: str
    fields: dict[str, tuple[Field, ...]] = field(repr=False)
    tables: dict[str, dict[str, Column]] = field(repr=False)
    messages: dict[str, list[bytes]] = field(repr=False)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Order of every joint vector."""
        return tuple(json.loads(self.layout["joint_names"]))


def topics_of(layout: Mapping[str, str]) -> tuple[str, ...]:
    """Return the topics of a layout; the channel of each has its number, from 1."""
    return tuple(json.loads(layout["topics"]))


def fields_of(layout: Mapping[str, str]) -> dict[str, tuple[Field, ...]]:
    """Return the fields of each table of a layout, by topic."""
    return {
        topic: tuple(_field(entry) for entry in table)
        for topic, table in json.loads(layout["fields"]).items()
    }


def row_type(fields: Iterable[Field]) -> np.dtype[Any]:
    """Return a message of ``fields``, behind the CDR header, as a NumPy record."""
    return np.dtype(
        [
            (
                f.name,
                # As CDR_HEADER says, on any computer.
                np.dtype(f.type).newbyteorder("<"),
                () if f.elements is None else (len(f.elements),),
            )
            for f in fields
        ]
    )


def read_log_file(path: Path, usual_layout: Mapping[str, str] | None = None) -> RawLog:
    """Read all of a log that is intact, and warn in one line of what is missing.

    Args:
        path: The file.
        usual_layout: Layout of the logs of this version, for one whose own is damaged; None to refuse it.

    Raises:
        LogError: The file is missing, no log of this package, or nothing of it is intact.
    """
    file = decode_records(path, read_records(path), usual_layout)
    if file.missing:
        logger.warning("%s: %s", path, file.missing)
    return file


def read_records(path: Path) -> Records:
    """Read the intact records of a log.

    Raises:
        LogError: The file is missing, or no MCAP file.
    """
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({reason(error)})") from error
    records = find_records(data, (RUN, LAYOUT, END))
    if not (data.startswith(MCAP0_MAGIC) or records.messages or records.metadata):
        raise LogError(f"{path}: is {'not an MCAP file' if data else 'empty'}")
    return records


def decode_records(
    path: Path, records: Records, usual_layout: Mapping[str, str] | None = None
) -> RawLog:
    """Return the contents of a log of these records; see :func:`read_log_file`."""
    try:
        return _decode(path, records, usual_layout)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    # Damaged metadata can make json and NumPy raise errors of many kinds.
    except Exception as error:
        raise misfit(path, error) from error


def misfit(path: Path, error: Exception) -> LogError:
    """Return the error of a log whose messages are not what its layout says."""
    what = (str(error) or type(error).__name__).splitlines()[0]
    return LogError(f"{path}: its rows do not fit its layout ({what})")


def _decode(path: Path, records: Records, usual_layout: Mapping[str, str] | None) -> RawLog:
    """Return the contents of a log; the errors lack its path."""
    own = records.metadata.get(LAYOUT)
    if own is not None and own["version"] != LAYOUT_VERSION:
        by = records.metadata.get(RUN, {}).get("pepper_driver", "of an unknown version")
        raise LogError(
            f"was written by pepper_driver {by} in layout {own['version']}; this version reads {LAYOUT_VERSION}:"
            " read it with the version that wrote it, or record the run again"
        )
    layout = usual_layout if own is None and records.messages else own
    if layout is None:
        raise LogError(
            "is an MCAP file, but not a log of this package, cut before its first row, or its layout is damaged"
        )
    if not records.messages and (
        records.damaged or records.metadata.get(END, {}).get("messages", "0") not in ("0", UNKNOWN)
    ):
        raise LogError("is damaged, and none of its chunks is intact")
    fields = fields_of(layout)
    messages = _by_topic(records.messages, topics_of(layout))
    try:
        tables = {topic: _table(topic, fields[topic], messages) for topic in fields}
    except LogError as error:
        if own is None:
            raise LogError("is not a log of this package, or of another version") from error
        raise
    complete, gaps = is_complete(records), _gaps(records)
    return RawLog(
        path=path,
        metadata=records.metadata.get(RUN, {}),
        layout=dict(layout),
        complete=complete,
        gaps=gaps,
        missing="; ".join(_missing(records, complete, gaps)),
        fields=fields,
        tables=tables,
        messages={topic: found for topic, found in messages.items() if topic not in fields},
    )


def is_complete(records: Records) -> bool:
    """Return True unless the last messages of a log are missing, or its end."""
    after_last = (records.messages[-1].sequence + 1) % SEQUENCES if records.messages else 0
    if (end := records.metadata.get(END)) is not None:
        return records.finished and end["messages"] == str(after_last)
    # Without the metadata of the end, only a damaged chunk after the last message shows that some are missing.
    return records.finished and len(records.messages) not in records.damaged


def _gaps(records: Records) -> tuple[Gap, ...]:
    gaps, expected, start = [], 0, None
    for number, message in enumerate(records.messages):
        if message.sequence != expected:
            gaps.append(
                Gap(
                    start=start,
                    stop=1e-9 * message.time,
                    # MCAP has 32 bits for the number of a message.
                    messages=(message.sequence - expected) % SEQUENCES,
                    chunks=max(1, records.damaged.count(number)),
                )
            )
        expected, start = (message.sequence + 1) % SEQUENCES, 1e-9 * message.time
    return tuple(gaps)


def _missing(records: Records, complete: bool, gaps: Sequence[Gap]) -> Iterator[str]:
    """Yield human-readable descriptions of missing parts of a log."""
    if not complete:
        last = (
            f"after {1e-9 * records.messages[-1].time:.2f} s"
            if records.messages
            else "before its first tick"
        )
        yield f"cut short {last}"
    if gaps:
        count = sum(gap.chunks for gap in gaps)
        shown = ", ".join(map(str, gaps[:SHOWN_GAPS]))
        more = f" and {len(gaps) - SHOWN_GAPS} more times" if len(gaps) > SHOWN_GAPS else ""
        yield f"{'1 chunk is' if count == 1 else f'{count} chunks are'} missing: {shown}{more}"
    if RUN not in records.metadata:
        yield "what it says of its run is damaged"
    if LAYOUT not in records.metadata:
        yield "its layout is damaged, and read as that of this version"


def _by_topic(messages: Sequence[Message], topics: Sequence[str]) -> dict[str, list[bytes]]:
    """Return the messages of each topic; channels have the numbers of their topics, from 1."""
    found: dict[str, list[bytes]] = {topic: [] for topic in topics}
    for message in messages:
        if 1 <= message.channel <= len(topics):
            found[topics[message.channel - 1]].append(message.data)
    return found


def _table(
    topic: str, fields: tuple[Field, ...], messages: Mapping[str, Sequence[bytes]]
) -> dict[str, Column]:
    head, kind = len(CDR_HEADER), row_type(fields)
    for message in messages[topic]:
        if len(message) != head + kind.itemsize or message[:head] != CDR_HEADER:
            raise LogError(f"{topic} holds a message of {len(message)} bytes that is not a row")
    rows = np.frombuffer(b"".join(m[head:] for m in messages[topic]), dtype=kind)
    # Copies: the fields of packed records are unaligned, read-only and always little-endian.
    return {field.name: rows[field.name].astype(field.type) for field in fields}


def _field(entry: dict[str, Any]) -> Field:
    elements = entry.pop("elements")
    return Field(elements=None if elements is None else tuple(elements), **entry)
