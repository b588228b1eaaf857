"""Mistakes in configuration files in words: what pydantic finds, as one line that names the key."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from pydantic import ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from pepper_driver.config.errors import MAX_SHOWN, suggestion, with_article

HIDDEN = {"hidden": True}
"""Metadata of fields that files do not have."""

Location = tuple[int | str, ...]

_UNKNOWN_KEY = "unknown_key"

_WORDS = {
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "finite_number": "must be a finite number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "int_parsing_size": "must be a whole number of fewer digits",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
    "string_too_short": "must not be empty",
    "string_too_long": "must be a text of at most {max_length} letters",
    "string_pattern_mismatch": "must be a text of one line without control characters",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "dict_type": "must be a mapping of keys to values",
    "dataclass_type": "must be a mapping of keys to values",
    "dataclass_exact_type": "must be a mapping of keys to values",
    "literal_error": "must be {expected}",
    "too_short": "needs at least {least}",
    "too_long": "takes at most {max_length}, has {actual_length}",
    "json_invalid": "holds a text with a character that there is not",
}
"""What is wrong, by pydantic's name of it, with the numbers that it gives."""

_KINDS: dict[type, str] = {
    dict: "a mapping",
    list: "a list",
    tuple: "a list",
    str: "text",
    int: "a number",
    float: "a number",
    bool: "a truth value",
    bytes: "binary data",
    type(None): "nothing",
}


def explain(error: ValidationError, cls: Any) -> str:  # noqa: ANN401 any type of pydantic
    """Return the first mistake in one line, and how many more there are.

    Args:
        error: Of what was to become an instance of ``cls``.
        cls: A dataclass.
    """
    problems = _mistakes(with_known_keys(error, cls).errors())
    # An unknown key explains a missing one more often than the reverse.
    first = min(problems, key=lambda problem: problem["type"] != _UNKNOWN_KEY)
    location = _location(first)
    key = ".".join(map(str, location))
    if first["type"] == _UNKNOWN_KEY:
        message = f"unknown key '{key}'{suggestion(str(location[-1]), first['ctx']['known'])}"
    elif first["type"] == "missing":
        message = f"key '{key}' is missing"
    else:
        message = f"key '{key}': {in_words(first)}" if key else in_words(first)
    if len(problems) > 1:
        message += f" (and {len(problems) - 1} more)"
    return message


def in_words(problem: ErrorDetails) -> str:
    """Return what is wrong with a value, and the value."""
    kind, value, words = problem["type"], problem["input"], requirement(problem)
    # What the checks of a class say of its values is complete.
    if kind.startswith("too_") or (kind not in _WORDS and isinstance(value, dict | list | tuple)):
        return words
    return f"{words}, got {as_written(value)}"


def requirement(problem: ErrorDetails) -> str:
    """Return what a value must be."""
    kind = problem["type"]
    if kind not in _WORDS:
        return problem["msg"].removeprefix("Value error, ")
    context = dict(problem.get("ctx", {}))
    if kind == "too_short":
        context["least"] = _entries(problem)
    return _WORDS[kind].format(**context)


def unknown_keys(unknown: Mapping[str, object], known: Iterable[str]) -> ValidationError:
    """Make the error of a validator for unknown keys of a mapping."""
    kind = PydanticCustomError(_UNKNOWN_KEY, "unknown key", {"known": sorted(known)})
    return ValidationError.from_exception_data(
        "", [{"type": kind, "loc": (key,), "input": value} for key, value in unknown.items()]
    )


def with_known_keys(error: ValidationError, cls: Any) -> ValidationError:  # noqa: ANN401 as explain
    """Return an error that names, for each unknown key, the keys of ``cls`` in that place.

    A validator that builds a part raises this: from the whole, the possible keys there are not visible.
    """
    details: list[InitErrorDetails] = []
    for problem in error.errors():
        kind: str | PydanticCustomError = problem["type"]
        context = problem.get("ctx", {})
        if kind == "unexpected_keyword_argument":
            kind, context = _UNKNOWN_KEY, {"known": _keys_at(cls, problem["loc"][:-1])}
        if kind == _UNKNOWN_KEY:
            kind = PydanticCustomError(_UNKNOWN_KEY, "unknown key", context)
        given = problem["input"]
        details.append({"type": kind, "loc": problem["loc"], "input": given, "ctx": context})
    return ValidationError.from_exception_data(error.title, details)


