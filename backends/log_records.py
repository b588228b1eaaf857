"""Records of an MCAP file, found where they are intact: damaged bytes cost only the chunk that they are in.

Nothing depends on the order of records or on the index: each chunk is found by its header and judged by its checksum.
Metadata has none in MCAP, so the writer puts one into it.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

MAX_CHUNK = 2**26
"""[bytes] Largest chunk before compression: more is a damaged length."""

CHECKSUM = "crc32"
"""Key of the checksum in metadata."""

_HEADER = struct.Struct("<BQ")  # opcode, length of what follows
_CHUNK = struct.Struct(
    "<QQQII4sQ"
)  # times, size, checksum, length and name of the compression, compressed size
_COMPRESSION = struct.pack("<I4s", 4, b"zstd")
_COMPRESSION_OFFSET = _HEADER.size + 8 + 8 + 8 + 4
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, times
_FOOTER_SIZE = _HEADER.size + 8 + 8 + 4


class Message(NamedTuple):
    """One message: number of its channel, running number in the file, time stamp [ns], contents."""

    channel: int
    sequence: int
    time: int
    data: bytes


@dataclass(frozen=True, kw_only=True)
class Records:
    """Intact records of a file.

    Attributes:
        messages: In the order of the file.
        damaged: For each chunk that is there to its end, but damaged: how many of the messages come before it.
        metadata: The first intact record of each name.
        finished: True where the file ends as its writer ended it.
    """

    messages: tuple[Message, ...]
    damaged: tuple[int, ...]
    metadata: dict[str, dict[str, str]]
    finished: bool


def with_checksum(data: Mapping[str, str]) -> dict[str, str]:
    """Return metadata with its checksum."""
    return {**data, CHECKSUM: _checksum(data)}


def find_records(data: bytes, names: tuple[str, ...]) -> Records:
    """Find all intact chunks of a file, and the metadata of these names."""
    messages: list[Message] = []
    damaged: list[int] = []
    position = 0
    while (found := data.find(_COMPRESSION, position)) >= 0:
        position = found + 1
        begin = found - _COMPRESSION_OFFSET
        if begin < 0 or (end := _chunk_end(data, begin)) is None:
            continue  # these bytes mean something else, or the file ends before the chunk does
        contents = _decompress(data, begin, end)
        if contents is None:
            damaged.append(len(messages))
            continue
        messages += _messages(contents)
        position = end
    found_metadata = {name: _find_metadata(data, name) for name in names}
    return Records(
        messages=tuple(messages),
        damaged=tuple(damaged),
        metadata={name: values for name, values in found_metadata.items() if values is not None},
        finished=_is_finished(data),
    )


# -- chunks -------------------------------------------------------------------------------------------------------


def _chunk_end(data: bytes, begin: int) -> int | None:
    """Return the end of a chunk; None without one."""
    start = begin + _HEADER.size
    if start + _CHUNK.size > len(data):
        return None
    opcode, length = _HEADER.unpack_from(data, begin)
    compressed = _CHUNK.unpack_from(data, start)[-1]
    end: int = start + length
    is_chunk = opcode == Opcode.CHUNK and length == _CHUNK.size + compressed and end <= len(data)
    return end if is_chunk else None


def _decompress(data: bytes, begin: int, end: int) -> bytes | None:
    """Return what is in a chunk; None where it is damaged."""
    start = begin + _HEADER.size
    _, _, size, checksum, *_ = _CHUNK.unpack_from(data, start)
    compressed = data[start + _CHUNK.size : end]
    try:
        if size > MAX_CHUNK or zstandard.frame_content_size(compressed) != size:
            return None
        contents = zstandard.ZstdDecompressor().decompress(compressed)
    except zstandard.ZstdError:
        return None
    return contents if zlib.crc32(contents) == checksum else None


def _messages(contents: bytes) -> Iterator[Message]:
    for opcode, body in _records(contents):
        if opcode == Opcode.MESSAGE and len(body) >= _MESSAGE.size:
            channel, sequence, time, _ = _MESSAGE.unpack_from(body)
            yield Message(channel, sequence, time, bytes(body[_MESSAGE.size :]))


def _records(contents: bytes) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and body of each record of a chunk."""
    view, position = memoryview(contents), 0
    while position + _HEADER.size <= len(view):
        opcode, length = _HEADER.unpack_from(view, position)
        start = position + _HEADER.size
        position = start + length
        yield opcode, view[start:position]


# -- metadata and end ---------------------------------------------------------------------------------------------


def _find_metadata(data: bytes, name: str) -> dict[str, str] | None:
    """Return the first intact metadata of a name, without its checksum; else the first without a checksum, if any."""
    signature = struct.pack("<I", len(name)) + name.encode()
    position, unchecked = 0, None
    while (found := data.find(signature, position)) >= 0:
        position = found + 1
        values = _metadata(data, found - _HEADER.size)
        if values is None:
            continue
        checksum = values.pop(CHECKSUM, None)
        if checksum == _checksum(values):
            return values
        if checksum is None and unchecked is None:
            unchecked = values
    return unchecked


def _metadata(data: bytes, begin: int) -> dict[str, str] | None:
    """Return the values of a metadata record, unchecked; None without a record."""
    if begin < 0:
        return None
    opcode, length = _HEADER.unpack_from(data, begin)
    start = begin + _HEADER.size
    if opcode != Opcode.METADATA or start + length > len(data):
        return None
    try:
        record = Metadata.read(ReadDataStream(BytesIO(data[start : start + length])))
        return {str(name): str(value) for name, value in record.metadata.items()}
    except Exception:  # the decoder raises anything on damaged bytes
        return None


def _checksum(data: Mapping[str, str]) -> str:
    return str(zlib.crc32(json.dumps(data, sort_keys=True).encode()))


def _is_finished(data: bytes) -> bool:
    footer = len(data) - len(MCAP0_MAGIC) - _FOOTER_SIZE
    return (
        footer >= 0
        and data.endswith(MCAP0_MAGIC)
        and _HEADER.unpack_from(data, footer) == (Opcode.FOOTER, _FOOTER_SIZE - _HEADER.size)
    )
