"""Records of an MCAP file, found where they are intact: damaged bytes cost only the chunk that they are in.

Nothing depends on the order of records or on the index: each chunk is found by its header and judged by its checksum.
Metadata has none in MCAP, so the writer puts one into it.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
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
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length of what follows, channel, sequence, times
_FOOTER_SIZE = _HEADER.size + 8 + 8 + 4


class Message(NamedTuple):
    """One message: number of its channel, running number in the file, time stamp [ns], contents."""

    channel: int
    sequence: int
    time: int
    data: bytes


def with_checksum(data: Mapping[str, str]) -> dict[str, str]:
    """Return metadata with its checksum."""
    return {**data, CHECKSUM: _checksum(data)}


def find_metadata(data: bytes, names: tuple[str, ...]) -> dict[str, dict[str, str]]:
    """Return the first intact metadata of each name in a file, where there is one."""
    found = {name: _find_metadata(data, name) for name in names}
    return {name: values for name, values in found.items() if values is not None}


def find_chunks(data: bytes) -> Iterator[bytes | None]:
    """Yield what is in each chunk that is there to its end; None for one that is damaged."""
    decompressor, position = zstandard.ZstdDecompressor(), 0
    while (found := data.find(_COMPRESSION, position)) >= 0:
        position = found + 1
        begin = found - _COMPRESSION_OFFSET
        if begin < 0 or (end := _chunk_end(data, begin)) is None:
            continue  # these bytes mean something else, or the file ends before the chunk does
        contents = _decompress(data, begin, end, decompressor)
        if contents is not None:
            position = end
        yield contents


def messages_in(contents: bytes) -> Iterator[Message]:
    """Yield the messages of a chunk."""
    position, end = 0, len(contents)
    while (
        position + _MESSAGE.size <= end
    ):  # no other record matters: the rest is smaller, or padding
        opcode, length, channel, sequence, time, _ = _MESSAGE.unpack_from(contents, position)
        start = position + _MESSAGE.size
        position += _HEADER.size + length
        if opcode == Opcode.MESSAGE and start <= position:
            yield Message(channel, sequence, time, contents[start:position])


def is_finished(data: bytes) -> bool:
    """Return True where a file ends as its writer ended it."""
    footer = len(data) - len(MCAP0_MAGIC) - _FOOTER_SIZE
    return (
        footer >= 0
        and data.endswith(MCAP0_MAGIC)
        and _HEADER.unpack_from(data, footer) == (Opcode.FOOTER, _FOOTER_SIZE - _HEADER.size)
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


def _decompress(
    data: bytes, begin: int, end: int, decompressor: zstandard.ZstdDecompressor
) -> bytes | None:
    """Return what is in a chunk; None where it is damaged."""
    start = begin + _HEADER.size
    _, _, size, checksum, *_ = _CHUNK.unpack_from(data, start)
    compressed = data[start + _CHUNK.size : end]
    try:
        if size > MAX_CHUNK or zstandard.frame_content_size(compressed) != size:
            return None
        contents = decompressor.decompress(compressed)
    except zstandard.ZstdError:
        return None
    return contents if zlib.crc32(contents) == checksum else None


# -- metadata -------------------------------------------------------------------------------------------------


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
