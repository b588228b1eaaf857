"""Requests to the DCM as NAOqi's documentation has them: nested lists, checked here, because qi checks nothing."""

from __future__ import annotations

import math

from pepper_driver.backends.naoqi_server.clock import SPAN
from pepper_driver.backends.naoqi_server.dcm import UPDATE_TYPES, TimedCommand, UpdateType

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
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise RequestError(f"a value must be a finite number, got {value!r}")
    return float(value)


def _date(value: object) -> int:
    if not isinstance(value, int | float) or isinstance(value, bool) or value % 1 != 0:
        raise RequestError(f"a time must be a whole number of ms, got {value!r}")
    if not -SPAN // 2 <= value < SPAN // 2:
        raise RequestError(f"time {value!r} does not fit into 32 bits: the DCM's clock rolls over")
    return int(value)
