"""The DCM of the stand-in: its 32-bit clock, timed commands, and the requests of clients.

The driver's ``naoqi.clock`` has the same arithmetic, apart on purpose: shared, no test would see a mistake in it.

Follows NAOqi 2.5.10, pages "DCM", "DCM API" and "DCM advanced". Inside, dates are counts of milliseconds that do not
roll over, so that nothing happens when the robot's clock does.
"""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Literal, get_args

from pepper_driver.backends.interface import BackendError

SPAN = 1 << 32
"""[ms] after which the clock shows the same again."""

_HALF = SPAN >> 1


def wrapped(milliseconds: int) -> int:
    """Any count of milliseconds as the clock shows it: -2^31 to 2^31 - 1."""
    return (milliseconds + _HALF) % SPAN - _HALF


def unwrapped(shown: int, near: int) -> int:
    """Return the count of milliseconds that the clock shows as ``shown``, at most 2^31 ms from ``near``."""
    return near + wrapped(shown - near)


@dataclass(frozen=True, kw_only=True, slots=True)
class DcmClock:
    """Counts milliseconds from ``origin`` on, beginning when the monotonic clock shows ``begin`` [ns].

    The count does not roll over; its value in the memory does. All processes of one machine share the monotonic
    clock, so each can compute the robot's time without a request.
    """

    begin: int
    origin: int
    now: Callable[[], int] = time.monotonic_ns

    @property
    def count(self) -> int:
        """Milliseconds now."""
        return self.origin + (self.now() - self.begin) // 1_000_000

    @property
    def shown(self) -> int:
        """Present value of the robot's clock."""
        return wrapped(self.count)


UpdateType = Literal["Merge", "ClearAll", "ClearAfter", "ClearBefore"]
"""What an order does to the commands that wait already."""

UPDATE_TYPES: tuple[UpdateType, ...] = get_args(UpdateType)

BUFFER = 512
"""Commands that may wait for one actuator."""

TimedCommand = tuple[float, int]
"""(value, date)."""


class BufferFullError(BackendError):
    """An order that would exceed the buffer of an actuator. None of it was accepted."""


