"""What all services share: calls that take their time, and what is kept of calls that nobody can see."""

from __future__ import annotations

import functools
import inspect
import time
from collections import deque
from collections.abc import Callable
from threading import Lock, Thread
from typing import Any, TypeVar

KEPT = 1000
"""Entries of the record."""

Method = TypeVar("Method", bound=Callable[..., Any])


class Record:
    """What services were told to do that moves nothing: speech, lights, the tablet. The oldest entries are forgotten."""

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
    def begin(*arguments: Any) -> Any:  # noqa: ANN401
        import qi  # not installed everywhere, and only needed behind a server

        promise = qi.Promise()

        def run() -> None:
            try:
                value = method(*arguments)
            except Exception as error:  # to whoever called
                promise.setError(str(error))
            else:
                promise.setValue(value)

        Thread(target=run, name=method.__name__, daemon=True).start()
        return promise.future()

    return begin  # type: ignore[return-value]  # to whoever calls by qi it is the same


def returning(signature: str) -> Callable[[Method], Method]:
    """Declare what a method of a service returns, in qi's signatures; for what qi would take for something else."""

    def declare(method: Method) -> Method:
        # What qi.bind sets: by hand, so that this package can be imported without qi.
        count = len(inspect.signature(method).parameters) - 1
        attributes = {"name": None, "signature": f"({'m' * count})", "return_signature": signature}
        for name, value in attributes.items():
            setattr(method, f"__qi_{name}__", value)
        return method

    return declare
