"""A disk that gets full while a log is written."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path
from typing import BinaryIO, cast

import pytest

from pepper_driver.log import writer


class FullDisk(io.RawIOBase):
    """A disk with room for so many bytes."""

    def __init__(self, path: Path, room: int, error: int) -> None:
        self._file = path.open("wb", buffering=0)
        self._room = room
        self._error = error

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        view = memoryview(cast(bytes, data))
        written = self._file.write(view[: max(0, self._room)]) or 0
        self._room -= written
        if written == 0 and len(view):
            raise OSError(self._error, os.strerror(self._error))
        return written

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def close(self) -> None:
        self._file.close()
        super().close()


def limit_disk(monkeypatch: pytest.MonkeyPatch, room: int, error: int = errno.ENOSPC) -> None:
    def open_file(path: Path) -> BinaryIO:
        return cast(BinaryIO, io.BufferedWriter(FullDisk(path, room, error)))

    monkeypatch.setattr(writer, "open_file", open_file)
