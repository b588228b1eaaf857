"""Arguments as users give them: numbers, arrays, paths, and calls that the signature of a function does not fit."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from functools import cache, wraps
from numbers import Real
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Any,
    ParamSpec,
    TypeGuard,
    TypeVar,
    Union,
    Unpack,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ArgumentError, shown, suggestion, with_article

P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound=Callable[..., Any])

MAX_PATH_LENGTH = 1000
"""[letters] Of a path, as a text."""

Check = Callable[[object], bool]
ParameterCheck = tuple[int | None, str, str, list[Check]]
"""Place of a parameter or None; its name; human-readable types; one check for each of these."""


def is_number(value: object) -> TypeGuard[float]:
    """Return True for a real number, NaN and infinity too; a truth value or a text is no number.

    Nor is an integer of more than 308 digits, which no float can hold.
    """
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def real_array(value: object, *shapes: tuple[int, ...]) -> FloatArray | None:
    """Return a new array of real numbers, of one of these shapes or any.

    None for anything else: truth values, texts, objects, complex numbers.
    """
    if isinstance(value, np.ndarray):
        array = value
    else:
        if _holds_truth_value(value):  # NumPy would make a number of it
            return None
        try:
            array = np.asarray(value)
        except (TypeError, ValueError):
            return None
    fits = array.dtype.kind in "fiu" and (not shapes or array.shape in shapes)
    return array.astype(np.float64) if fits else None


def _holds_truth_value(value: object) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_holds_truth_value, value))
    return isinstance(value, bool | np.bool_)


def as_tuple(value: object) -> tuple[Any, ...] | None:
    """Return the members of a list, an array or the like; None for what is no list, such as a text or a mapping."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return None
    try:
        return tuple(value)
    except TypeError:  # an array without dimensions
        return None


def as_path(name: str, value: object) -> Path:
    """Return the path of a file or folder.

    Args:
        name: Of the argument, for the message.
        value: As the user gave it.

    Raises:
        ArgumentError: It is no path.
    """
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        if isinstance(text, str) and "\0" not in text and 0 < len(text) <= MAX_PATH_LENGTH:
            return Path(text)
    raise ArgumentError(f"{name} must be the path of a file, got {shown(value)}")


def checked_arguments(target: C) -> C:
    """Have a function, or the constructor of a class, refuse calls that do not fit its signature, in one line.

    Refused by an ArgumentError are arguments that it does not have or that are missing, and what its annotations rule
    out: other objects than those of a class of this project, other than True or False for ``bool``, and functions
    that do not take as many arguments as ``Callable[[A, B], R]`` says. Names, numbers and arrays are left to the
    function itself, which has the possible ones.
    """
    if isinstance(target, type):
        constructor = vars(target)["__init__"]
        # That of a dataclass has annotations of other modules, as texts.
        annotated = target if is_dataclass(target) else constructor
        target.__init__ = _checked(constructor, target.__name__, annotated)  # type: ignore[misc]
        return target
    return _checked(target, target.__name__, target)  # type: ignore[return-value]


def _checked(function: Callable[P, T], name: str, annotated: object) -> Callable[P, T]:
    @cache
    def named() -> tuple[list[str], bool]:
        return _names(function)

    @cache
    def checks() -> list[ParameterCheck]:  # only now: a module may need others first
        return _checks(function, annotated)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        for place, argument, kind, possible in checks():
            if argument in kwargs:
                value = kwargs[argument]
            elif place is not None and place < len(args):
                value = args[place]
            else:
                continue
            if not any([fits(value) for fits in possible]):
                raise ArgumentError(f"{name}: {argument} must be {kind}, got {shown(value)}")
        known, is_free = named()
        if not is_free and any(given not in known for given in kwargs):
            raise ArgumentError(f"{name}: {_misfit(function, args, kwargs)}")
        try:
            return function(*args, **kwargs)
        except TypeError as error:
            if (problem := _misfit(function, args, kwargs)) is None:
                raise
            raise ArgumentError(f"{name}: {problem}") from error

    return call


def _misfit(
    function: Callable[..., object], args: tuple[Any, ...], kwargs: Mapping[str, Any]
) -> str | None:
    """Return a human-readable reason why a call does not fit a signature; None if it fits."""
    known, is_free = _names(function)
    for given in kwargs:
        if given not in known and not is_free:
            return f"unknown argument {given!r}{suggestion(given, known)}"
    try:
        inspect.signature(function).bind(*args, **kwargs)
    except TypeError as error:
        text = str(error)
        if text == "too many positional arguments":
            return f"too many arguments without a name (possible: {', '.join(known)})"
        return text
    return None


def _names(function: Callable[..., object]) -> tuple[list[str], bool]:
    """Return the names of arguments, those of ``**kwargs: Unpack[...]`` too; True where others are accepted as well."""
    names: list[str] = []
    is_free = False
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            hint = get_type_hints(function, include_extras=True).get(name)
            unpacked = get_args(hint)[0] if get_origin(hint) is Unpack else None
            is_free = not is_typeddict(unpacked)
            names += [] if is_free else get_type_hints(unpacked)
        elif name not in ("self", "cls"):
            names.append(name)
    return names, is_free


# -- what annotations rule out --------------------------------------------------------------------------------------


def _checks(function: Callable[..., object], annotated: object) -> list[ParameterCheck]:
    """Return what is to be checked."""
    hints = get_type_hints(annotated)
    found = []
    for place, (name, parameter) in enumerate(inspect.signature(function).parameters.items()):
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        hint = hints.get(name)
        members = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        kinds = [_kind(member) for member in members]
        if None in kinds or set(members) <= {str, NoneType}:
            continue
        texts = [kind[0] for kind in kinds if kind and kind[0]]
        at = None if parameter.kind is parameter.KEYWORD_ONLY else place
        found.append((at, name, " or ".join(texts), [kind[1] for kind in kinds if kind]))
    return found


def _kind(hint: Any) -> tuple[str, Check] | None:  # noqa: ANN401 an annotation can be anything
    """Return a human-readable type of argument, and its check; None if it is not checked here."""
    if hint is NoneType:
        return "", lambda value: value is None
    if hint is bool:
        return "True or False", lambda value: isinstance(value, bool | np.bool_)
    if hint is str:
        return "a text", lambda value: isinstance(value, str)
    if hint is Path:
        return "a path", lambda value: isinstance(value, os.PathLike)
    if get_origin(hint) is Callable or hint is Callable:
        arguments = [*get_args(hint), ...][0]
        count = len(arguments) if isinstance(arguments, list) else None
        return _function_text(count), lambda value: takes_arguments(value, count)
    if get_origin(hint) is Mapping or hint is Mapping:
        return "a mapping", lambda value: isinstance(value, Mapping)
    if isinstance(hint, type) and hint.__module__.startswith("pepper_driver"):
        return with_article(hint.__name__), lambda value: isinstance(value, hint)
    return None


def _function_text(count: int | None) -> str:
    texts = {None: "a function", 0: "a function without arguments", 1: "a function of one argument"}
    return texts.get(count) or f"a function of {count} arguments"


def takes_arguments(value: object, count: int | None) -> bool:
    """Return True for what can be called with so many arguments, or any for None, as far as that is visible."""
    if not callable(value):
        return False
    if count is None:
        return True
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # some built-in functions have none
        return True
    try:
        signature.bind(*range(count))
    except TypeError:
        return False
    return True
