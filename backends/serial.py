"""Methods of a backend that wait for each other, whichever threads call them."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar


class Serial:
    """Base of classes with methods that are marked with :func:`serial`."""

    def __init__(self) -> None:
        self._lock = (
            threading.RLock()
        )  # re-entrant: for signal handlers, and methods that call each other


P = ParamSpec("P")
S = TypeVar("S", bound=Serial)
R = TypeVar("R")


def serial(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Let a method run only while no other thread runs a serial method of the same object."""

    @functools.wraps(method)
    def alone(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        with self._lock:
            return method(self, *args, **kwargs)

    return alone
