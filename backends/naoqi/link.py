"""An open connection as the tick uses it: request a sample, take the one that has come, send commands."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from pepper_driver.backends.interface import BackendError, Measurement
from pepper_driver.backends.naoqi.clock import DcmClock
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.cycles import Cycles, Dating
from pepper_driver.backends.naoqi.keys import VALUES, Alias, SensorKeys, actuator_keys
from pepper_driver.backends.naoqi.lead import measure
from pepper_driver.backends.naoqi.library import Answer
from pepper_driver.backends.naoqi.orders import Orders
from pepper_driver.backends.naoqi.playout import Playout
from pepper_driver.backends.naoqi.reader import Reader
from pepper_driver.backends.naoqi.watchdog import PAUSE, sample_age
from pepper_driver.backends.naoqi.writer import Writer
from pepper_driver.config import RobotConfig
from pepper_driver.config.naoqi import TimingSettings
from pepper_driver.config.parts import FloatArray

TICK_PHASE = 0.6
"""[cycles] after a cycle of the robot at which ticks best begin: its values are there by then, and the next is far."""

REQUEST_CALLS = 25
"""Samples read in a burst, to see how long before a tick its sample must be requested."""

MAX_REQUEST_LEAD = 0.45
"""[cycles] Before that the robot's values of the cycle may not be there yet."""

REQUEST_MARGIN = 0.0005
"""[s] Added to the measured round trip."""


