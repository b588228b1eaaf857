"""Values shared by the robot's process and NAOqi's: a block of memory, its keys, and the black box."""

from __future__ import annotations

import json
import mmap
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.dcm import DcmClock
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.naoqi_devices import NaoqiDevices


def table_keys(robot: RobotConfig, devices: NaoqiDevices) -> dict[str, int]:
    """Place of every key in the table: actuators first, in the order of the DCM, then sensors, then the date."""
    sensors = [key for key in devices.values if key not in set(devices.actuators)]
    return {
        key: place for place, key in enumerate([*devices.actuators, *sensors, robot.naoqi.time])
    }


KEPT_CYCLES = 10_000
"""Kept: two minutes."""


def row_type(robot: RobotConfig) -> np.dtype[np.void]:
    """One cycle in the black box; fields as in :class:`BlackBox`."""
    joints, wheels = len(robot.joint_names), len(robot.wheels.names)
    return np.dtype(
        [
            ("cycle", np.int64),
            ("date", np.int32),
            ("begin", np.int64),
            ("end", np.int64),
            ("orders", np.int64),
            ("wheel_order", np.int64),
            ("position", np.float64, joints),
            ("wheel_speed", np.float64, wheels),
            ("base", np.float64, 3),
            ("position_command", np.float64, joints),
            ("stiffness", np.float64, joints),
            ("wheel_command", np.float64, wheels),
            ("wheel_stiffness", np.float64, wheels),
        ]
    )


@dataclass(frozen=True, kw_only=True)
class BlackBox:
    """Cycles of the robot, oldest first; n rows each.

    Attributes:
        cycle: (n,) number of the cycle since the robot started; numbers are left out where the machine was too slow.
        date: (n,) DCM time of the cycle [ms], 32 bits.
        begin: (n,) when it was due, on the machine's monotonic clock [s]: ``time.monotonic()`` of any process.
        end: (n,) when its values were published [s].
        orders: (n,) orders that the DCM had accepted by then.
        wheel_order: (n,) time at which the last one for a wheel's speed was accepted, on the same clock [s]; 0 before
            the first.
        position: (n, 17) true joint positions at the end of the cycle [rad], without encoder and transport.
        wheel_speed: (n, 3) true speeds [rad/s].
        base: (n, 3) where the base is: x, y [m], yaw [rad].
        position_command: (n, 17) what the DCM sent to the joints [rad].
        stiffness: (n, 17) what it sent as their hardness.
        wheel_command: (n, 3) what it sent to the wheels [rad/s].
        wheel_stiffness: (n, 3) and as their stiffness.
    """

    cycle: IntArray
    date: NDArray[np.int32]
    begin: FloatArray
    end: FloatArray
    orders: IntArray
    wheel_order: FloatArray
    position: FloatArray
    wheel_speed: FloatArray
    base: FloatArray
    position_command: FloatArray
    stiffness: FloatArray
    wheel_command: FloatArray
    wheel_stiffness: FloatArray

    @classmethod
    def of(cls, rows: NDArray[np.void]) -> BlackBox:
        """From rows of the type :func:`row_type`."""
        columns = {name: np.array(rows[name]) for name in rows.dtype.names or ()}
        columns |= {name: rows[name] / 1e9 for name in ("begin", "end", "wheel_order")}
        return cls(**columns)

    def __len__(self) -> int:
        return len(self.cycle)


_INFO = 8192
"""Bytes for what the robot says of itself."""

_COUNT, _BEGIN, _ORIGIN, _INFO_SIZE, _ROWS = range(5)
"""Places in the header."""

_HEADER = 8


class Table:
    """One file without a name, mapped by every process that was handed its descriptor.

    The values stand in it twice. The writer fills the half that is not being read and then counts up, so that a reader
    is never held up, not even by a writer that was stopped in the middle; a reader that was itself so slow that the
    count went on reads again.

    Args:
        file: Descriptor of the file; see :meth:`make_file`.
        keys: Number of values.
        robot: Whose joints the black box shows.
        kept: Cycles that the black box keeps.
    """

    def __init__(
        self, file: int, keys: int, robot: RobotConfig, *, kept: int = KEPT_CYCLES
    ) -> None:
        rows, self._kept = row_type(robot), kept
        sizes = [8 * _HEADER, _INFO, 2 * 8 * keys, kept * rows.itemsize]
        # Whichever process maps the file first makes it large enough.
        if os.fstat(file).st_size < sum(sizes):
            os.ftruncate(file, sum(sizes))
        memory = mmap.mmap(file, sum(sizes))
        begins = [sum(sizes[:number]) for number in range(len(sizes))]
        self._header = np.ndarray(_HEADER, np.int64, memory, begins[0])
        self._info = np.ndarray(_INFO, np.uint8, memory, begins[1])
        self._values = np.ndarray((2, keys), np.float64, memory, begins[2])
        self._rows = np.ndarray(kept, rows, memory, begins[3])

    @staticmethod
    def make_file() -> int:
        """Descriptor of a new file in memory, removed with the last process that has it."""
        folder = "/dev/shm" if os.path.isdir("/dev/shm") else None
        with tempfile.TemporaryFile(dir=folder) as file:
            # The file has no name: the duplicate keeps it after the block.
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
        # Last: from now on readers take this half.
        self._header[_COUNT] = count

    def record(self, row: tuple[Any, ...]) -> None:
        """Put a cycle into the black box."""
        count = int(self._header[_ROWS])
        self._rows[count % self._kept] = row
        self._header[_ROWS] = count + 1

    @property
    def count(self) -> int:
        """Samples published; 0 before the robot runs."""
        return int(self._header[_COUNT])

    def read(self) -> FloatArray:
        """Return a copy of the newest values of all keys, all of one cycle."""
        for _ in range(100):
            count = int(self._header[_COUNT])
            values: FloatArray = self._values[count & 1].copy()
            # Else the writer may already fill this half again.
            if int(self._header[_COUNT]) == count:
                return values
        raise BackendError("the stand-in's table cannot be read: this process is far too slow")

    @property
    def clock(self) -> DcmClock:
        """The robot's clock."""
        return DcmClock(begin=int(self._header[_BEGIN]), origin=int(self._header[_ORIGIN]))

    @property
    def info(self) -> dict[str, Any]:
        """Description of the robot."""
        info: dict[str, Any] = json.loads(self._info[: self._header[_INFO_SIZE]].tobytes())
        return info

    def black_box(self, last: int | None = None) -> BlackBox:
        """Return the last cycles in the black box; all that is kept, or that many."""
        count = int(self._header[_ROWS])
        first = max(0, count - self._kept, count - last if last is not None else 0)
        rows: NDArray[np.void] = self._rows[np.arange(first, count) % self._kept]
        # What the robot wrote over meanwhile, and the row it may be at now.
        lost = max(0, int(self._header[_ROWS]) + 1 - self._kept - first)
        return BlackBox.of(rows[lost:])
