"""A log as its file has it: metadata, tables of rows, messages as text; whole, or as far as it is intact.

It stands this low because a recording is a robot as well: :mod:`pepper_driver.backends.replay`.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import MCAP0_MAGIC

from pepper_driver.backends.fields import Column, FieldType
from pepper_driver.backends.log_records import (
    find_chunks,
    find_metadata,
    is_finished,
    messages_in,
)
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

BLOCK = 1024
"""Rows that are taken apart at once: as many as a processor keeps near."""

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


def read_log_file(
    path: Path,
    usual_layout: Mapping[str, str] | None = None,
    *,
    names: Collection[str] | None = None,
) -> RawLog:
    """Read all of a log that is intact, and warn in one line of what is missing.

    Args:
        path: The file.
        usual_layout: Layout of the logs of this version, for one whose own is damaged; None to refuse it.
        names: Of the fields of tables that are kept; None for all.

    Raises:
        LogError: The file is missing, no log of this package, or nothing of it is intact.
    """
    file = decode_log(path, read_bytes(path), usual_layout, names=names)
    if file.missing:
        logger.warning("%s: %s", path, file.missing)
    return file


def read_bytes(path: Path) -> bytes:
    """Return what is in a file.

    Raises:
        LogError: The file is missing, or cannot be read.
    """
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({reason(error)})") from error


def decode_log(
    path: Path,
    data: bytes,
    usual_layout: Mapping[str, str] | None = None,
    *,
    names: Collection[str] | None = None,
) -> RawLog:
    """Return the contents of a log; see :func:`read_log_file`."""
    try:
        return _decode(path, data, usual_layout, names)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    # Damaged metadata can make json and NumPy raise errors of many kinds.
    except Exception as error:
        raise misfit(path, error) from error


def misfit(path: Path, error: Exception) -> LogError:
    """Return the error of a log whose messages are not what its layout says."""
    what = (str(error) or type(error).__name__).splitlines()[0]
    return LogError(f"{path}: its rows do not fit its layout ({what})")


def _decode(
    path: Path,
    data: bytes,
    usual_layout: Mapping[str, str] | None,
    names: Collection[str] | None,
) -> RawLog:
    """Return the contents of a log; the errors lack its path."""
    metadata = find_metadata(data, (RUN, LAYOUT, END))
    own = metadata.get(LAYOUT)
    if own is not None and own["version"] != LAYOUT_VERSION:
        by = metadata.get(RUN, {}).get("pepper_driver", "of an unknown version")
        raise LogError(
            f"was written by pepper_driver {by} in layout {own['version']}; this version reads {LAYOUT_VERSION}:"
            " read it with the version that wrote it, or record the run again"
        )
    layout = usual_layout if own is None else own
    topics = () if layout is None else topics_of(layout)
    fields = {} if layout is None else fields_of(layout)
    tables = {topic: _Table(topic, own_fields, names) for topic, own_fields in fields.items()}
    texts: dict[str, list[bytes]] = {topic: [] for topic in topics if topic not in fields}
    add = [tables[t].rows.append if t in tables else texts[t].append for t in topics]
    order = _Order()
    try:
        for contents in find_chunks(data):
            if contents is None:
                order.damaged.append(len(order.sequence))
                continue
            for channel, sequence, time, message in messages_in(contents):
                order.sequence.append(sequence)
                order.time.append(time)
                if 1 <= channel <= len(add):
                    add[channel - 1](message)
            for table in tables.values():
                table.make_blocks()
        columns = {topic: table.columns() for topic, table in tables.items()}
    except LogError as error:
        if own is None:
            raise LogError("is not a log of this package, or of another version") from error
        raise
    if not (data.startswith(MCAP0_MAGIC) or order.sequence or metadata):
        raise LogError(f"is {'not an MCAP file' if data else 'empty'}")
    if layout is None or (own is None and not order.sequence):
        raise LogError(
            "is an MCAP file, but not a log of this package, cut before its first row, or its layout is damaged"
        )
    if not order.sequence and (
        order.damaged or metadata.get(END, {}).get("messages", "0") not in ("0", UNKNOWN)
    ):
        raise LogError("is damaged, and none of its chunks is intact")
    complete = order.is_complete(metadata.get(END), finished=is_finished(data))
    gaps = order.gaps()
    return RawLog(
        path=path,
        metadata=metadata.get(RUN, {}),
        layout=dict(layout),
        complete=complete,
        gaps=gaps,
        missing="; ".join(_missing(metadata, order.last, gaps, complete=complete)),
        fields=fields,
        tables=columns,
        messages=texts,
    )


class _Order:
    """Numbers and time stamps of the messages as they come; what is missing shows between them.

    Attributes:
        sequence: Numbers of the messages in the file.
        time: Their time stamps [ns].
        damaged: For each damaged chunk: how many messages came before it.
    """

    def __init__(self) -> None:
        self.sequence: list[int] = []
        self.time: list[int] = []
        self.damaged: list[int] = []

    @property
    def last(self) -> float | None:
        """Time stamp of the last message [s]; None without one."""
        return 1e-9 * self.time[-1] if self.time else None

    def gaps(self) -> tuple[Gap, ...]:
        """Return what is missing between messages, or before the first."""
        sequence = np.array(self.sequence, dtype=np.int64)
        # MCAP has 32 bits for the number of a message.
        missing = np.diff(sequence, prepend=-1) - 1
        return tuple(
            Gap(
                start=1e-9 * self.time[i - 1] if i else None,
                stop=1e-9 * self.time[i],
                messages=int(missing[i]) % SEQUENCES,
                chunks=max(1, self.damaged.count(i)),
            )
            for i in np.flatnonzero(missing % SEQUENCES).tolist()
        )

    def is_complete(self, end: Mapping[str, str] | None, *, finished: bool) -> bool:
        """Return True unless the last messages of a log are missing, or its end.

        Args:
            end: Metadata of the end.
            finished: The file ends as its writer ended it.
        """
        if end is not None:
            count = (self.sequence[-1] + 1) % SEQUENCES if self.sequence else 0
            return finished and end["messages"] == str(count)
        # Without the metadata of the end, only a damaged chunk after the last message shows that some are missing.
        return finished and len(self.sequence) not in self.damaged


def _missing(
    metadata: Mapping[str, Mapping[str, str]],
    last: float | None,
    gaps: Sequence[Gap],
    *,
    complete: bool,
) -> Iterator[str]:
    """Yield human-readable descriptions of missing parts of a log."""
    if not complete:
        when = "before its first tick" if last is None else f"after {last:.2f} s"
        yield f"cut short {when}"
    if gaps:
        count = sum(gap.chunks for gap in gaps)
        shown = ", ".join(map(str, gaps[:SHOWN_GAPS]))
        more = f" and {len(gaps) - SHOWN_GAPS} more times" if len(gaps) > SHOWN_GAPS else ""
        yield f"{'1 chunk is' if count == 1 else f'{count} chunks are'} missing: {shown}{more}"
    if RUN not in metadata:
        yield "what it says of its run is damaged"
    if LAYOUT not in metadata:
        yield "its layout is damaged, and read as that of this version"


class _Table:
    """Rows of a topic, as they come; they become columns block by block, so that little is in memory twice.

    Attributes:
        rows: That came and are no columns yet.
    """

    def __init__(
        self, topic: str, fields: tuple[Field, ...], names: Collection[str] | None
    ) -> None:
        self._topic = topic
        self._fields = [f for f in fields if names is None or f.name in names]
        head = np.dtype((np.void, len(CDR_HEADER)))
        self._type = np.dtype([("", head), *row_type(fields).descr])
        self.rows: list[bytes] = []
        self._blocks: dict[str, list[Column]] = {f.name: [] for f in self._fields}

    def columns(self) -> dict[str, Column]:
        """Return the array of each field, (n,) or (n, width), over all rows.

        Raises:
            LogError: A row is none of this table.
        """
        self.make_blocks(0)
        return {name: np.concatenate(self._blocks.pop(name)) for name in list(self._blocks)}

    def make_blocks(self, least: int = BLOCK) -> None:
        """Make columns of the rows, if there are so many.

        Raises:
            LogError: A row is none of this table.
        """
        if len(self.rows) < least:
            return
        for row in self.rows:
            if len(row) != self._type.itemsize or not row.startswith(CDR_HEADER):
                raise LogError(
                    f"{self._topic} holds a message of {len(row)} bytes that is not a row"
                )
        values = np.frombuffer(b"".join(self.rows), dtype=self._type)
        for column in self._fields:
            # Copies: the fields of packed records are unaligned, read-only and always little-endian.
            self._blocks[column.name].append(values[column.name].astype(column.type))
        self.rows.clear()


def _field(entry: dict[str, Any]) -> Field:
    elements = entry.pop("elements")
    return Field(elements=None if elements is None else tuple(elements), **entry)