class Link:
    """With the DCM and the memory of one robot. Making it measures the way there, and moves nothing.

    Args:
        connection: Open.
        robot: Its description.
        timing: Of commands and samples.
        delay: Cycles from the date of a command to the sample that shows it.
        now: This computer's clock [ns].

    Attributes:
        trips: Round trips of calls.
        lead: From sending a command to its date [s].
        request_lead: From requesting a sample to the tick that takes it [s].
        newest: What was measured last.

    Raises:
        SlowLinkError: The way to the robot does not allow control in every cycle.
        BackendError: The robot does not know one of its actuators, or sends no good sample.
        NotConnectedError: The connection is lost.
    """

    def __init__(
        self,
        connection: Connection,
        robot: RobotConfig,
        timing: TimingSettings,
        delay: int,
        *,
        now: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self._connection, self._timing, self._now = connection, timing, now
        self._cycle, self._delay = robot.cycle, delay
        self._actuators = actuator_keys(robot)
        self._make_aliases()
        self.trips, replies = measure(
            lambda: int(connection.call("DCM", "getTime", 0)),
            timing,
            connection.address.uri,
            clock=now,
        )
        self.lead = self.trips.lead(timing)
        self._clock = DcmClock(min(replies, key=lambda reply: reply.round_trip))
        dcm, memory = connection.service("DCM"), connection.service("ALMemory")
        keys = SensorKeys(robot)
        self.request_lead, values = self._measure_request(keys)
        first = keys.values(values)
        if isinstance(first, str):
            raise BackendError(
                f"'{connection.address.uri}': the robot sends no good sample: {first}"
            )
        self._read_at = self._watched = now()
        date = self._clock.date(first.shown, self._read_at)
        self._cycles = Cycles(1e3 * robot.cycle, date)
        self._playout = Playout(1e3 * robot.cycle, first)
        self._reader = Reader(memory, dcm, keys, self._clock, first=first, date=date, now=now)
        self._writer = Writer(dcm, timing.largest_step, now)
        self._orders: Orders | None = None
        self._written = 0
        self._requested = False
        self.newest = self._measurement(0.0)
        self._reader.ask()

    def start(self) -> FloatArray:
        """Give commands from now on; returns the stiffness (17,) that the joints have."""
        stiffness = self.commanded(Alias.STIFFNESS)
        dating = Dating(self._cycles, 1e3 * self.lead, self._delay)
        self._orders = Orders(self._writer, self._cycles, dating, self._timing.wheels, stiffness)
        return stiffness

    def end(self) -> None:
        """Give no commands any more."""
        self._orders = None

    def request(self) -> None:
        """Ask for the sample of the next ``read``, unless a question is on its way; never waits."""
        self._take()
        self._reader.ask()
        self._requested = True

    def read(self) -> Measurement:
        """Return the newest sample of the tick's cycle; never waits."""
        now = self._now()
        elapsed, self._read_at = (now - self._read_at) * 1e-6, now
        if elapsed > PAUSE * 1e3 * self._cycle:
            self._watched = now
        self._take()
        if not self._requested:  # the sample of the next tick is then the one that comes meanwhile
            self._reader.ask()
        self._requested = False
        self._writer.collect()
        since = self._clock.now(now) - self._reader.date
        self._playout.step(elapsed, since)
        self.newest = self._measurement(
            sample_age(
                self._playout.late,
                since=1e-3 * since,
                silence=self._writer.silence,
                watched=1e-9 * (now - self._watched),
                cycle=self._cycle,
            )
        )
        return self.newest

    def write(
        self, position: FloatArray | None, stiffness: FloatArray, wheel_speed: FloatArray
    ) -> None:
        """Send a command, after ``start`` and before ``end``; see :meth:`Orders.give`. Never waits."""
        if self._orders is not None:
            self._written += 1
            date = self._clock.now(self._now())
            self._orders.give(self._written, date, position, stiffness, wheel_speed)

    def exchange(
        self, position: FloatArray | None, stiffness: FloatArray, wheel_speed: FloatArray
    ) -> Measurement:
        """Write, then read: for the begin and the end of a run, which follow no sample."""
        self.write(position, stiffness, wheel_speed)
        return self.read()

    def phase_error(self, due: int) -> float:
        """Return how much later than ``due`` [ns] a tick best begins [s]; see :meth:`Backend.phase_error`."""
        after = 1e-3 * self._cycles.since(self._clock.now(due))
        half = self._cycle / 2
        return (TICK_PHASE * self._cycle - after + half) % self._cycle - half

    def switch_wheels(self, points: list[tuple[float, float]]) -> bool:
        """Let the wheels' stiffness go through (time from now [s], stiffness); returns whether that was sent."""
        self._writer.collect()
        now = self._clock.now(self._now())
        dates = [round(now + 1e3 * after) for after, _ in points]
        values = [[value for _, value in points]] * len(self._actuators[Alias.WHEEL_STIFFNESS])
        return self._writer.send(Alias.WHEEL_STIFFNESS, "ClearAll", dates, values)

    def commanded(self, alias: Alias, timeout: float | None = None) -> FloatArray:
        """What the DCM commands now. Waits for the answer, at most ``timeout`` [s].

        Raises:
            BackendError: The robot does not say.
            NotConnectedError: The connection is lost.
        """
        keys = self._actuators[alias]
        values = self._connection.call("ALMemory", "getListData", keys, timeout=timeout)
        try:
            commanded = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            commanded = np.full(1, np.nan)
        if commanded.shape != (len(keys),) or not np.isfinite(commanded).all():
            uri = self._connection.address.uri
            raise BackendError(f"'{uri}': the robot does not say what its actuators are told now")
        return commanded

    @property
    def stiffness(self) -> FloatArray:
        """(17,) that the joints were last told to have, after ``start``."""
        assert self._orders is not None
        return self._orders.stiffness

    @property
    def connected(self) -> bool:
        """Whether the connection stands, as far as it has been noticed."""
        return self._connection.connected

    @property
    def silence(self) -> float:
        """For how long the robot has been taking nothing of what it was sent [s]; 0 where all was taken."""
        return self._writer.silence

    @property
    def idle(self) -> bool:
        """Whether nothing is on its way."""
        self._writer.collect()
        return self._writer.idle

    def _take(self) -> None:
        if self._reader.take():
            self._playout.add(self._cycles.see(self._reader.date), self._reader.newest)

    def _measure_request(self, keys: SensorKeys) -> tuple[float, Answer]:
        """Return how long before a tick its sample is requested [s], and the last of the samples read to see that."""
        trips = []
        for _ in range(REQUEST_CALLS):
            asked = self._now()
            answer = self._connection.call("ALMemory", "getListData", keys.names)
            trips.append((self._now() - asked) * 1e-9)
        lead = float(np.percentile(trips, 99)) + REQUEST_MARGIN
        return min(lead, MAX_REQUEST_LEAD * self._cycle), answer

    def _make_aliases(self) -> None:
        """Let the DCM know the groups of actuators. It answers with their names, empty where it knows none."""
        uri = self._connection.address.uri
        for alias, keys in self._actuators.items():
            answer = self._connection.call("DCM", "createAlias", [str(alias), keys])
            try:
                known = list(answer[1])
            except (TypeError, IndexError):
                known = []
            missing = [key for key, name in zip(keys, known, strict=False) if not name]
            if len(known) != len(keys) or missing:
                what = missing[0] if missing else str(alias)
                raise BackendError(f"'{uri}': the robot's DCM does not know the actuator {what}")

    def _measurement(self, age: float) -> Measurement:
        orders, values, cycle = self._orders, self._playout.sample, self._playout.cycle
        return Measurement(
            time=cycle * self._cycle,
            tick=cycle,
            age=age,
            answers=None if orders is None else orders.answers(self._written, cycle),
            withheld=0 if orders is None else orders.withheld,
            missing=self._reader.missing,
            **{name: getattr(values, name) for name in VALUES},
        )
