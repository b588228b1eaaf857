"""What can be wrong with the services of NAOqi: each call may be late, refused, or answered wrongly."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.faults import Fault
from pepper_driver.backends.naoqi_server.memory import Value

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
    """The faults of services that are set; all calls of clients go through :meth:`call`.

    One takes the place of another of the same name and the same texts.

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

    def call(
        self, service: str, method: str, arguments: Sequence[Value], proceed: Callable[[], Value]
    ) -> Value:
        """Answer a call of a client: what the service answers when asked to ``proceed``, or something else, or later.

        Those of the service ``StandIn`` pass, so that faults can be cleared.

        Raises:
            BackendError: The client is to get this error.
        """
        if service == "StandIn":
            return proceed()
        self._hold_up(service, method)
        return self._answer(service, method, arguments, proceed)

    def _hold_up(self, service: str, method: str) -> None:
        for slow in self._active("slow", service, method):
            time.sleep(float(slow.fault.arguments["delay"]))
        with self._changed:
            while stalls := self._active("stall", service, method):
                self._changed.wait(min(stalls[0].end - self._clock(), threading.TIMEOUT_MAX))

    def _answer(
        self, service: str, method: str, arguments: Sequence[Value], proceed: Callable[[], Value]
    ) -> Value:
        for error in self._active("error", service, method):
            raise BackendError(str(error.fault.arguments["text"]))
        answer = proceed()
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
    arguments: Sequence[Value],
    answer: Value,
    chosen: Callable[[str], bool],
    value: object,
) -> Value:
    """The answer of ALMemory with another value for some keys."""
    if service == "ALMemory" and method == "getData" and chosen(arguments[0]):
        return value
    if service == "ALMemory" and method == "getListData":
        return [value if chosen(k) else old for k, old in zip(arguments[0], answer, strict=True)]
    return answer


def _holds(part: str, key: str) -> bool:
    return part in key
