"""One tick over the DCM: samples in with their age, commands out, and the dead-man times of the wheels."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.dcm_io import Reader, Writer
from pepper_driver.backends.naoqi.foreign import ForeignCommands
from pepper_driver.backends.naoqi.memory_keys import VALUES, Alias, SensorKeys, actuator_keys
from pepper_driver.backends.naoqi.qi_library import Answer
from pepper_driver.backends.naoqi.timing import (
    CommandHistory,
    CommandScheduler,
    Cycles,
    DcmClockEstimate,
    JitterBuffer,
    RoundTrips,
    ScheduledCommand,
    burst,
    measure,
)
from pepper_driver.config import NaoqiSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.naoqi import WheelTimes

MAX_TICK_GAP = 5.0
"""[cycles] without a tick that are more than some missed ones: the robot was not supervised meanwhile."""

NORMAL_AGE = 0.072
"""[s] since the cycle of a sample, which takes 7 to 15 ms to its tick. Younger ones are late by whole cycles, as the
observer counts; older ones are as old as they are."""


def sample_age(
    late: int, since: float, unacknowledged_time: float, watched: float, cycle: float
) -> float:
    """Return the age of the newest sample as :class:`~pepper_driver.backends.interface.Measurement` has it [s].

    The sample of the tick's cycle has none, whatever its latency was. When samples are missing for long, nothing is
    deducted: the gate, which looks once a cycle, then stops the robot before the last good one came 100 ms ago. A robot
    that sends samples but takes no commands is no better than one that is silent.

    After a pause without ticks, between two runs, the robot is given the time to answer that it has when it is watched:
    what came before the pause does not describe it.

    Args:
        late: Cycles by which the newest sample is later than usual.
        since: Time since its cycle [s].
        unacknowledged_time: Time for which nothing that was sent has been acknowledged [s].
        watched: Time since ticks last began after a pause [s].
        cycle: Of the robot [s].
    """
    age = late * cycle if since <= NORMAL_AGE else since
    if unacknowledged_time > NORMAL_AGE:
        age = max(age, unacknowledged_time)
    return min(age, watched + cycle)


PRECEDENCE = {Alias.POSITION: 1.5, Alias.STIFFNESS: -1.5}
"""[ticks] by which some commands go before others that have waited longer, or after others that have not."""

MAX_WHEEL_WAIT = 2
"""[ticks] that a command for turning wheels waits at most: after the third tick the last one is over."""


class Orders:
    """Turns a command of the loop into commands to the DCM, as many as may be in flight.

    Joints are to be at their positions at a cycle of their own. Each wheel command is over soon: wheels that get no
    further one stand, without any other program (dead-man's stop). They receive no commands while they stand.

    Args:
        writer: Sends.
        cycles: Of the robot.
        scheduler: Says for which cycle a command is.
        wheels: Dates of wheel commands.
        stiffness: (17,) what the joints have now.
        clock: The DCM's date now [ms].

    Attributes:
        positions: Commands for the joints that were sent.
        speeds: And for the wheels.
        stiffness: (17,) last commanded to the joints.
        dropped_commands: Commands for the joints that were not sent, since too many were in flight.
    """

    def __init__(
        self,
        writer: Writer,
        cycles: Cycles,
        scheduler: CommandScheduler,
        wheels: WheelTimes,
        stiffness: FloatArray,
        clock: Callable[[], float],
    ) -> None:
        self._writer, self._cycles, self._scheduler = writer, cycles, scheduler
        self._clock = clock
        self.positions = CommandHistory(cycles.length)
        self.speeds = CommandHistory(cycles.length)
        self._wheel_times = tuple(round(1e3 * t) for t in (wheels.reach, wheels.hold, wheels.stop))
        self.stiffness = stiffness
        self._stiffness: list[float] | None = stiffness.tolist()
        self._wheel_speed: list[float] | None = None
        self._waiting: dict[Alias, int] = {}
        self.dropped_commands = 0

    def give(
        self,
        step: int,
        now: float,
        position: FloatArray | None,
        stiffness: FloatArray,
        wheel_speed: FloatArray,
    ) -> None:
        """Send what is due.

        Args:
            step: Number of the command.
            now: The DCM's date [ms].
            position: (17,) [rad]; None leaves the joints where the DCM holds them.
            stiffness: (17,) 0..1.
            wheel_speed: (3,) [rad/s].
        """
        due: dict[Alias, Callable[[], bool]] = {}
        number = None if position is None else self._scheduler.next(now)
        if position is not None and number is not None:
            due[Alias.POSITION] = lambda: self._send_position(step, number, now, position)
        speeds = wheel_speed.tolist()
        turning = any(speeds)
        # Wheels that turn need a command again and again: each command ends in standing still.
        if turning or speeds != self._wheel_speed:
            due[Alias.WHEEL_SPEED] = lambda: self._send_wheels(now, speeds)
        values = stiffness.tolist()
        if values != self._stiffness:
            due[Alias.STIFFNESS] = lambda: self._send_stiffness(now, values)

        def urgency(alias: Alias) -> float:
            waited = self._waiting.get(alias, 0)
            # The stop of the base must not wait for a place among the commands in flight.
            if alias is Alias.WHEEL_SPEED and (not turning or waited >= MAX_WHEEL_WAIT):
                return np.inf
            return waited + PRECEDENCE.get(alias, 0.0)

        waiting = {}
        for alias in sorted(due, key=urgency, reverse=True):
            if not due[alias]():
                waiting[alias] = self._waiting.get(alias, 0) + 1
        self._waiting = waiting
        self.dropped_commands += Alias.POSITION in waiting

    def answers(self, step: int, cycle: int) -> int | None:
        """Return how many commands before ``step`` the one was given that the sample of a cycle answers, if any."""
        return self._scheduler.answers(step, cycle)

    def _send_position(self, step: int, number: int, now: float, position: FloatArray) -> bool:
        date = self._cycles.date(number)
        command = ScheduledCommand(values=position, date=date, sent=now)

        def done(acknowledged: bool) -> None:
            if acknowledged:
                command.acknowledged = self._clock()
            else:
                self._scheduler.refused(number)

        sent = self._writer.position(position, date, done)
        if sent:
            # Before its acknowledgement: the DCM may follow it already.
            self.positions.add(command)
        self._scheduler.note_command(step, number, sent=sent)
        return sent

    def _send_wheels(self, now: float, speeds: list[float]) -> bool:
        begin = self._last_cycle(now)
        if any(speeds):
            dates = [begin + after for after in self._wheel_times]
            # The zero is the dead-man's stop: the DCM executes it by itself when no further command comes.
            values = [[speed, speed, 0.0] for speed in speeds]
        else:
            dates, values = [self._last_cycle(now + self._cycles.length)], [[0.0]] * 3
        command = ScheduledCommand(values=np.array(speeds), date=dates[0], sent=now)

        def done(acknowledged: bool) -> None:
            if acknowledged:
                command.acknowledged = self._clock()
            else:
                # The wheels' state is unknown now: the next tick sends again, also a command to stand.
                self._wheel_speed = None

        if not self._writer.send(Alias.WHEEL_SPEED, "ClearAll", dates, values, done):
            return False
        self.speeds.add(command)
        self._wheel_speed = speeds
        return True

    def _send_stiffness(self, now: float, values: list[float]) -> bool:
        def done(acknowledged: bool) -> None:
            if not acknowledged:
                self._stiffness = None

        date = self._last_cycle(now) + self._wheel_times[0]
        if not self._writer.send(
            Alias.STIFFNESS, "ClearAll", [date], [[value] for value in values], done
        ):
            return False
        self._stiffness, self.stiffness = values, np.array(values)
        return True

    def _last_cycle(self, now: float) -> int:
        """Date of the last cycle before now: dates on the grid of cycles are reached exactly."""
        return round(now - self._cycles.since(now))


TICK_PHASE = 0.6
"""[cycles] after a cycle of the robot at which ticks begin, where samples come in time: the next cycle is far."""

SAMPLE_PHASE = 0.2
"""[cycles] after a cycle of the robot at which its sample is requested at the earliest: its values are there then."""

MAX_REQUEST_LEAD = 0.65
"""[cycles] from requesting a sample to its tick, at most. Where more than one in twenty takes longer, samples are asked
for in the tick before: they have a whole cycle to come, and reactions take one more."""

REQUEST_MARGIN = 0.0015
"""[s] added to the round trip of a sample: the pacer may wake up late."""

READ_BACK = (2, 1, 3, 2)
"""Samples from one in which the DCM is also asked for its commands to joints and wheels: a fifth more values.
Irregular, so that another program with a rhythm of its own is not missed each time."""


class DcmChannel:
    """With the DCM and the memory of one robot. Construction measures the connection, and moves nothing.

    Args:
        connection: Open.
        robot: Its description.
        settings: Of commands and samples.
        delay: Cycles from the date of a command to the sample that shows it.
        now: This computer's clock [ns].

    Attributes:
        trips: Round trips of calls.
        lead: From sending a command to its date [s].
        request_lead: From requesting a sample to the tick that takes it [s]; 0 where the tick before asks for it.
        newest: What was measured last.

    Raises:
        SlowLinkError: The connection to the robot does not allow control in every cycle.
        BackendError: The robot does not know one of its actuators, or sends no good sample.
        NotConnectedError: The connection is lost.
    """

    def __init__(
        self,
        connection: Connection,
        robot: RobotConfig,
        settings: NaoqiSettings,
        delay: int,
        *,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        timing, now = settings.timing, clock.now
        self._connection, self._robot, self._settings = connection, robot, settings
        self.clock, self._now = clock, now
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
        # The shorter the round trip, the less doubt when the robot read its clock.
        self._clock = DcmClockEstimate(min(replies, key=lambda reply: reply.round_trip))
        dcm, memory = connection.service("DCM"), connection.service("ALMemory")
        keys = SensorKeys(robot)
        sample_trips, answer = self._measure_samples(keys)
        earliest, longest = SAMPLE_PHASE * robot.cycle, MAX_REQUEST_LEAD * robot.cycle
        if sample_trips.p95 + REQUEST_MARGIN <= longest:
            self.request_lead = min(sample_trips.p99 + REQUEST_MARGIN, longest)
            # Later where samples take longer: before `earliest` the robot still has the values of the cycle before.
            self._tick_phase = max(TICK_PHASE * robot.cycle, earliest + self.request_lead)
        else:
            self.request_lead, self._tick_phase = 0.0, earliest
        first = keys.values(answer)
        if isinstance(first, str):
            raise BackendError(
                f"'{connection.address.uri}': the robot sends no good sample: {first}"
            )
        self._read_at = self._watched = now()
        date = self._clock.date(first.shown, self._read_at)
        self._cycles = Cycles(1e3 * robot.cycle, date)
        self._buffer = JitterBuffer(1e3 * robot.cycle, first)
        self._reader = Reader(memory, dcm, keys, self._clock, first=first, date=date, now=now)
        self._writer = Writer(dcm, timing.max_step, now)
        self._orders: Orders | None = None
        self._foreign: ForeignCommands | None = None
        self._written = 0
        self._gaps = itertools.cycle(READ_BACK)
        self._until_read_back = next(self._gaps)
        self._requested = False
        self.newest = self._measurement(0.0)
        # Programs with a loop of their own never call request(): their first read() takes this sample.
        self._reader.ask()

    def start(self) -> FloatArray:
        """Give commands from now on; returns the stiffness (17,) that the joints have."""
        stiffness = self.commanded(Alias.STIFFNESS)
        scheduler = CommandScheduler(self._cycles, 1e3 * self.lead, self._delay)
        wheels, foreign = self._settings.timing.wheels, self._settings.foreign_commands
        orders = Orders(self._writer, self._cycles, scheduler, wheels, stiffness, self._date)
        self._orders = orders
        if foreign.action == "stop":
            self._foreign = ForeignCommands(
                self._robot, foreign, orders.positions, orders.speeds, self._connection, self.clock
            )
        return stiffness

    def end(self) -> None:
        """Give no commands any more."""
        self._orders = self._foreign = None

    def request(self) -> None:
        """Ask for the sample of the next ``read``, unless a request is in flight; never waits.

        A late reply is awaited, and then one cycle has no sample: requested at another time, the
        next one might be of the cycle before.
        """
        self._take()
        self._ask()
        self._requested = True

    def read(self) -> Measurement:
        """Return the newest sample of the tick's cycle; never waits."""
        now = self._now()
        elapsed, self._read_at = (now - self._read_at) * 1e-6, now
        if elapsed > MAX_TICK_GAP * 1e3 * self._cycle:
            self._watched = now
        self._take()
        if not self._requested:  # then it is the next tick that takes the sample
            self._ask()
        self._requested = False
        # Before the age is computed, which grows with the time without acknowledgement.
        self._writer.collect()
        since = self._clock.now(now) - self._reader.date
        self._buffer.step(elapsed, since)
        if self._foreign is not None:
            self._foreign.tick(self._buffer.sample.position)
        self.newest = self._measurement(
            sample_age(
                self._buffer.late,
                since=1e-3 * since,
                unacknowledged_time=self._writer.unacknowledged_time,
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
            # Frees places: a command is dropped while MAX_OUTSTANDING are in flight.
            self._writer.collect()
            self._written += 1
            self._orders.give(self._written, self._date(), position, stiffness, wheel_speed)

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
        return (self._tick_phase - after + half) % self._cycle - half

    def switch_wheels(self, points: list[tuple[float, float]]) -> bool:
        """Send (time from now [s], stiffness) points for the wheels' stiffness; return True if they were sent."""
        self._writer.collect()
        now = self._clock.now(self._now())
        dates = [round(now + 1e3 * after) for after, _ in points]
        values = [[value for _, value in points]] * len(self._actuators[Alias.WHEEL_STIFFNESS])
        return self._writer.send(Alias.WHEEL_STIFFNESS, "ClearAll", dates, values)

    def commanded(self, alias: Alias, timeout: float | None = None) -> FloatArray:
        """Return the present commands of the DCM. Wait for the answer, at most ``timeout`` [s].

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
            raise BackendError(
                f"'{uri}': the robot does not report the present commands of its actuators"
            )
        return commanded

    @property
    def stiffness(self) -> FloatArray:
        """(17,) last commanded to the joints, after ``start``."""
        assert self._orders is not None
        return self._orders.stiffness

    @property
    def connected(self) -> bool:
        """True while the connection stands, as far as it has been noticed."""
        return self._connection.connected

    @property
    def unacknowledged_time(self) -> float:
        """Time without acknowledgement of sent commands [s]; 0 if all were acknowledged."""
        return self._writer.unacknowledged_time

    @property
    def idle(self) -> bool:
        """True while no command or answer is in flight."""
        self._writer.collect()
        return self._writer.idle

    def _date(self) -> float:
        """Return the DCM's date now [ms]."""
        return self._clock.now(self._now())

    def _ask(self) -> None:
        self._until_read_back -= 1
        read_back = self._until_read_back <= 0
        if read_back:
            # Only some samples: the 20 further keys make a request a fifth longer.
            self._until_read_back = next(self._gaps)
        self._reader.ask(commands=read_back and self._foreign is not None)

    def _take(self) -> None:
        if not self._reader.take():
            return
        date, sample = self._reader.date, self._reader.newest
        self._buffer.add(self._cycles.see(date), sample)
        if self._foreign is not None and sample.commanded is not None:
            self._foreign.read_back(sample.commanded, date)

    def _measure_samples(self, keys: SensorKeys) -> tuple[RoundTrips, Answer]:
        """Read samples in a burst, the longer ones; returns their round trips and a sample."""
        call, seconds = self._connection.call, self._settings.timing.burst / 2

        def ask() -> int:
            call("ALMemory", "getListData", keys.with_commands)
            return 0

        trips = RoundTrips.of(burst(ask, seconds, self._now))
        return trips, call("ALMemory", "getListData", keys.names)

    def _make_aliases(self) -> None:
        """Define the groups of actuators in the DCM. It replies with their names, empty on failure."""
        uri = self._connection.address.uri
        for alias, keys in self._actuators.items():
            answer = self._connection.call("DCM", "createAlias", [str(alias), keys])
            try:
                known = list(answer[1])
            except (TypeError, IndexError):
                known = []
            # strict=False: a reply of another length is refused below, with the robot's address.
            missing = [key for key, name in zip(keys, known, strict=False) if not name]
            if len(known) != len(keys) or missing:
                what = missing[0] if missing else str(alias)
                raise BackendError(f"'{uri}': the robot's DCM does not know the actuator {what}")

    def _measurement(self, age: float) -> Measurement:
        orders, values, cycle = self._orders, self._buffer.sample, self._buffer.cycle
        return Measurement(
            time=cycle * self._cycle,
            tick=cycle,
            age=age,
            response_delay=None if orders is None else orders.answers(self._written, cycle),
            dropped_commands=0 if orders is None else orders.dropped_commands,
            commanded_by_others=() if self._foreign is None else self._foreign.found,
            stale_reason=self._reader.missing,
            **{name: getattr(values, name) for name in VALUES},
        )
