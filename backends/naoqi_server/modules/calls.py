"""What all services share: calls that take their time, and what is kept of calls that nobody can see."""

from __future__ import annotations

import functools
import time
from collections import deque
from collections.abc import Callable
from threading import Lock, Thread
from typing import Any, TypeVar

import qi

KEPT = 1000
"""Entries of the record."""

Method = TypeVar("Method", bound=Callable[..., Any])


class Record:
    """What services were told to do that nobody sees: speech, lights, the tablet. The oldest entries are forgotten."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._begin = time.monotonic()
        self._entries: deque[tuple[float, str, str, list[object]]] = deque(maxlen=KEPT)

    def add(self, service: str, method: str, *arguments: object) -> None:
        """Keep a call."""
        with self._lock:
            now = time.monotonic() - self._begin
            self._entries.append((now, service, method, list(arguments)))

    @property
    def entries(self) -> list[list[object]]:
        """``[seconds since the start, service, method, [arguments]]`` of each, oldest first."""
        with self._lock:
            return [list(entry) for entry in self._entries]


def blocking(method: Method) -> Method:
    """Let a method of a service take its time.

    Whoever calls it waits for its end, but no thread of qi does: it has four, and four calls that block would block all
    others. The method runs on a thread of its own and qi is handed a future.
    """

    @functools.wraps(method)
    def begin(*arguments: object) -> object:
        promise = qi.Promise()

        def run() -> None:
            try:
                value = method(*arguments)
            except Exception as error:  # whatever it is, it is for whoever called
                promise.setError(str(error))
            else:
                promise.setValue(value)

        Thread(target=run, name=method.__name__, daemon=True).start()
        return promise.future()

    return begin  # type: ignore[return-value]  # to whoever calls by qi it is the same
