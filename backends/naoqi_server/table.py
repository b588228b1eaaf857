"""Memory that the robot process writes once a cycle and other processes read: values of all keys, and the black box."""

from __future__ import annotations

import json
import mmap
import os
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.black_box import CYCLES, BlackBox, row_type
from pepper_driver.backends.naoqi_server.clock import DcmClock
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray

_INFO = 8192
"""Bytes for what the robot says of itself."""

_COUNT, _BEGIN, _ORIGIN, _INFO_SIZE, _ROWS = range(5)
"""Places in the header."""

_HEADER = 8


class Table:
    """One file without a name, mapped by every process that was handed its descriptor.

    The values stand in it twice. The writer fills the half that nobody looks at and then counts up, so that a reader is
    never held up, not even by a writer that was stopped in the middle; a reader that was itself so slow that the count
    went on reads again.

    Args:
        file: Descriptor of the file; see :meth:`make_file`.
        keys: Number of values.
        robot: Whose joints the black box shows.
    """

    def __init__(self, file: int, keys: int, robot: RobotConfig) -> None:
        rows = row_type(robot)
        sizes = [8 * _HEADER, _INFO, 2 * 8 * keys, CYCLES * rows.itemsize]
        if os.fstat(file).st_size < sum(sizes):
            os.ftruncate(file, sum(sizes))
        memory = mmap.mmap(file, sum(sizes))
        begins = [sum(sizes[:number]) for number in range(len(sizes))]
        self._header = np.ndarray(_HEADER, np.int64, memory, begins[0])
        self._info = np.ndarray(_INFO, np.uint8, memory, begins[1])
        self._values = np.ndarray((2, keys), np.float64, memory, begins[2])
        self._rows = np.ndarray(CYCLES, rows, memory, begins[3])

    @staticmethod
    def make_file() -> int:
        """Descriptor of a new file in memory, gone with the last process that has it."""
        folder = "/dev/shm" if os.path.isdir("/dev/shm") else None
        with tempfile.TemporaryFile(dir=folder) as file:
            return os.dup(file.fileno())

    def start(self, clock: DcmClock, info: Mapping[str, Any]) -> None:
        """Write what does not change later. Before the first :meth:`publish`."""
        text = json.dumps(info).encode()
        self._info[: len(text)] = np.frombuffer(text, np.uint8)
        self._header[[_BEGIN, _ORIGIN, _INFO_SIZE]] = clock.begin, clock.origin, len(text)

    def publish(self, values: FloatArray | Sequence[float]) -> None:
        """Show the values of a cycle to the readers."""
        count = int(self._header[_COUNT]) + 1
        self._values[count & 1] = values
        self._header[_COUNT] = count

    def record(self, row: tuple[Any, ...]) -> None:
        """Put a cycle into the black box."""
        count = int(self._header[_ROWS])
        self._rows[count % CYCLES] = row
        self._header[_ROWS] = count + 1

    @property
    def count(self) -> int:
        """Samples published; 0 before the robot runs."""
        return int(self._header[_COUNT])

    def read(self) -> FloatArray:
        """A copy of the newest values of all keys, all of one cycle."""
        for _ in range(100):
            count = int(self._header[_COUNT])
            values: FloatArray = self._values[count & 1].copy()
            if int(self._header[_COUNT]) == count:
                return values
        raise BackendError("the stand-in's table cannot be read: this process is far too slow")

    @property
    def clock(self) -> DcmClock:
        """The robot's clock."""
        return DcmClock(begin=int(self._header[_BEGIN]), origin=int(self._header[_ORIGIN]))

    @property
    def info(self) -> dict[str, Any]:
        """What the robot says of itself."""
        info: dict[str, Any] = json.loads(self._info[: self._header[_INFO_SIZE]].tobytes())
        return info

    def black_box(self, last: int | None = None) -> BlackBox:
        """The last cycles in the black box; all that is kept, or that many."""
        count = int(self._header[_ROWS])
        first = max(0, count - CYCLES, count - last if last is not None else 0)
        rows: NDArray[np.void] = self._rows[np.arange(first, count) % CYCLES]
        # What the robot wrote over meanwhile, and the row it may be at now.
        lost = max(0, int(self._header[_ROWS]) + 1 - CYCLES - first)
        return BlackBox.of(rows[lost:])
