"""What clients see of a service: qi would show them its private methods too, and tell them where our code raised."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial, wraps
from typing import Any, TypeVar

import qi

from pepper_driver.backends.naoqi_server.service_faults import ServiceFaults
from pepper_driver.config import PepperError

T = TypeVar("T", bound=Callable[..., Any])

_log = logging.getLogger(__name__)


def named(name: str) -> Callable[[T], T]:
    """A decorator: clients call the method ``name``. Several of one name must differ in how much they take."""

    def give(method: T) -> T:
        bound: T = qi.bind(methodName=name)(method)
        return bound

    return give


def make_front(name: str, service: object, faults: ServiceFaults) -> object:
    """An object for ``registerService``: the public methods, signals and properties of ``service``.

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
            failed = qi.Promise()
            text = str(error)
            failed.setError(
                text if text.startswith(f"{service}::") else f"{service}::{name}: {text}"
            )
            return failed.future()

    return call
