"""The rule of every refusal of a wrong input: an error of this project, in one line that a person can use."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pepper_driver.config import PepperError

JARGON = (
    "Traceback",
    "NoneType",
    "object is not",
    "expected str instance",
    "Errno",
    "codec can't decode",
    "positional argument",
    "has no attribute",
    "not subscriptable",
    "unhashable",
    "ufunc",
    "object of type",
    "could not convert",
    "invalid literal",
    "<class",
    "<function",
    " object at 0x",
    "Input should",
    "unable to parse",
    "after validation",
    "validation error",
)
"""What Python and its libraries say, and no user of a robot understands."""

MAX_LENGTH = 600
"""[letters] Of a message. All names that are possible are in it where there are up to 25."""


def check_line(message: str) -> None:
    """Check that a message is one line without jargon or control characters."""
    assert message, "says nothing"
    assert message.isprintable(), repr(message)
    assert len(message) <= MAX_LENGTH, message
    found = [word for word in JARGON if word in message]
    assert not found, message


def check_refused(call: Callable[[], object], *expected: str) -> PepperError:
    """Check that a call raises an error of the project whose message holds all of ``expected``; return the error."""
    with pytest.raises(PepperError) as caught:
        call()
    message = str(caught.value)
    check_line(message)
    for text in expected:
        assert text in message, message
    return caught.value
