"""The device manager (DCM): timed commands of each actuator, and the value it has at a date.

Follows NAOqi 2.5.10, pages "DCM", "DCM API" and "DCM advanced". Inside, dates are counts of milliseconds that do not
roll over, so that nothing happens when the robot's clock does.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Mapping, Sequence
from math import isfinite
from typing import Literal, get_args

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.clock import unwrapped

UpdateType = Literal["Merge", "ClearAll", "ClearAfter", "ClearBefore"]
"""What an order does to the commands that wait already."""

UPDATE_TYPES: tuple[UpdateType, ...] = get_args(UpdateType)

BUFFER = 512
"""Commands that may wait for one actuator."""

TimedCommand = tuple[float, int]
"""(value, date)."""


class BufferFullError(BackendError):
    """An order with which more commands would wait for an actuator than its buffer holds. None of it was taken."""


def after_order(
    waiting: Mapping[int, float], update: UpdateType, commands: Sequence[TimedCommand]
) -> dict[int, float]:
    """The commands that wait for an actuator after an order, values by date.

    Two commands at one date are "unpredictable" in the documentation: here the later order counts, and within an order
    the last one.
    """
    after = {} if update == "ClearAll" else dict(waiting)
    if commands and update == "ClearAfter":
        first = min(date for _, date in commands)
        after = {date: value for date, value in after.items() if date <= first}
    elif commands and update == "ClearBefore":
        last = max(date for _, date in commands)
        after = {date: value for date, value in after.items() if date >= last}
    after.update((date, value) for value, date in commands)
    return after


class Actuator:
    """One actuator: its commands in the order of their dates, and the value last sent.

    Attributes:
        sent: The value last sent.
    """

    __slots__ = ("_cycle", "_dates", "_interpolates", "_values", "sent")

    def __init__(self, value: float, date: int, *, interpolates: bool = True) -> None:
        self.sent = value
        self._interpolates = interpolates
        self._cycle = date
        self._dates: list[int] = []
        self._values: list[float] = []

    @property
    def waiting(self) -> dict[int, float]:
        """Commands that are still to come: values by date, the soonest first."""
        return dict(zip(self._dates, self._values, strict=True))

    def take(self, waiting: Mapping[int, float]) -> None:
        """Let these commands, by date, wait from now on."""
        self._dates = sorted(waiting)
        self._values = [waiting[date] for date in self._dates]

    def advance(self, date: int) -> float:
        """The value at the date of a cycle, which is then sent; later than all dates before.

        Commands whose date has come are used up. The value goes in a straight line from the value last sent, or from a
        command whose date came since then, to the next command. After the last one it stays.
        """
        if self._dates:
            used = bisect_right(self._dates, date)
            start = self._cycle
            if used:
                self.sent = self._values[used - 1]
                start = max(start, self._dates[used - 1])
                del self._dates[:used], self._values[:used]
            if self._dates and self._interpolates and start < date:
                way = self._values[0] - self.sent
                self.sent += way * (date - start) / (self._dates[0] - start)
        self._cycle = date
        return self.sent


class Dcm:
    """All actuators of the robot.

    Args:
        values: Value at the start, by key of the actuator.
        date: Of the start.
        steps: Keys of those that do not interpolate.
    """

    def __init__(
        self, values: Mapping[str, float], date: int, *, steps: Collection[str] = ()
    ) -> None:
        self.actuators = {
            key: Actuator(value, date, interpolates=key not in steps)
            for key, value in values.items()
        }

    def order(
        self,
        keys: Sequence[str],
        update: UpdateType,
        commands: Sequence[Sequence[TimedCommand]],
        now: int,
    ) -> None:
        """Take timed commands for some actuators, a sequence for each key; all of them or none.

        Args:
            keys: Of the actuators.
            update: What happens to the commands that wait already.
            commands: With dates as the robot's clock shows them.
            now: The count of milliseconds that dates are at most 2^31 ms from.

        Raises:
            BufferFullError: More commands than a buffer holds would wait for one of them.
            BackendError: No such actuator, or a value that is not finite: boards would take none.
        """
        after: dict[str, dict[int, float]] = {}
        for key, its in zip(keys, commands, strict=True):
            if key not in self.actuators:
                raise BackendError(f"no actuator '{key}'")
            if not all(isfinite(value) for value, _ in its):
                raise BackendError(f"a value for {key} is not finite")
            waiting = after[key] if key in after else self.actuators[key].waiting
            dated = [(value, unwrapped(date, now)) for value, date in its]
            after[key] = after_order(waiting, update, dated)
            if len(after[key]) > BUFFER:
                raise BufferFullError(
                    f"{len(after[key])} commands would wait for {key}, and its buffer holds {BUFFER}; "
                    "nothing of this request was taken: send fewer, or clear those that wait"
                )
        for key, waiting in after.items():
            self.actuators[key].take(waiting)

    def advance(self, date: int) -> list[float]:
        """The value of each actuator at the date of a cycle, in the order of the keys."""
        return [actuator.advance(date) for actuator in self.actuators.values()]
