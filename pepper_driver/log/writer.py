"""The log as the tick sees it: copy a row into a ring and go on; a thread takes it to the disk."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from pepper_driver.backends.interface import Truth
from pepper_driver.config import RobotConfig
from pepper_driver.controller.tick import Tick
from pepper_driver.log.errors import LogError
from pepper_driver.log.label import Label
from pepper_driver.log.mcap_file import McapFile, reason
from pepper_driver.log.schema import (
    columns,
    tick_fields,
    tick_parts,
    truth_fields,
    truth_parts,
    unobserved,
)
from pepper_driver.observer.contact import Contact
from pepper_driver.observer.interface import Observation

logger = logging.getLogger("pepper_driver")

DRAIN_PERIOD = 0.05
"""[s] Sleep of the writer thread between two looks at the ring."""
BLOCK = 32
"""Rows written in one go: below a millisecond, the tick must not wait long for the interpreter."""
PAUSE = 0.001
"""[s] Sleep between blocks of a backlog."""


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
        self._capacity = capacity
        self._rows = np.zeros((capacity, columns(tick_fields(robot))))
        self._truth_rows = np.zeros((capacity, columns(truth_fields(robot))))
        self._has_truth = [False] * capacity
        self._contacts: list[tuple[Contact, ...]] = [()] * capacity
        self._labels: list[tuple[Label, ...]] = [()] * capacity
        self._times = [0.0] * capacity
        self._scalars = np.zeros(5)
        self._unobserved = unobserved(robot)
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
        self._file = McapFile(self._path, robot, metadata)
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

    def append(
        self,
        tick: Tick,
        observation: Observation | None,
        truth: Truth | None = None,
        labels: Sequence[Label] = (),
    ) -> None:
        """Copy one tick into the ring. Never raises; waits only for room, when ``lossless``.

        Args:
            tick: The cycle.
            observation: What the observer made of it. None is logged as NaN, with all joints blind.
            truth: Ground truth of a simulation, copied at once.
            labels: Ends of touches seen in this tick.
        """
        head = self._head
        if self._closing or (head - self._tail >= self._capacity and not self._wait_for_room()):
            self._dropped += 1
            return
        slot = head % self._capacity
        seen = self._unobserved if observation is None else observation
        try:
            np.concatenate(tick_parts(tick, seen, self._scalars), out=self._rows[slot])
            self._has_truth[slot] = truth is not None
            if truth is not None:
                parts = truth_parts(tick.measurement.time, truth)
                np.concatenate(parts, out=self._truth_rows[slot])
            self._times[slot] = float(tick.measurement.time)
            self._contacts[slot] = seen.contacts
            self._labels[slot] = tuple(labels)
        except Exception as error:  # a row of wrong shape must not stop a robot
            self._problem = error
            self._dropped += 1
            return
        self._head = head + 1

    def _wait_for_room(self) -> bool:
        while self._lossless and not self._closing and self._thread.is_alive():
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
            self._wake.wait(DRAIN_PERIOD)
            self._wake.clear()
            closing = self._closing  # before the look at the ring: nothing comes after it
            self._drain(pause=0.0 if closing else PAUSE)
        try:
            if self._failure is None:
                self._file.finish()
        except Exception as error:
            self._fail(error)
        self._file.abandon()

    def _drain(self, pause: float) -> None:
        while (start := self._tail) < self._head:
            stop = min(self._head, start + BLOCK)
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
        stamp = self._times[slot]
        self._file.write_tick(stamp, self._rows[slot])
        if self._has_truth[slot]:
            self._file.write_truth(stamp, self._truth_rows[slot])
        for label in self._labels[slot]:
            self._file.write_label(stamp, label)
        for contact in self._contacts[slot]:
            try:
                self._file.write_contact(stamp, contact)
            except (TypeError, ValueError) as error:  # an observer's mistake, not the disk's
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
            if error is None:  # else the error of the block says more; this one is in the logging
                raise
