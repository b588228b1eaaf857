"""What the DCM is told in a tick: joints always, wheels while they turn, stiffness when it changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pepper_driver.backends.naoqi.cycles import CommandScheduler, Cycles
from pepper_driver.backends.naoqi.history import CommandHistory, SentCommand
from pepper_driver.backends.naoqi.keys import Alias
from pepper_driver.backends.naoqi.writer import Writer
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.naoqi import WheelTimes

PRECEDENCE = {Alias.POSITION: 1.5}
"""[ticks] by which some commands go before others that have waited longer. So wheels come every third tick at the
latest, before their last command is over."""


class Orders:
    """Turns a command of the loop into commands to the DCM, as many as may be on their way.

    Joints are to be at their positions at a cycle of their own. Each wheel command is over soon: wheels that get no
    further one stand, with nobody's help (dead-man's stop). They are told nothing while they stand.

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
        stiffness: (17,) that the joints were last told to have.
        withheld: Commands for the joints that were not sent, since too many were on their way.
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
        self.withheld = 0

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
        if turning or speeds != self._wheel_speed:
            due[Alias.WHEEL_SPEED] = lambda: self._send_wheels(now, speeds)
        wanted = stiffness.tolist()
        if wanted != self._stiffness:
            due[Alias.STIFFNESS] = lambda: self._send_stiffness(now, wanted)

        def urgency(alias: Alias) -> float:
            if alias is Alias.WHEEL_SPEED and not turning:
                return np.inf
            return self._waiting.get(alias, 0) + PRECEDENCE.get(alias, 0.0)

        waiting = {}
        for alias in sorted(due, key=urgency, reverse=True):
            if not due[alias]():
                waiting[alias] = self._waiting.get(alias, 0) + 1
        self._waiting = waiting
        self.withheld += Alias.POSITION in waiting

    def answers(self, step: int, cycle: int) -> int | None:
        """Return how many commands before ``step`` the one was given that the sample of a cycle answers, if any."""
        return self._scheduler.answers(step, cycle)

    def _send_position(self, step: int, number: int, now: float, position: FloatArray) -> bool:
        date = self._cycles.date(number)
        command = SentCommand(values=position, date=date, sent=now)

        def done(taken: bool) -> None:
            if taken:
                command.taken = self._clock()
            else:
                self._scheduler.refused(number)

        sent = self._writer.position(position, date, done)
        if sent:
            self.positions.add(command)
        self._scheduler.given(step, number, sent=sent)
        return sent

    def _send_wheels(self, now: float, speeds: list[float]) -> bool:
        begin = self._last_cycle(now)
        if any(speeds):
            dates = [begin + after for after in self._wheel_times]
            values = [[speed, speed, 0.0] for speed in speeds]
        else:
            dates, values = [self._last_cycle(now + self._cycles.length)], [[0.0]] * 3
        command = SentCommand(values=np.array(speeds), date=dates[0], sent=now)

        def done(taken: bool) -> None:
            if taken:
                command.taken = self._clock()
            else:
                self._wheel_speed = None

        if not self._writer.send(Alias.WHEEL_SPEED, "ClearAll", dates, values, done):
            return False
        self.speeds.add(command)
        self._wheel_speed = speeds
        return True

    def _send_stiffness(self, now: float, wanted: list[float]) -> bool:
        def done(taken: bool) -> None:
            if not taken:
                self._stiffness = None

        date = self._last_cycle(now) + self._wheel_times[0]
        if not self._writer.send(
            Alias.STIFFNESS, "ClearAll", [date], [[value] for value in wanted], done
        ):
            return False
        self._stiffness, self.stiffness = wanted, np.array(wanted)
        return True

    def _last_cycle(self, now: float) -> int:
        """Date of the last cycle before now: dates on the grid of cycles are reached exactly."""
        return round(now - self._cycles.since(now))
