"""What can be wrong with the services of NAOqi: each call may be late, refused, or answered wrongly."""

from __future__ import annotations

import functools
import inspect
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pepper_driver.backends.naoqi_server.faults import Fault

BODY_TYPE = "RobotConfig/Body/Type"
"""Key of ALMemory that says which robot it is."""


@dataclass(frozen=True)
class _Switch:
    fault: Fault
    begin: float
    end: float

    def concerns(self, service: str, method: str) -> bool:
        calls = self.fault.arguments.get("calls", "")
        return calls in ("", service, f"{service}.{method}")


class ServiceFaults:
    """The faults of services that are set. One takes the place of another of the same name and the same texts.

    Args:
        clock: Monotonic [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._switches: dict[tuple[str, ...], _Switch] = {}
        self._changed = threading.Condition()

    def set(self, fault: Fault) -> None:
        """Set a fault."""
        begin = self._clock() + fault.after
        with self._changed:
            self._switches[fault.identity] = _Switch(fault, begin, begin + fault.seconds)
            self._changed.notify_all()

    def clear(self) -> None:
        """End them all: calls that were held up go on."""
        with self._changed:
            self._switches.clear()
            self._changed.notify_all()

    def wrapped(self, name: str, service: object) -> object:
        """The service with its calls passing here, to be registered as ``name``; both share their state.

        What a service calls of itself, and what other services call of it, does not pass.
        """
        kind = type(service)
        methods = {
            key: self._passing(name, method, service)
            for key, method in inspect.getmembers(kind, inspect.isfunction)
            if not key.startswith("__")
        }
        made: object = object.__new__(type(kind.__name__, (kind,), methods))
        made.__dict__ = service.__dict__
        return made

    def _passing(self, name: str, method: Callable[..., Any], service: object) -> object:
        called = getattr(method, "__qi_name__", method.__name__)  # overloads share a name

        @functools.wraps(method)
        def call(_: object, *arguments: Any) -> Any:  # noqa: ANN401
            self._hold_up(name, called)
            return self._answer(
                name, called, arguments, functools.partial(method, service, *arguments)
            )

        call.__signature__ = inspect.signature(method)  # type: ignore[attr-defined]  # qi counts parameters
        return call

    def _hold_up(self, service: str, method: str) -> None:
        for slow in self._active("slow", service, method):
            time.sleep(float(slow.fault.arguments["delay"]))
        with self._changed:
            while stalls := self._active("stall", service, method):
                self._changed.wait(min(stalls[0].end - self._clock(), threading.TIMEOUT_MAX))

    def _answer(
        self, service: str, method: str, arguments: Sequence[Any], call: Callable[[], Any]
    ) -> Any:  # noqa: ANN401
        for error in self._active("error", service, method):
            text = error.fault.arguments["text"] or "the stand-in was told to refuse this"
            raise RuntimeError(f"{service}::{method}\n\t{text}")
        answer = call()
        for none in self._active("none", service, method):
            part = str(none.fault.arguments["keys"])
            answer = _replaced(
                service, method, arguments, answer, functools.partial(_holds, part), None
            )
        for wrong in self._active("wrong-type", service, method):
            other = wrong.fault.arguments["type"]
            answer = _replaced(service, method, arguments, answer, BODY_TYPE.__eq__, other)
            if method == "getRobotType":
                answer = other
            elif method == "getRobotConfig":
                answer = [answer[0], [other, *answer[1][1:]]]
        return answer

    def _active(self, name: str, service: str, method: str) -> list[_Switch]:
        """The faults of this name that are on now and concern this call."""
        now = self._clock()
        return [
            switch
            for switch in list(self._switches.values())
            if switch.fault.name == name
            and switch.begin <= now < switch.end
            and switch.concerns(service, method)
        ]


def _replaced(
    service: str,
    method: str,
    arguments: Sequence[Any],
    answer: Any,  # noqa: ANN401
    chosen: Callable[[str], bool],
    value: object,
) -> Any:  # noqa: ANN401
    """The answer of ALMemory with another value for some keys."""
    if service == "ALMemory" and method == "getData" and chosen(arguments[0]):
        return value
    if service == "ALMemory" and method == "getListData":
        return [value if chosen(k) else old for k, old in zip(arguments[0], answer, strict=True)]
    return answer


def _holds(part: str, key: str) -> bool:
    return part in key
