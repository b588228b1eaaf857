"""Where whoever started the stand-in sets faults: those of the link and of the NAOqi process happen here."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.faults import Fault, make_fault
from pepper_driver.backends.naoqi_server.proxy import NetworkProxy
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.backends.naoqi_server.schedule import Schedule

MOMENT = 0.05
"""[s] from the answer to a client to the fault that may be its last."""


class Parts(Protocol):
    """The parts of a stand-in that faults are about."""

    @property
    def robot(self) -> Robot:
        """Past NAOqi."""

    @property
    def proxy(self) -> NetworkProxy | None:
        """What the link goes through, if anything."""

    @property
    def network(self) -> str:
        """Name or file of the network that it had at the start."""

    def signal_naoqi(self, number: int) -> None:
        """Send the NAOqi process a signal; after SIGKILL it is gone when this returns."""

    def start_naoqi(self) -> None:
        """Start it anew."""

    def tell_naoqi(self, fault: Fault | None) -> None:
        """Let it set a fault of its services, or clear them."""


class FaultControl:
    """Sets and clears faults of every place."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._schedule = Schedule()

    def set(self, fault: Fault) -> None:
        """Set a fault.

        Raises:
            PepperError: Not possible, for the reason given.
        """
        place = fault.kind.place
        if place == "robot":
            self._parts.robot.set_fault(fault.name, **fault.all_arguments)
        elif place == "services":
            self._parts.tell_naoqi(fault)
        elif place == "start":
            raise BackendError(f"fault '{fault.name}' is possible only at the start")
        else:
            begin, end = self._link(fault) if place == "link" else self._process(fault)
            self._schedule.set(fault, begin, end)

    def clear(self) -> None:
        """End all faults that can end; a NAOqi that was killed is started anew."""
        self._schedule.clear()
        self._parts.robot.clear_faults()
        self._parts.tell_naoqi(None)

    def obey(
        self, what: str, name: str = "", arguments: Mapping[str, object] | None = None
    ) -> None:
        """Do what a client asked of NAOqi that is not NAOqi's own affair; set faults begin once it has its answer."""
        if what == "set_fault":
            fault = make_fault(name, arguments)
            self.set(replace(fault, after=max(fault.after, MOMENT)))
        else:
            self._schedule.clear()

    def close(self) -> None:
        """Nothing begins or ends any more."""
        self._schedule.close()

    def _link(self, fault: Fault) -> tuple[Callable[[], None], Callable[[], None]]:
        proxy = self._parts.proxy
        if proxy is None:
            raise BackendError(
                f"fault '{fault.name}' needs a link: start the stand-in with the network 'clear', or another"
            )
        if fault.name == "network":
            name, before = str(fault.arguments["name"]), self._parts.network
            return lambda: proxy.network(name), lambda: proxy.network(before)
        if fault.name == "cut":
            return lambda: proxy.link("cut"), lambda: proxy.link("open")
        return lambda: proxy.link("blocked"), lambda: proxy.link("open")

    def _process(self, fault: Fault) -> tuple[Callable[[], None], Callable[[], None]]:
        parts = self._parts
        if fault.name == "hang":
            stop, go_on = signal.SIGSTOP, signal.SIGCONT
            return lambda: parts.signal_naoqi(stop), lambda: parts.signal_naoqi(go_on)
        return lambda: parts.signal_naoqi(signal.SIGKILL), parts.start_naoqi
