"""Writer of a log: a ring that the tick fills, a thread that empties it into an MCAP file.

Nothing is copied: what a tick holds is never changed.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self, TypeVar

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pepper_driver.backends.fields import TICK_FIELDS, TRUTH_FIELDS, UNMATCHED_FIELDS
from pepper_driver.backends.log_file import (
    END,
    LAYOUT,
    RUN,
    SEQUENCES,
    TICK_TOPIC,
    UNKNOWN,
    UNMATCHED_TOPIC,
    LogError,
    fields_of,
    topics_of,
)
from pepper_driver.backends.log_records import Message, with_checksum
from pepper_driver.config import RobotConfig
from pepper_driver.config.errors import reason
from pepper_driver.config.file_lock import FileLock, lock_file
from pepper_driver.config.files import OutputError
from pepper_driver.log.ros_messages import EVERY, ROS_TOPICS, RobotMessages
from pepper_driver.log.schema import (
    JSON_TOPICS,
    TRUTH_TOPIC,
    Rows,
    TickRow,
    TruthRow,
    UnmatchedRow,
    layout_metadata,
    message_definition,
    unobserved,
)
from pepper_driver.log.topics import (
    CONTACTS,
    EVENTS,
    FORCES,
    LABELS,
    JsonTopic,
    LogEvent,
    TrueForce,
)

if TYPE_CHECKING:
    from pepper_driver.loop import TickRecord


T = TypeVar("T")

CHUNK_SIZE = 64 * 1024
"""[bytes] A killed process loses the chunk it was filling: at 12 ms, a quarter of a second."""


def open_file(path: Path) -> BinaryIO:
    """Open ``path`` for writing."""
    return path.open("wb")


class McapFile:
    """An MCAP file with the topics of a log. All methods belong to one thread.

    Args:
        path: Where to write. Missing folders are made, an existing file is replaced.
        layout: Topics, fields and names, see :func:`pepper_driver.log.schema.layout_metadata`.
        metadata: Text for the ``run`` record.

    Raises:
        InUseError: Another run writes it.
        LogError: The file cannot be made. Nothing half-written stays behind.
    """

    def __init__(self, path: Path, layout: Mapping[str, str], metadata: Mapping[str, str]) -> None:
        self._sequence = 0
        self._metadata = {RUN: with_checksum(metadata), LAYOUT: with_checksum(layout)}
        self._lock = _lock(path)
        try:
            self._stream = open_file(path)
        except (OSError, ValueError) as error:
            self._lock.release()
            raise LogError(f"{path}: cannot be written ({reason(error)})") from error
        try:
            self._writer = Writer(self._stream, chunk_size=CHUNK_SIZE)
            self._writer.start(library="pepper_driver")
            self._write_metadata()
            self._channels = self._register(layout)
            self._stream.flush()
        except BaseException as error:
            self.abandon()
            with suppress(OSError):
                path.unlink()
            if isinstance(error, OSError | ValueError):
                raise LogError(f"{path}: cannot be written ({reason(error)})") from error
            raise

    def _register(self, layout: Mapping[str, str]) -> dict[str, int]:
        """Register a channel for each topic, in their order; returns their numbers."""
        rows = fields_of(layout)
        items = {topic.topic: topic for topic in JSON_TOPICS}
        ros = {topic.topic: topic for topic in ROS_TOPICS}
        channels: dict[str, int] = {}
        schemas: dict[str, int] = {}
        for topic in topics_of(layout):
            kind, encoding = SchemaEncoding.ROS2, MessageEncoding.CDR
            if topic in rows:
                name = f"pepper_driver/msg/{topic.removeprefix('/').capitalize()}"
                text = message_definition(rows[topic])
            elif topic in ros:
                name, text = ros[topic].type, ros[topic].schema
            else:
                kind, encoding = SchemaEncoding.JSONSchema, MessageEncoding.JSON
                name, text = f"pepper_driver.{items[topic].name}", items[topic].schema
            if name not in schemas:
                schemas[name] = self._writer.register_schema(name, kind, text.encode())
            channels[topic] = self._writer.register_channel(topic, encoding, schemas[name])
        return channels

    def write_row(self, topic: str, time: float, message: bytes) -> None:
        """Write a message in CDR, of a table such as ``/tick`` or of ROS 2, stamped ``time`` [s]."""
        self._write(self._channels[topic], nanoseconds(time), message, self._sequence)

    def write_item(self, topic: JsonTopic[T], time: float, item: T) -> None:
        """Write a contact, label or event, stamped ``time`` [s].

        Raises:
            TypeError: A value of the item is neither text nor number.
        """
        self.write_row(topic.topic, time, topic.encode(item))

    def copy(self, message: Message) -> None:
        """Write a message of another file of the same layout, with its number and stamp."""
        self._write(message.channel, message.time, message.data, message.sequence)

    def _write(self, channel: int, stamp: int, data: bytes, sequence: int) -> None:
        self._writer.add_message(
            channel, log_time=stamp, publish_time=stamp, data=data, sequence=sequence
        )
        self._sequence = (sequence + 1) % SEQUENCES

    def _write_metadata(self) -> None:
        for name, values in self._metadata.items():
            self._writer.add_metadata(name, values)

    def flush(self) -> None:
        """Hand all finished chunks to the operating system."""
        self._stream.flush()

    def finish(self, *, complete: bool = True) -> None:
        """Write the metadata once more, index and footer; close the file.

        Args:
            complete: False where further messages are missing.
        """
        self._write_metadata()
        messages = str(self._sequence) if complete else UNKNOWN
        self._writer.add_metadata(END, with_checksum({"messages": messages}))
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()
        self._lock.release()

    def abandon(self) -> None:
        """Close the file as it is."""
        with suppress(OSError):
            self._stream.close()
        self._lock.release()


def _lock(path: Path) -> FileLock:
    """Lock a file that can be a log, and make its folder."""
    try:
        # A device or pipe would block, or be removed when something fails.
        if path.exists() and not path.is_file():
            kind = "it is a folder" if path.is_dir() else "not a regular file"
            raise LogError(f"{path}: cannot be written ({kind})")
        path.parent.mkdir(parents=True, exist_ok=True)
        return lock_file(path)
    except (OutputError, LogError):
        raise
    except OSError as error:
        raise LogError(f"{path}: its folder cannot be made ({reason(error)})") from error
    except ValueError as error:
        raise LogError(f"{path}: cannot be written ({reason(error)})") from error


def nanoseconds(time: float) -> int:
    """``time`` [s] as an MCAP stamp; 0 where there is none: negative or not finite."""
    return round(time * 1e9) if 0 <= time < 2**33 else 0


def _read_urdf(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read for the log ({reason(error)})") from error


logger = logging.getLogger("pepper_driver")

DRAIN_PERIOD = 0.05
"""[s] Sleep of the writer thread between two checks of the ring."""
BLOCK = 8
"""Rows written in one go: a fraction of a millisecond, for the tick must not wait long for the interpreter."""
LOSSLESS_PERIOD = 0.25
"""[s] The same in simulated time, where no tick is due: all rows go at once, and other ticks are left alone."""
BACKLOG_SLEEP = 0.001
"""[s] Sleep between blocks of a backlog."""


_Row = tuple[int, "TickRecord"]
"""Number of a tick, from 0, and the tick."""


class LogWriter:
    """Writes one run to an MCAP file.

    One thread appends and closes. The file is usable at any time: a killed process loses less than
    a second of it. Use it as a context manager, or call :meth:`close`; without either the file
    lacks its index, but can be read.

    Args:
        path: File to write; missing folders are made, an existing file is replaced.
        robot: The robot whose ticks will come.
        metadata: Text about the run. Plots show ``backend``, and ``seed`` where there is one.
        capacity: Rows that fit in the ring; at 12 ms the default is 49 s.
        lossless: Wait for room when the ring is full, instead of dropping the row. For simulated
            time.

    Raises:
        InUseError: Another run writes this file.
        LogError: The file cannot be written. Nothing half-written stays behind.
        ValueError: A capacity below 1.
    """

    def __init__(
        self,
        path: Path,
        robot: RobotConfig,
        metadata: Mapping[str, str],
        *,
        capacity: int = 4096,
        lossless: bool = False,
    ) -> None:
        if capacity < 1:
            raise ValueError(f"a log needs room for at least one row, got capacity {capacity}")
        self._path = Path(path)
        self._lossless = lossless
        self._period, self._block = (
            (LOSSLESS_PERIOD, capacity) if lossless else (DRAIN_PERIOD, BLOCK)
        )
        self._capacity = capacity
        self._ring: list[_Row | LogEvent | None] = [None] * capacity
        self._tick_rows = Rows(TICK_FIELDS, robot)
        self._unmatched_rows = Rows(UNMATCHED_FIELDS, robot)
        self._truth_rows = Rows(TRUTH_FIELDS, robot)
        self._unobserved = unobserved(robot)
        self._ros = RobotMessages(robot, _read_urdf(robot.urdf))
        self._described = False
        self._steps = 0
        # Rows ever put in and taken out. Each is written by one thread: the ring needs no lock.
        self._head = 0
        self._tail = 0
        self._dropped = 0
        self._lost = 0
        self._problem: Exception | None = None
        self._failure: Exception | None = None
        self._closing = False
        self._wake = threading.Event()
        self._room = threading.Event()
        self._file = McapFile(self._path, layout_metadata(robot), metadata)
        self._thread = threading.Thread(target=self._run, name="pepper_driver.log", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    @property
    def dropped(self) -> int:
        """Rows and contacts appended but not in the file; a lower bound once the disk has failed."""
        return self._dropped + self._lost

    def append(self, record: TickRecord) -> None:
        """Put one tick into the ring. Never raises; waits only for room, when ``lossless``.

        Without an observation its values are logged as NaN, with all joints blind.
        """
        step, self._steps = self._steps, self._steps + 1
        self._put((step, record))

    def note(self, event: LogEvent) -> None:
        """Log what happened outside any tick. Never raises; waits only for room, when ``lossless``."""
        self._put(event)

    def _put(self, entry: _Row | LogEvent) -> None:
        head = self._head
        if self._closing or (head - self._tail >= self._capacity and not self._wait_for_room()):
            self._dropped += 1
            return
        # In this order: the writer thread reads up to the head.
        self._ring[head % self._capacity] = entry
        self._head = head + 1

    def _wait_for_room(self) -> bool:
        while self._lossless and not self._closing and self._thread.is_alive():
            # Cleared before the check: room that is made in between wakes the wait below.
            self._room.clear()
            if self._head - self._tail < self._capacity:
                return True
            self._wake.set()
            self._room.wait(DRAIN_PERIOD)
        return False

    def close(self) -> None:
        """Write what is in the ring, finish the file, stop the thread. Does nothing when closed.

        Raises:
            LogError: The disk failed, now or earlier; the file then ends there. Raised once.
        """
        first, self._closing = not self._closing, True
        self._wake.set()
        self._thread.join()
        if first and self.dropped:
            because = f" ({reason(self._problem)})" if self._problem else ""
            logger.warning("%s: %d rows are missing%s", self._path, self.dropped, because)
        failure, self._failure = self._failure, None
        if failure is not None:
            raise LogError(f"{self._path}: log is cut short ({reason(failure)})") from failure

    def _run(self) -> None:
        closing = False
        while not closing:
            self._wake.wait(self._period)
            self._wake.clear()
            closing = self._closing  # read before the ring: no row follows it
            self._drain(pause=0.0 if closing else BACKLOG_SLEEP)
        try:
            if self._failure is None:
                self._file.finish()
        except Exception as error:
            self._fail(error)
        self._file.abandon()

    def _drain(self, pause: float) -> None:
        while (start := self._tail) < self._head:
            stop = min(self._head, start + self._block)
            try:
                if self._failure is None:
                    for index in range(start, stop):
                        self._write(index % self._capacity)
                    self._file.flush()
                else:
                    self._lost += stop - start
            except Exception as error:  # nothing may end this thread: append would wait for it
                self._lost += stop - start
                self._fail(error)
            self._tail = stop
            self._room.set()
            if pause:
                time.sleep(pause)

    def _write(self, slot: int) -> None:
        # Not kept in the ring: the arrays of 4096 ticks would stay in memory.
        entry, self._ring[slot] = self._ring[slot], None
        if isinstance(entry, LogEvent):
            self._write_item(EVENTS, entry.time, entry)
        elif entry is not None:
            self._write_tick(*entry)

    def _write_tick(self, step: int, record: TickRecord) -> None:
        tick, observation, truth = record.tick, record.observation, record.truth
        time = 0.0
        try:
            measurement = tick.measurement
            time = float(measurement.time)
            stamp = nanoseconds(time)
            row = self._tick_rows.message(
                TickRow(
                    measurement,
                    tick.reference,
                    tick.sent,
                    tick.limited,
                    self._unobserved if observation is None else observation,
                    step,
                    record.tick_end,
                    record.missed,
                )
            )
            passed_over = [
                self._unmatched_rows.message(
                    UnmatchedRow(time, step - ago, sent.sent, sent.reference, sent.limited)
                )
                for ago, sent in record.unmatched
            ]
            truth_row = None if truth is None else self._truth_rows.message(TruthRow(time, truth))
            acting = () if truth is None else truth.contacts
            forces = [FORCES.encode(TrueForce.of(contact, time)) for contact in acting]
            ros = () if self._described else self._ros.once(stamp)
            if step % EVERY == 0:
                sample = self._ros.sample(stamp, measurement.position, record.base_pose)
                ros = (*ros, *sample)
        except Exception as error:  # of the code that made the arrays; not the disk's
            self._problem = error
            self._lost += 1
        else:
            self._file.write_row(TICK_TOPIC, time, row)
            for message in passed_over:
                self._file.write_row(UNMATCHED_TOPIC, time, message)
            if truth_row is not None:
                self._file.write_row(TRUTH_TOPIC, time, truth_row)
            for force in forces:
                self._file.write_row(FORCES.topic, time, force)
            for topic, message in ros:
                self._file.write_row(topic, time, message)
            self._described = True
        for label in record.labels:
            self._write_item(LABELS, time, label)
        for contact in () if observation is None else observation.contacts:
            self._write_item(CONTACTS, time, contact)
        for event in record.events:
            self._write_item(EVENTS, time, LogEvent.of(event))

    def _write_item(self, topic: JsonTopic[Any], time: float, item: object) -> None:
        try:
            self._file.write_item(topic, time, item)
        except (TypeError, ValueError) as error:  # a mistake of who made it, not the disk's
            self._problem = error
            self._lost += 1

    def _fail(self, error: Exception) -> None:
        self._failure = error
        logger.error("%s: log is cut short (%s)", self._path, reason(error))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except LogError:
            if error is None:  # the error of the block says more; this one is logged
                raise
