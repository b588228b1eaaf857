"""Requests to the DCM as NAOqi's documentation has them: nested lists, checked here, because qi checks nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pepper_driver.backends.naoqi_server.clock import SPAN
from pepper_driver.backends.naoqi_server.dcm import UPDATE_TYPES, TimedCommand, UpdateType


class RequestError(ValueError):
    """A request that is not as documented; the message says where."""


def alias_request(request: Any) -> tuple[str, list[str]]:  # noqa: ANN401
    """Name and actuators of ``createAlias``: ``[name, [actuator, ...]]``."""
    form = "[name, [actuator, ...]]"
    name, actuators = _items(request, 2, f"createAlias: expected {form}")
    names = _list(actuators, f"createAlias: expected {form}, the second item")
    if not isinstance(name, str) or not name:
        raise RequestError(f"createAlias: the first item must be the alias' name, got {name!r}")
    for number, actuator in enumerate(names):
        if not isinstance(actuator, str):
            raise RequestError(f"createAlias: actuator {number} must be text, got {actuator!r}")
    return name, names


def set_request(request: Any) -> tuple[str, UpdateType, list[TimedCommand]]:  # noqa: ANN401
    """Of ``set``: ``[actuator or alias, update type, [[value, time], ...]]``."""
    name, update, commands = _items(
        request, 3, "set: expected [actuator or alias, update type, [[value, time], ...]]"
    )
    return _name("set", name), _update("set", update), _timed("set", "the third item", commands)


def set_alias_request(request: Any) -> tuple[str, UpdateType, list[list[TimedCommand]]]:  # noqa: ANN401
    """Of ``setAlias``, in either format: a list of commands for each actuator of the alias.

    ``[alias, update type, "time-mixed", [[[value, time], ...], ...]]`` or
    ``[alias, update type, "time-separate", 0, [time, ...], [[value, ...], ...]]``.
    """
    parts = _list(request, "setAlias: expected a list")
    if len(parts) < 3:
        raise RequestError(
            f"setAlias: expected [alias, update type, format, ...], got {len(parts)} items"
        )
    name, update = _name("setAlias", parts[0]), _update("setAlias", parts[1])
    if parts[2] == "time-mixed":
        (lists,) = _items(parts[3:], 1, "setAlias, time-mixed: after the format, expected one list")
        lists = _list(lists, "setAlias, time-mixed: the commands")
        return (
            name,
            update,
            [_timed("setAlias", f"list {number}", its) for number, its in enumerate(lists)],
        )
    if parts[2] == "time-separate":
        _, times, lists = _items(
            parts[3:], 3, "setAlias, time-separate: after the format, expected 0, times, values"
        )
        times = [_time("setAlias", t) for t in _list(times, "setAlias, time-separate: the times")]
        commands = []
        for number, values in enumerate(_list(lists, "setAlias, time-separate: the values")):
            values = _list(values, f"setAlias, time-separate: list {number}")
            if len(values) != len(times):
                raise RequestError(
                    f"setAlias, time-separate: list {number} has {len(values)} values for {len(times)} times"
                )
            checked = [_value("setAlias", value) for value in values]
            commands.append(list(zip(checked, times, strict=True)))
        return name, update, commands
    raise RequestError(
        f"setAlias: format {parts[2]!r} is not known (possible: time-mixed, time-separate)"
    )


def _list(value: Any, where: str) -> list[Any]:  # noqa: ANN401
    if not isinstance(value, list | tuple):
        raise RequestError(f"{where}: expected a list, got {value!r}")
    return list(value)


def _items(value: Any, number: int, form: str) -> Sequence[Any]:  # noqa: ANN401
    items = _list(value, form)
    if len(items) != number:
        raise RequestError(f"{form}, got {len(items)} items")
    return items


def _name(method: str, value: Any) -> str:  # noqa: ANN401
    if not isinstance(value, str):
        raise RequestError(f"{method}: the first item must be a name, got {value!r}")
    return value


def _update(method: str, value: Any) -> UpdateType:  # noqa: ANN401
    for known in UPDATE_TYPES:
        if known == value:
            return known
    raise RequestError(
        f"{method}: update type {value!r} is not known (possible: {', '.join(UPDATE_TYPES)})"
    )


def _timed(method: str, where: str, value: Any) -> list[TimedCommand]:  # noqa: ANN401
    commands = []
    for command in _list(value, f"{method}: {where}"):
        items = _list(command, f"{method}: a command of {where}")
        if len(items) not in (2, 3):  # the third is an importance that the DCM does not look at
            raise RequestError(f"{method}: a command is [value, time], got {items!r}")
        commands.append((_value(method, items[0]), _time(method, items[1])))
    return commands


def _value(method: str, value: Any) -> float:  # noqa: ANN401
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value):
        raise RequestError(f"{method}: a value must be a number, got {value!r}")
    return float(value)


def _time(method: str, value: Any) -> int:  # noqa: ANN401
    whole = isinstance(value, int) and not isinstance(value, bool)
    if not (whole or (isinstance(value, float) and value.is_integer())):
        raise RequestError(f"{method}: a time must be a whole number of ms, got {value!r}")
    if not -SPAN // 2 <= value < SPAN // 2:
        raise RequestError(
            f"{method}: time {value!r} does not fit into 32 bits: the DCM's clock rolls over"
        )
    return int(value)
