"""Errors of the project: one root for ``except PepperError``; leaves also are the builtin they resemble."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

MAX_SHOWN = 80
"""Letters of a wrong value that a message repeats."""

MAX_REASON_LENGTH = 300
"""[letters] Of the reason why a file is damaged, in a message."""

MAX_LISTED = 25
"""Names that a message lists."""

MAX_LIST_LENGTH = 400
"""[letters] Of all names that a message lists."""

_REASONS: dict[int, str] = {
    errno.ENOENT: "there is no such file",
    errno.EISDIR: "it is a folder",
    errno.ENOTDIR: "a part of its path is no folder",
    errno.EEXIST: "there is a file of this name",
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
    errno.EROFS: "the disk is read-only",
    errno.ENOSPC: "the disk is full",
    errno.ENAMETOOLONG: "its name is too long",
    errno.ELOOP: "its links lead in a circle",
}


class PepperError(Exception):
    """Root of every error this project raises on purpose. All can be sent between processes.

    Attributes:
        while_active: True where it ended a run of a robot that was active, or a sweep that had begun, and not the
            attempt to begin.
    """

    while_active = False

    def __str__(self) -> str:
        """Return the message in one line, for any text in its names."""
        return printable(super().__str__())

    def __reduce__(self) -> tuple[Any, ...]:
        # The __reduce__ of Exception calls the constructor with the message, which not all constructors here take.
        return _rebuilt, (type(self), self.args, self.__dict__)


def _rebuilt(kind: type[PepperError], args: tuple[Any, ...], state: dict[str, Any]) -> PepperError:
    """Return an error from its message and data, without the constructor that composed the message."""
    error = kind.__new__(kind, *args)
    error.args = args
    error.__dict__.update(state)
    return error


class ConfigError(PepperError, ValueError):
    """A configuration file is wrong; the message names file, key and remedy."""


class ArgumentError(PepperError, TypeError):
    """An argument of a function is missing, not known to it, or of another kind than it takes."""


class UnknownNameError(PepperError, LookupError):
    """A name (joint, link, plant, backend, ...) that does not exist here.

    Attributes:
        kind: Kind of name, for example ``"joint"``.
        name: The name as given, of any type.
        choices: The names that do exist.
    """

    def __init__(self, kind: str, name: object, choices: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.choices = tuple(choices)
        super().__init__(f"unknown {kind} {shown(name)}{suggestion(name, self.choices)}")


class MissingExtraError(PepperError, ImportError):
    """An optional part of the package is not installed; the message names the extra that brings it."""

    def __init__(self, what: str, extra: str) -> None:
        self.extra = extra
        super().__init__(f'{what} needs an optional part: pip install "pepper-driver[{extra}]"')


def check_name(kind: str, name: object, choices: Iterable[str]) -> None:
    """Refuse a name that is not in a list.

    Raises:
        UnknownNameError: It is not in the list.
    """
    known = tuple(choices)
    if not (isinstance(name, str) and name in known):
        raise UnknownNameError(kind, name, known)


def suggestion(name: object, choices: Iterable[str]) -> str:
    """Return the tail of an error message: close matches of ``name``, and the choices, or the first of many."""
    known = sorted({str(choice) for choice in choices})
    close = get_close_matches(str(name), known, n=3, cutoff=0.5)
    parts = []
    if close:
        parts.append(f"did you mean {' or '.join(close)}?")
    if known and (len(known) <= MAX_LISTED or not close):
        listed = known[:MAX_LISTED]
        while len(", ".join(listed)) > MAX_LIST_LENGTH:
            listed.pop()
        more = f" and {len(known) - len(listed)} more" if len(listed) < len(known) else ""
        parts.append(f"possible: {', '.join(listed)}{more}")
    return f" ({'; '.join(parts)})" if parts else ""


def shown(value: object) -> str:
    """Return a wrong value for a message: in one line, cut where it is long; of a large object, its type."""
    if isinstance(value, type):
        return f"the class {value.__name__}, not an object of it"
    if isinstance(value, FunctionType | BuiltinFunctionType | MethodType):
        return f"the function {value.__name__}"
    text = repr(value)
    # A memory address differs from run to run, and helps no reader.
    if len(text) <= MAX_SHOWN and text.isprintable() and " at 0x" not in text:
        return text
    if isinstance(value, str):
        return f"{value[:MAX_SHOWN]!r}..."
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array {value.shape} of {value.dtype}"
    return with_article(type(value).__name__)


def first_difference(there: object, asked: object, compared: Mapping[str, str]) -> str | None:
    """Return in words what differs first, such as ``with the seed 1, not 2``; None where nothing does.

    Args:
        there: That something was begun with.
        asked: That it is to go on with.
        compared: By name of an attribute of both, the words before its value.
    """
    for key, words in compared.items():
        old, new = getattr(there, key), getattr(asked, key)
        if old != new:
            return f"{words} {_as_words(old)}, not {_as_words(new)}"
    return None


def _as_words(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "none" if value is None else str(value)


def with_article(noun: str) -> str:
    """Return a noun behind ``a`` or ``an``."""
    return f"{'an' if noun[:1].upper() in 'AEIOU' else 'a'} {noun}"


def printable(text: str) -> str:
    """Return a text in one line: line breaks and other control characters as Python writes them."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def short_reason(error: Exception) -> str:
    """Return the reason of an error in one line of at most MAX_REASON_LENGTH letters."""
    text = " ".join(reason(error).split())
    return text if len(text) <= MAX_REASON_LENGTH else f"{text[:MAX_REASON_LENGTH]}..."


def reason(error: Exception) -> str:
    """Return why a file cannot be read or written, without the path that the error repeats."""
    if isinstance(error, UnicodeDecodeError):
        return f"not UTF-8 text, at byte {error.start}"
    if isinstance(error, OSError) and error.errno is not None:
        return _REASONS.get(error.errno) or error.strerror or type(error).__name__
    if isinstance(error, ValueError) and "null byte" in str(error):
        return "no file can have this name"
    return str(error) or type(error).__name__