def refuse_hidden(cls: Any, value: object) -> None:  # noqa: ANN401 as explain
    """Raise a ValidationError where a file has keys of fields that are marked with ``HIDDEN``."""
    if is_dataclass(cls) and isinstance(value, dict):
        hidden = {field.name for field in fields(cls)} - {*keys_of(cls)}
        if given := {key: value[key] for key in value if key in hidden}:
            raise unknown_keys(given, keys_of(cls))


def keys_of(cls: Any) -> list[str]:  # noqa: ANN401 as explain
    """Return the keys that a file may give a dataclass; none for any other type."""
    if not is_dataclass(cls):
        return []
    return [field.name for field in fields(cls) if not field.metadata.get("hidden")]


def as_written(value: object) -> str:
    """Return a wrong value as its file has it, for a message: in one line, cut where long; of a list, its kind."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if not isinstance(value, str | int | float | bool | None):
        return kind_of_value(value)
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def kind_of_value(value: object) -> str:
    """Return the human-readable type of a value of a file."""
    return _KINDS.get(type(value), with_article(type(value).__name__))


def _mistakes(problems: list[ErrorDetails]) -> list[ErrorDetails]:
    """Return one problem for each mistake."""
    found: dict[Location, ErrorDetails] = {}
    for problem in problems:
        place = problem["loc"]
        if problem["type"] == "missing" and isinstance(place[-1], int):
            # A list that is too short, entry by entry.
            context = {"min_length": place[-1] + 1}
            place = place[:-1]
            problem = {"type": "too_short", "loc": place, "msg": "", "input": None, "ctx": context}
        found[place] = problem
    # What is wrong with a part makes the whole wrong as well: "too few", of what is left of a list.
    found = {
        place: problem
        for place, problem in found.items()
        if not any(place == other[: len(place)] for other in found if len(other) > len(place))
    }
    for *parents, name in [place for place, p in found.items() if p["type"] == _UNKNOWN_KEY]:
        absent = [
            str(place[-1])
            for place, problem in found.items()
            if problem["type"] == "missing" and place[:-1] == (*parents,)
        ]
        if absent:
            found[*parents, name]["ctx"]["known"] = absent
        for close in get_close_matches(str(name), absent, n=1, cutoff=0.5):
            del found[*parents, close]  # it is there, but misspelt
    return list(found.values())


def _location(problem: ErrorDetails) -> Location:
    """Return keys and numbers that lead to a problem, without pydantic's marks."""
    return tuple(part for part in problem["loc"] if not str(part).startswith("function-"))


def _entries(problem: ErrorDetails) -> str:
    """Return how many entries a list needs: ``one step``."""
    least, (*_, name) = problem["ctx"]["min_length"], _location(problem)
    is_plural = str(name).endswith("s") and not str(name).endswith("ss")
    if least == 1 and is_plural:
        return f"one {str(name)[:-1].replace('_', ' ')}"
    return "one entry" if least == 1 else f"{least} entries"


def _keys_at(cls: Any, place: Location) -> list[str]:  # noqa: ANN401 as explain
    """Return the keys of the dataclass at a place of another; none where there is no dataclass."""
    hint = cls
    for part in place:
        hint = _plain(hint)
        if get_origin(hint) is dict:
            hint = get_args(hint)[1]
        elif get_origin(hint) is tuple:
            hint = get_args(hint)[0]
        elif is_dataclass(hint):
            hint = get_type_hints(hint, include_extras=True).get(str(part))
        else:
            return []
    return keys_of(_plain(hint))


def _plain(hint: Any) -> Any:  # noqa: ANN401 as explain
    """Return a type without annotations, and without None."""
    if get_origin(hint) is Annotated:
        hint = get_args(hint)[0]
    if get_origin(hint) in (Union, UnionType):
        members = [member for member in get_args(hint) if member is not NoneType]
        hint = _plain(members[0]) if len(members) == 1 else None
    return hint
