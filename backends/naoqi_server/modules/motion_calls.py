"""What the parts of ALMotion share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.motion.body import CallError


class MotionCalls:
    """Calls that use the writer of ALMotion. A motion that takes its time does not hold up the others."""

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._shared = context.shared
        self._motion = context.shared.motion
        self._memory = context.memory


def rising(times: Sequence[float], where: str) -> list[float]:
    """Times of a motion [s].

    Raises:
        CallError: They are not positive, or do not rise.
    """
    if not times or times[0] <= 0 or any(a >= b for a, b in pairwise(times)):
        raise CallError(where, f"times must be above 0 and rise: {list(times)}")
    return list(times)


def switch(value: object, where: str) -> bool:
    """True or False, also as 1 or 0.

    Raises:
        CallError: It is something else.
    """
    if value not in (True, False):
        raise CallError(where, f"expected true or false, got {value!r}")
    return bool(value)
