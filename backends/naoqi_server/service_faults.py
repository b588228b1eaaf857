"""Faults of services, and the router that applies every kind of fault."""

from __future__ import annotations

import functools
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.faults import InjectedFault, Schedule, make_fault
from pepper_driver.backends.naoqi_server.ipc import Line, Robot
from pepper_driver.backends.naoqi_server.memory import Value
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock

BODY_TYPE = "RobotConfig/Body/Type"
"""Key of ALMemory that says which robot it is."""


@dataclass(frozen=True)
class _Switch:
    fault: InjectedFault
    begin: float
    end: float

    def concerns(self, service: str, method: str) -> bool:
        calls = self.fault.arguments.get("calls", "")
        return calls in ("", service, f"{service}.{method}")


class ServiceFaults:
    """The faults of services that are set; all calls of clients go through :meth:`call`.

    One takes the place of another of the same name and the same texts.

    Args:
        clock: By which they begin and end.
    """

    def __init__(self, clock: Clock = MONOTONIC_CLOCK) -> None:
        self._clock = clock
        self._switches: dict[tuple[str, ...], _Switch] = {}
        self._lock = threading.Lock()

    def set(self, fault: InjectedFault) -> None:
        """Set a fault."""
        begin = self._clock.seconds() + fault.after
        with self._lock:
            self._switches[fault.identity] = _Switch(fault, begin, begin + fault.seconds)

    def clear(self) -> None:
        """End them all: delayed calls continue."""
        with self._lock:
            self._switches.clear()

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
            self._clock.sleep(float(slow.fault.arguments["delay"]))
        # A stall may be cleared at any time.
        self._clock.wait_for(lambda: not self._active("stall", service, method))

    def _answer(
        self, service: str, method: str, arguments: Sequence[Value], proceed: Callable[[], Value]
    ) -> Value:
        # Before the call: a refused command must not reach the robot.
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
        """Return the faults of this name that are on now and concern this call."""
        now = self._clock.seconds()
        return [
            switch
            # A copy, because other threads set faults meanwhile.
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
    """Return the answer of ALMemory with another value for some keys."""
    if service == "ALMemory" and method == "getData" and chosen(arguments[0]):
        return value
    if service == "ALMemory" and method == "getListData":
        return [value if chosen(k) else old for k, old in zip(arguments[0], answer, strict=True)]
    return answer


def _holds(part: str, key: str) -> bool:
    return part in key


class FaultRouter:
    """Sets and clears faults of every place.

    Args:
        robot: Has its own.
        owner: Connection to the parent process, which handles faults of the connection and of this whole process.
        offer: ``offer(service, there)`` registers a service or unregisters it.
        on_end: Called when the parent process has ended.

    Attributes:
        services: What calls of services pass.
    """

    def __init__(
        self,
        robot: Robot,
        owner: socket.socket,
        offer: Callable[[str, bool], None],
        on_end: Callable[[], None],
    ) -> None:
        self.services = ServiceFaults()
        self._robot, self._offer = robot, offer
        self._schedule = Schedule()
        self._owner = Line(owner, "launcher", self._handle_request, on_end)

    def set(self, name: str, arguments: Mapping[str, Any]) -> None:
        """Set a fault. One of the link or of the process begins a moment after this returns.

        Raises:
            UnknownNameError: No such fault, or no such joint or sensor.
            ConfigError: Arguments that it does not take.
            BackendError: Not possible while the stand-in runs.
        """
        fault = make_fault(name, arguments)
        if fault.kind.place == "robot":
            self._robot.set_fault(name, **arguments)
        elif fault.kind.place == "services":
            self.set_service_fault(fault)
        elif fault.kind.place == "start":
            raise BackendError(f"fault '{name}' is possible only at the start of the stand-in")
        else:
            self._owner.ask("set_fault", name=name, arguments=dict(arguments))

    def set_service_fault(self, fault: InjectedFault) -> None:
        """Set one of services.

        Raises:
            UnknownNameError: No such service.
        """
        if fault.name != "missing":
            self.services.set(fault)
            return
        service = str(fault.arguments["service"])
        self._schedule.set(
            fault, lambda: self._offer(service, False), lambda: self._offer(service, True)
        )

    def clear(self) -> None:
        """End all faults that can end."""
        self.clear_service_faults()
        self._robot.clear_faults()
        self._owner.ask("clear_faults")

    def clear_service_faults(self) -> None:
        """End those of services."""
        self.services.clear()
        self._schedule.clear()

    def _handle_request(
        self, what: str, name: str = "", arguments: Mapping[str, object] | None = None
    ) -> None:
        if what == "set_fault":
            self.set_service_fault(make_fault(name, arguments))
        else:
            self.clear_service_faults()
