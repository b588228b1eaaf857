"""Where the NAOqi process takes faults: those of services it has itself, the others it hands on."""

from __future__ import annotations

import socket
from collections.abc import Callable, Mapping
from typing import Any

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.faults import Fault, make_fault
from pepper_driver.backends.naoqi_server.line import Line
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.backends.naoqi_server.schedule import Schedule
from pepper_driver.backends.naoqi_server.service_faults import ServiceFaults


class FaultDesk:
    """Sets and clears faults of every place.

    Args:
        robot: Has its own.
        owner: End of the line to whoever started this process, who has those of the link and of the process as a whole.
        offer: ``offer(service, there)`` lets a service be there or not.
        gone: Called when whoever started this is gone.

    Attributes:
        services: What calls of services pass.
    """

    def __init__(
        self,
        robot: Robot,
        owner: socket.socket,
        offer: Callable[[str, bool], None],
        gone: Callable[[], None],
    ) -> None:
        self.services = ServiceFaults()
        self._robot, self._offer = robot, offer
        self._schedule = Schedule()
        self._owner = Line(owner, "launcher", self._obey, gone)

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

    def set_service_fault(self, fault: Fault) -> None:
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

    def _obey(
        self, what: str, name: str = "", arguments: Mapping[str, object] | None = None
    ) -> None:
        if what == "set_fault":
            self.set_service_fault(make_fault(name, arguments))
        else:
            self.clear_service_faults()
