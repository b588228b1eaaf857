"""The MCAP file under a log: opened, filled message by message, finished."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from pepper_driver.backends.log_file import TICK_TOPIC, UNANSWERED_TOPIC, LogError, reason
from pepper_driver.config import RobotConfig
from pepper_driver.log.contacts import CONTACTS
from pepper_driver.log.event import EVENTS
from pepper_driver.log.json_topic import JsonTopic
from pepper_driver.log.label import LABELS
from pepper_driver.log.schema import (
    TRUTH_TOPIC,
    layout_metadata,
    message_definition,
    tick_fields,
    truth_fields,
    unanswered_fields,
)

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
        robot: Gives the widths of the fields and the names stored with them.
        metadata: Text for the ``run`` record.

    Raises:
        LogError: The file cannot be made. Nothing half-written stays behind.
    """

    def __init__(self, path: Path, robot: RobotConfig, metadata: Mapping[str, str]) -> None:
        self._sequence = 0
        try:
            # A device or pipe would block, or be removed below when something fails.
            if path.exists() and not path.is_file():
                kind = "a directory" if path.is_dir() else "not a regular file"
                raise LogError(f"{path}: cannot be written ({kind})")
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise LogError(f"{path}: its folder cannot be made ({reason(error)})") from error
            self._stream = open_file(path)
        except LogError:
            raise
        except (OSError, ValueError) as error:
            raise LogError(f"{path}: cannot be written ({reason(error)})") from error
        try:
            self._writer = Writer(self._stream, chunk_size=CHUNK_SIZE)
            self._writer.start(library="pepper_driver")
            self._writer.add_metadata("run", dict(metadata))
            self._writer.add_metadata("layout", layout_metadata(robot))
            self._tick = self._ros_channel(
                TICK_TOPIC, "Tick", message_definition(tick_fields(robot))
            )
            self._unanswered = self._ros_channel(
                UNANSWERED_TOPIC, "Unanswered", message_definition(unanswered_fields(robot))
            )
            self._truth = self._ros_channel(
                TRUTH_TOPIC, "Truth", message_definition(truth_fields(robot))
            )
            self._json = {
                topic.topic: self._json_channel(topic) for topic in (CONTACTS, LABELS, EVENTS)
            }
            self._stream.flush()
        except BaseException as error:
            self.abandon()
            with suppress(OSError):
                path.unlink()
            if isinstance(error, OSError | ValueError):
                raise LogError(f"{path}: cannot be written ({reason(error)})") from error
            raise

    def _ros_channel(self, topic: str, name: str, definition: str) -> int:
        schema = self._writer.register_schema(
            f"pepper_driver/msg/{name}", SchemaEncoding.ROS2, definition.encode()
        )
        return self._writer.register_channel(topic, MessageEncoding.CDR, schema)

    def _json_channel(self, topic: JsonTopic[Any]) -> int:
        schema = self._writer.register_schema(
            f"pepper_driver.{topic.name}", SchemaEncoding.JSONSchema, topic.schema.encode()
        )
        return self._writer.register_channel(topic.topic, MessageEncoding.JSON, schema)

    def write_tick(self, time: float, message: bytes) -> None:
        """Write a message of ``/tick``, stamped ``time`` [s]."""
        self._write(self._tick, time, message)

    def write_unanswered(self, time: float, message: bytes) -> None:
        """Write a message of ``/unanswered``, stamped ``time`` [s]."""
        self._write(self._unanswered, time, message)

    def write_truth(self, time: float, message: bytes) -> None:
        """Write a message of ``/truth``, stamped ``time`` [s]."""
        self._write(self._truth, time, message)

    def write_item(self, topic: JsonTopic[T], time: float, item: T) -> None:
        """Write a contact, label or event, stamped ``time`` [s].

        Raises:
            TypeError: A value of the item is neither text nor number.
        """
        self._write(self._json[topic.topic], time, topic.encode(item))

    def _write(self, channel: int, time: float, data: bytes) -> None:
        stamp = nanoseconds(time)
        self._writer.add_message(
            channel, log_time=stamp, publish_time=stamp, data=data, sequence=self._sequence
        )
        self._sequence = (self._sequence + 1) % 2**32

    def flush(self) -> None:
        """Hand all finished chunks to the operating system."""
        self._stream.flush()

    def finish(self) -> None:
        """Write index and footer, close the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        with suppress(OSError):
            self._stream.close()


def nanoseconds(time: float) -> int:
    """``time`` [s] as an MCAP stamp; 0 where there is none: negative or not finite."""
    return round(time * 1e9) if 0 <= time < 2**33 else 0
