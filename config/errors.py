"""Errors of the project: one root for ``except PepperError``; leaves also are the builtin they resemble."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class PepperError(Exception):
    """Root of every error this project raises on purpose. All can be sent between processes."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (type(self), self.args, self.__dict__)


def _rebuilt(kind: type[PepperError], args: tuple[Any, ...], state: dict[str, Any]) -> PepperError:
    """An error from its message and data, without the constructor that composed the message."""
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class ConfigError(PepperError, ValueError):
    """A configuration file is wrong; the message names file, key and cure."""


class UnknownNameError(PepperError, LookupError):
    """A name (joint, link, plant, backend, ...) that does not exist here.

    Attributes:
        kind: What was looked for, for example ``"joint"``.
        name: The name as given.
        choices: The names that do exist.
    """

    def __init__(self, kind: str, name: str, choices: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.choices = tuple(choices)
        super().__init__(f"unknown {kind} '{name}'{suggestion(name, self.choices)}")


class MissingExtraError(PepperError, ImportError):
    """An optional part of the package is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, extra: str) -> None:
        self.extra = extra
        super().__init__(f'{what} needs an optional part: pip install "pepper-driver[{extra}]"')


def suggestion(name: str, choices: Iterable[str]) -> str:
    """The tail of an error message: close matches of ``name``, and all choices where they are few."""
    known = sorted({str(choice) for choice in choices})
    close = get_close_matches(str(name), known, n=3, cutoff=0.5)
    parts = []
    if close:
        parts.append(f"did you mean {' or '.join(close)}?")
    if known and (len(known) <= 25 or not close):
        parts.append(f"possible: {', '.join(known)}")
    return f" ({'; '.join(parts)})" if parts else ""
