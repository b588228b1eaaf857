"""The MCAP file under a log: opened, filled message by message, finished."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pepper_driver.backends.log_file import (
    END,
    LAYOUT,
    RUN,
    SEQUENCES,
    UNKNOWN,
    LogError,
    fields_of,
    topics_of,
)
from pepper_driver.backends.log_records import Message, with_checksum
from pepper_driver.config.errors import reason
from pepper_driver.config.file_lock import FileLock, lock_file
from pepper_driver.config.files import OutputError
from pepper_driver.log.json_topic import JsonTopic
from pepper_driver.log.schema import JSON_TOPICS, message_definition

T = TypeVar("T")

CHUNK_SIZE = 64 * 1024
"""[bytes] A killed process loses the chunk it was filling: at 12 ms, a third of a second."""


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
        channels = {}
        for topic in topics_of(layout):
            name, encoding = topic.removeprefix("/").capitalize(), MessageEncoding.CDR
            if topic in rows:
                schema = self._writer.register_schema(
                    f"pepper_driver/msg/{name}",
                    SchemaEncoding.ROS2,
                    message_definition(rows[topic]).encode(),
                )
            else:
                encoding, item = MessageEncoding.JSON, items[topic]
                schema = self._writer.register_schema(
                    f"pepper_driver.{item.name}", SchemaEncoding.JSONSchema, item.schema.encode()
                )
            channels[topic] = self._writer.register_channel(topic, encoding, schema)
        return channels

    def write_row(self, topic: str, time: float, message: bytes) -> None:
        """Write a message of a table such as ``/tick``, stamped ``time`` [s]."""
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
