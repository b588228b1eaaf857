"""Calls of services: blocking ones, their record, and the methods that clients see."""

from __future__ import annotations

import functools
import logging
from collections import deque
from collections.abc import Callable
from functools import partial, wraps
from threading import Lock
from typing import Any, Protocol, TypeVar

import qi

from pepper_driver.backends.naoqi_server.service_faults import ServiceFaults
from pepper_driver.config import PepperError
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock

KEPT = 1000
"""Entries of the record."""

Method = TypeVar("Method", bound=Callable[..., Any])


class Record:
    """Record of calls without a visible effect: speech, lights, the tablet. The oldest entries are forgotten."""

    def __init__(self, clock: Clock = MONOTONIC_CLOCK) -> None:
        self._lock = Lock()
        self._clock, self._begin = clock, clock.seconds()
        self._entries: deque[tuple[float, str, str, list[object]]] = deque(maxlen=KEPT)

    def add(self, service: str, method: str, *arguments: object) -> None:
        """Keep a call."""
        with self._lock:
            now = self._clock.seconds() - self._begin
            self._entries.append((now, service, method, list(arguments)))

    @property
    def entries(self) -> list[list[object]]:
        """``[seconds since the start, service, method, [arguments]]`` of each, oldest first."""
        with self._lock:
            return [list(entry) for entry in self._entries]


class Timed(Protocol):
    """A service whose methods take time."""

    _clock: Clock


def blocking(method: Method) -> Method:
    """Run a slow method of a service outside the threads of qi.

    The caller waits for its end, but no thread of qi does: qi has four, and four calls that block would block all
    others. The method runs on a thread of the service's ``_clock`` and qi is handed a future.
    """

    @functools.wraps(method)
    def begin(service: Timed, *arguments: object) -> object:
        promise = qi.Promise()

        def run() -> None:
            try:
                value = method(service, *arguments)
            except Exception as error:  # any error is passed to the caller
                promise.setError(str(error))
            else:
                promise.setValue(value)

        service._clock.start(run, method.__name__)
        return promise.future()

    return begin  # type: ignore[return-value]  # callers over qi see no difference


T = TypeVar("T", bound=Callable[..., Any])

_log = logging.getLogger(__name__)


def named(name: str) -> Callable[[T], T]:
    """Return a decorator: clients call the method ``name``. Several of one name must differ in how much they take."""

    def give(method: T) -> T:
        bound: T = qi.bind(methodName=name)(method)
        return bound

    return give


def make_front(name: str, service: object, faults: ServiceFaults) -> object:
    """Return an object for ``registerService``: the public methods, signals and properties of ``service``.

    Public are those whose name does not begin with an underscore, and those under :func:`named`. A class under
    ``qi.multiThreaded()`` stays so. Errors reach the client as their message alone.
    """
    front = type(name, (), {})
    threading = getattr(type(service), "__qi_threading__", None)
    if threading is not None:
        front.__qi_threading__ = threading  # type: ignore[attr-defined]
    made = front()
    for attribute in dir(service):
        value = getattr(service, attribute)
        public = not attribute.startswith("_") or getattr(value, "__qi_name__", None)
        if isinstance(value, qi.Signal | qi.Property):
            setattr(made, attribute, value)
        elif public and callable(value) and not attribute.startswith("__"):
            setattr(made, attribute, _guarded(name, value, faults))
    return made


def _guarded(service: str, method: Callable[..., Any], faults: ServiceFaults) -> Callable[..., Any]:
    name = getattr(method, "__qi_name__", None) or method.__name__

    @wraps(method)
    def call(*arguments: object) -> object:
        try:
            return faults.call(service, name, arguments, partial(method, *arguments))
        except Exception as error:
            if not isinstance(error, PepperError | ValueError | LookupError):
                _log.warning("%s.%s failed", service, name, exc_info=True)
            # An exception out of a bound method would reach the client with its traceback.
            failed = qi.Promise()
            text = str(error)
            failed.setError(
                text if text.startswith(f"{service}::") else f"{service}::{name}: {text}"
            )
            return failed.future()

    return call
