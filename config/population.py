"""Robots of a population by the numbers of their draws: some for development, the others held out for tests.

Who tunes an observer on the robots that then judge it learns nothing. Draws from DEVELOPMENT_DRAWS on are refused for
every plant and caller, except inside :func:`allow_test_draws`. No file can change that: another plant with the same
section ``randomise`` would draw the same robots. Only Python code can allow them, in its own process.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import TypeVar

from pepper_driver.config.errors import ConfigError, shown

T = TypeVar("T")

DEVELOPMENT_DRAWS = 100
"""Draws for development, the first ones; all others are for tests."""

MAX_DRAWS = 1000
"""In one list of draws."""

_PART = re.compile(r"(\d{1,12})(?:-(\d{1,12}))?", re.ASCII)

_allowed: ContextVar[bool] = ContextVar("test_draws_allowed", default=False)


class HeldOutDrawError(ConfigError):
    """A draw is one of those for tests."""


@contextmanager
def allow_test_draws() -> Iterator[None]:
    """Allow the draws for tests in this process as long as the block is open: for the test split of the evaluation."""
    before = _allowed.set(True)
    try:
        yield
    finally:
        _allowed.reset(before)


def with_same_draws(job: Callable[[], T]) -> Callable[[], T]:
    """Return a job for another process that may use the draws for tests there if they are allowed here and now."""
    return partial(_with_test_draws, job) if _allowed.get() else job


def _with_test_draws(job: Callable[[], T]) -> T:
    with allow_test_draws():
        return job()


def check_draw(draw: int, source: str) -> None:
    """Refuse a draw that is for tests where these are not allowed.

    Args:
        draw: Its number.
        source: File of the plant, for the message.

    Raises:
        HeldOutDrawError: It is refused.
    """
    if draw >= DEVELOPMENT_DRAWS and not _allowed.get():
        raise HeldOutDrawError(
            f"{source}: draw {draw} is held out for the test split of the evaluation, as all from {DEVELOPMENT_DRAWS} "
            f"on; for development there are 0 to {DEVELOPMENT_DRAWS - 1}"
        )


def parse_draws(text: str) -> tuple[int, ...]:
    """Return the numbers in a list of draws such as ``0-19`` or ``0,3,7-9``, in the order given.

    Raises:
        ConfigError: It is no such list, gives a draw twice, or too many of them.
    """
    numbers: list[int] = []
    for part in text.split(","):
        found = _PART.fullmatch(part.strip())
        if found is None:
            raise ConfigError(
                f"draws: expected numbers and ranges such as 0-19 or 0,3,7-9, got {shown(text)}"
            )
        first, last = int(found[1]), int(found[2] or found[1])
        if last < first:
            raise ConfigError(f"draws: the range {first}-{last} ends before it begins")
        if len(numbers) + last - first >= MAX_DRAWS:
            raise ConfigError(f"draws: {shown(text)} are more than {MAX_DRAWS}")
        numbers.extend(range(first, last + 1))
    if len(set(numbers)) != len(numbers):
        raise ConfigError(f"draws: {shown(text)} give a draw twice")
    return tuple(numbers)