def after_order(
    waiting: Mapping[int, float], update: UpdateType, commands: Sequence[TimedCommand]
) -> dict[int, float]:
    """Return the commands that wait for an actuator after an order, values by date.

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


class DcmActuator:
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
        """Replace the waiting commands by these, in order of time."""
        self._dates = sorted(waiting)
        self._values = [waiting[date] for date in self._dates]

    def advance(self, date: int) -> float:
        """Return the value at the date of a cycle, which is then sent; later than all dates before.

        Commands whose time has come are removed. The value changes linearly from the value last sent, or from a
        command whose date came since then, to the next command. After the last one it stays.
        """
        if self._dates:
            used = bisect_right(self._dates, date)
            start = self._cycle
            if used:
                self.sent = self._values[used - 1]
                # Of several commands whose date came since the last cycle, the line begins at the last one.
                start = max(start, self._dates[used - 1])
                del self._dates[:used], self._values[:used]
            if self._dates and self._interpolates and start < date:
                distance = self._values[0] - self.sent
                self.sent += distance * (date - start) / (self._dates[0] - start)
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
            key: DcmActuator(value, date, interpolates=key not in steps)
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
            # An alias may hold an actuator twice.
            waiting = after[key] if key in after else self.actuators[key].waiting
            dated = [(value, unwrapped(date, now)) for value, date in its]
            after[key] = after_order(waiting, update, dated)
            if len(after[key]) > BUFFER:
                raise BufferFullError(
                    f"{len(after[key])} commands would wait for {key}, and its buffer holds {BUFFER}; "
                    "nothing of this request was accepted: send fewer, or clear those that wait"
                )
        # Only after all checks: a request is accepted as a whole or not at all.
        for key, waiting in after.items():
            self.actuators[key].take(waiting)

    def advance(self, date: int) -> list[float]:
        """Return the value of each actuator at the date of a cycle, in the order of the keys."""
        return [actuator.advance(date) for actuator in self.actuators.values()]


ALIAS_FORM = "[name, [actuator, ...]]"
SET_FORM = "[actuator or alias, update type, [[value, time], ...]]"
MIXED_FORM = '[alias, update type, "time-mixed", [[[value, time], ...], ...]]'
SEPARATE_FORM = '[alias, update type, "time-separate", 0, [time, ...], [[value, ...], ...]]'


class RequestError(ValueError):
    """A request that is not as documented; the message says where."""


def alias_request(request: object) -> tuple[str, list[str]]:
    """Name and actuators of ``createAlias``, of ``ALIAS_FORM``."""
    name, actuators = _items(request, 2, ALIAS_FORM)
    return _text(name, "the name"), [
        _text(actuator, f"actuator {number}")
        for number, actuator in enumerate(_list(actuators, "the actuators"))
    ]


def set_request(request: object) -> tuple[str, UpdateType, list[TimedCommand]]:
    """Name, update type and commands of ``set``, of ``SET_FORM``."""
    name, update, commands = _items(request, 3, SET_FORM)
    return _text(name, "the name"), _update(update), _timed(commands, "the commands")


def set_alias_request(request: object) -> tuple[str, UpdateType, list[list[TimedCommand]]]:
    """Name, update type and a list of commands for each actuator, of ``MIXED_FORM`` or ``SEPARATE_FORM``."""
    kind = _list(request, "the request")[2:3]
    if kind == ["time-mixed"]:
        name, update, _, lists = _items(request, 4, MIXED_FORM)
        commands = [
            _timed(its, f"list {number}") for number, its in enumerate(_list(lists, "the commands"))
        ]
    elif kind == ["time-separate"]:
        name, update, _, _, times, lists = _items(request, 6, SEPARATE_FORM)
        dates = [_date(time) for time in _list(times, "the times")]
        commands = [
            _dated(its, dates, f"list {number}")
            for number, its in enumerate(_list(lists, "the values"))
        ]
    else:
        raise RequestError(f"expected {MIXED_FORM} or {SEPARATE_FORM}, got {request!r}")
    return _text(name, "the alias"), _update(update), commands


def _dated(values: object, dates: list[int], where: str) -> list[TimedCommand]:
    values = _list(values, where)
    if len(values) != len(dates):
        raise RequestError(f"{where} has {len(values)} values for {len(dates)} times")
    return [(_value(value), date) for value, date in zip(values, dates, strict=True)]


def _timed(commands: object, where: str) -> list[TimedCommand]:
    timed = []
    for command in _list(commands, where):
        if not isinstance(command, list | tuple) or len(command) not in (2, 3):
            raise RequestError(f"{where}: a command is [value, time], got {command!r}")
        timed.append((_value(command[0]), _date(command[1])))  # the DCM ignores the importance
    return timed


def _list(value: object, where: str) -> list[object]:
    if not isinstance(value, list | tuple):
        raise RequestError(f"{where}: expected a list, got {value!r}")
    return list(value)


def _items(request: object, number: int, form: str) -> list[object]:
    if not isinstance(request, list | tuple) or len(request) != number:
        raise RequestError(f"expected {form}, got {request!r}")
    return list(request)


def _text(value: object, where: str) -> str:
    if not isinstance(value, str) or not value:
        raise RequestError(f"{where}: expected text, got {value!r}")
    return value


def _update(value: object) -> UpdateType:
    for known in UPDATE_TYPES:
        if known == value:
            return known
    raise RequestError(f"unknown update type {value!r} (possible: {', '.join(UPDATE_TYPES)})")


def _value(value: object) -> float:
    # bool is an int in Python, but no number in a request.
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise RequestError(f"a value must be a finite number, got {value!r}")
    return float(value)


def _date(value: object) -> int:
    if not isinstance(value, int | float) or isinstance(value, bool) or value % 1 != 0:
        raise RequestError(f"a time must be a whole number of ms, got {value!r}")
    if not -SPAN // 2 <= value < SPAN // 2:
        raise RequestError(f"time {value!r} does not fit into 32 bits: the DCM's clock rolls over")
    return int(value)
