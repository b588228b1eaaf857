"""Starts and stops the processes of the stand-in; injects faults of connection and process."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib.util import find_spec
from types import TracebackType
from typing import Protocol, Self, TypeVar

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.mujoco_.backend import MujocoBackend
from pepper_driver.backends.naoqi_server.dcm import SPAN, wrapped
from pepper_driver.backends.naoqi_server.faults import (
    InjectedFault,
    Schedule,
    make_fault,
    parse_fault,
)
from pepper_driver.backends.naoqi_server.ipc import (
    Line,
    Robot,
    RobotClient,
    make_pair,
    spawn,
    wait_until_ready,
)
from pepper_driver.backends.naoqi_server.network import NetworkProxy
from pepper_driver.backends.naoqi_server.robot_faults import RobotFaults
from pepper_driver.backends.naoqi_server.shared_values import BlackBox, Table, table_keys
from pepper_driver.backends.naoqi_server.tls import Login
from pepper_driver.backends.selection import make_backend
from pepper_driver.config import ConfigError, MissingExtraError, load_network, load_robot
from pepper_driver.config.arguments import as_tuple, checked_arguments, is_number
from pepper_driver.config.errors import shown
from pepper_driver.config.naoqi_devices import load_naoqi_devices
from pepper_driver.config.signals import deferred_signals

MOMENT = 0.05
"""[s] from the answer to a client to the fault that may be its last."""


class Parts(Protocol):
    """The parts of a stand-in that faults are about."""

    @property
    def robot(self) -> Robot:
        """Past NAOqi."""

    @property
    def proxy(self) -> NetworkProxy | None:
        """Proxy of the connection, if there is one."""

    @property
    def network(self) -> str:
        """Name or file of the network that it had at the start."""

    def signal_naoqi(self, number: int) -> None:
        """Send the NAOqi process a signal; after SIGKILL it has ended when this returns."""

    def start_naoqi(self) -> None:
        """Start it again."""

    def inject_into_naoqi(self, fault: InjectedFault | None) -> None:
        """Have it set a fault of its services, or clear them."""


class FaultControl:
    """Sets and clears faults of every place."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._schedule = Schedule()

    def set(self, fault: InjectedFault) -> None:
        """Set a fault.

        Raises:
            PepperError: Not possible, for the reason given.
        """
        place = fault.kind.place
        if place == "robot":
            self._parts.robot.set_fault(fault.name, **fault.all_arguments)
        elif place == "services":
            self._parts.inject_into_naoqi(fault)
        elif place == "start":
            raise BackendError(f"fault '{fault.name}' is possible only at the start")
        else:
            begin, end = self._link(fault) if place == "link" else self._process(fault)
            self._schedule.set(fault, begin, end)

    def clear(self) -> None:
        """End all faults that can end; a NAOqi that was killed is started again."""
        self._schedule.clear()
        self._parts.robot.clear_faults()
        self._parts.inject_into_naoqi(None)

    def handle_request(
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

    def _link(self, fault: InjectedFault) -> tuple[Callable[[], None], Callable[[], None]]:
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

    def _process(self, fault: InjectedFault) -> tuple[Callable[[], None], Callable[[], None]]:
        parts = self._parts
        if fault.name == "hang":
            stop, go_on = signal.SIGSTOP, signal.SIGCONT
            return lambda: parts.signal_naoqi(stop), lambda: parts.signal_naoqi(go_on)
        return lambda: parts.signal_naoqi(signal.SIGKILL), parts.start_naoqi


T = TypeVar("T")


@checked_arguments
class StandIn:
    """A stand-in NAOqi with its robot. Use it as a context manager.

    The robot stands in its posture with stiffness 0. Both processes end with the block, and with this process.

    Args:
        uri: The simulated robot, as for ``make_backend``: ``mujoco://?plant=worn&seed=3&world=table&posture=Crouch``.
        host: Address to listen at.
        port: And the port; 0 for a free one.
        clock: DCM time at the start [ms]; by default that of the day, as a robot has it.
        consent: True if the owner of the robot allows safety reflexes to be switched off.
        version: Of NAOqi; by default that of ``naoqi_services.yaml``.
        outlive: Time that the robot continues after this process was killed [s].
        network: Name or file of the network in front of it; None for none, where its link cannot be changed either.
        login: Makes it NAOqi 2.9's endpoint: TLS, a user and a token.
        faults: What is wrong from the start.

    Attributes:
        proxy: Proxy of its clients' connections; None for none.

    Raises:
        PepperError: An argument is wrong, such as a plant, a world or a network that does not exist.
    """

    proxy: NetworkProxy | None = None

    def __init__(
        self,
        uri: str = "mujoco",
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        clock: int | None = None,
        consent: bool = False,
        version: str = "",
        outlive: float = 1.0,
        network: str | None = None,
        login: Login | None = None,
        faults: Sequence[InjectedFault] = (),
    ) -> None:
        for name, value, least, most in (("port", port, 0, 65535), ("clock", clock, -SPAN, SPAN)):
            if value is not None or name == "port":
                _check_integer(name, value, least, most)
        if not (is_number(outlive) and 0 <= outlive < math.inf):
            raise ConfigError(f"outlive must be a time [s], 0 or more, got {shown(outlive)}")
        for name, text in (("host", host), ("version", version)):
            if not isinstance(text, str) or (name == "host" and not text.strip()):
                raise ConfigError(f"{name} must be a text, got {shown(text)}")
        if as_tuple(faults) is None:
            raise ConfigError(f"faults must be a list: [parse_fault('hang')], got {shown(faults)}")
        for fault in faults:
            if not isinstance(fault, InjectedFault):
                raise ConfigError(
                    f"each of faults comes from parse_fault('hang'), got {shown(fault)}"
                )
        if network is not None:
            load_network(network)
        # Names are checked here, and not in processes that first have to start.
        config = load_robot()
        if not isinstance(make_backend(uri, config), MujocoBackend):
            raise BackendError(f"'{uri}': behind the stand-in there must be a simulated robot")
        trial = RobotFaults(config, table_keys(config, load_naoqi_devices(config)))
        for fault in faults:
            if fault.kind.place == "robot":
                trial.set(fault.name, fault.all_arguments)
            elif fault.name == "network":
                load_network(str(fault.arguments["name"]))
        self._link: RobotClient | None = None
        self._uri, self._host, self._port = uri, host, port
        self._clock, self._outlive = clock, outlive
        self._network, self._login, self._faults = network, login, faults
        self._control = FaultControl(self)
        self._naoqi_killed = False
        self._consent, self._version = consent, version
        self._robot: subprocess.Popen[bytes] | None = None
        self._naoqi: subprocess.Popen[bytes] | None = None
        self._open = ExitStack()

    def start(self) -> Self:
        """Start the robot, then NAOqi.

        Raises:
            BackendError: One of them refuses, for the reason given, or is started already.
        """
        if self._robot is not None:
            raise BackendError("the stand-in is started already")
        if find_spec("qi") is None:
            raise MissingExtraError(
                "a stand-in NAOqi (Linux on x86-64, Python up to 3.12)", "naoqi"
            )
        clock = wrapped(int(1000 * time.time()) if self._clock is None else self._clock)
        for fault in self._faults:
            if fault.name == "rollover":
                # 2^31 ms is the first count that the clock shows as negative.
                clock = wrapped(SPAN // 2 - round(1000 * float(fault.arguments["in"])))
        config = load_robot()
        devices = load_naoqi_devices(config)
        keys = table_keys(config, devices)
        self._file = Table.make_file()
        self._open.callback(os.close, self._file)
        # NAOqi's end of its line to the robot stays open here, for a NAOqi that is started again.
        self._line, robots = make_pair()
        self._open.enter_context(self._line)
        try:
            with robots:
                self._robot, owner = spawn(
                    "robot_process",
                    {"uri": self._uri, "clock": clock, "outlive": self._outlive},
                    {"table": self._file, "naoqi": robots.fileno()},
                )
            self._open.enter_context(owner)
            proxied = self._network is not None or self._login is not None
            self._naoqi_at = ("127.0.0.1", 0) if proxied else (self._host, self._port)
            naoqis = self._spawn_naoqi()  # at the same time: both take a while
            wait_until_ready(self._robot, owner)
            table = Table(self._file, len(keys), config)
            self._link = RobotClient(table, owner, keys, frozenset(devices.actuators))
            self._take_naoqi(naoqis)
            if proxied:
                self.proxy = NetworkProxy(
                    self._naoqi_at,
                    host=self._host,
                    port=self._port,
                    network=self.network,
                    login=self._login,
                )
            self._port = (self.proxy.address if self.proxy else self._naoqi_at)[1]
            for fault in self._faults:
                if fault.kind.place not in ("start", "services"):
                    self._control.set(fault)
        # Also on Ctrl-C: processes that have started must end.
        except BaseException:
            self.stop()
            raise
        return self

    def start_naoqi(self) -> None:
        """Start the NAOqi process again after it died, at the same port.

        Raises:
            BackendError: It cannot start, for example because the port is in use by now; or nothing was started.
        """
        _started(self._robot)
        self._take_naoqi(self._spawn_naoqi())

    def _spawn_naoqi(self) -> socket.socket:
        """Start the NAOqi process; returns the line to it."""
        host, port = self._naoqi_at
        faults = [
            {"name": fault.name, "arguments": fault.all_arguments}
            for fault in self._faults
            if fault.kind.place == "services"
        ]
        self._naoqi, end = spawn(
            "server",
            {
                "host": host,
                "port": port,
                "consent": int(self._consent),
                "version": self._version,
                "faults": json.dumps(faults),
            },
            {"table": self._file, "robot": self._line.fileno()},
        )
        self._open.enter_context(end)
        return end

    def _take_naoqi(self, end: socket.socket) -> None:
        """Wait until NAOqi is there."""
        ready = wait_until_ready(self.naoqi_process, end)
        self._naoqis_line = Line(end, "NAOqi process", self._control.handle_request)
        # Kept, so that a NAOqi that is started again has the same port.
        self._naoqi_at = (self._naoqi_at[0], int(ready["port"]))
        self._naoqi_killed = False

    @checked_arguments
    def set_fault(self, text: str) -> None:
        """Inject a fault; see ``faults.parse_fault``.

        Raises:
            UnknownNameError: No such fault, or no such joint, sensor or network.
            ConfigError: Arguments that it does not take.
            BackendError: Not possible, for the reason given.
        """
        self._control.set(parse_fault(text))

    def clear_faults(self) -> None:
        """End all faults that can end; a NAOqi that was killed is started again."""
        self._control.clear()

    @property
    def network(self) -> str:
        """Name or file of the network that it had at the start."""
        return self._network or "clear"

    @checked_arguments
    def signal_naoqi(self, number: int) -> None:
        """Send the NAOqi process a signal; when this returns it has ended after SIGKILL, and stands after SIGSTOP."""
        process = self.naoqi_process
        # Before the signal: wait(), on another thread, must not report this end.
        self._naoqi_killed = number == signal.SIGKILL
        process.send_signal(number)
        if number == signal.SIGKILL:
            process.wait()
        elif number == signal.SIGSTOP:  # some of its threads may be in the middle of an answer
            # WNOWAIT: Popen.wait() must still be able to collect the process.
            os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)

    def inject_into_naoqi(self, fault: InjectedFault | None) -> None:
        """Have NAOqi set a fault of its services, or clear them."""
        if fault is None:
            self._naoqis_line.ask("clear_faults")
        else:
            self._naoqis_line.ask("set_fault", name=fault.name, arguments=fault.all_arguments)

    @property
    def robot(self) -> RobotClient:
        """The robot, past NAOqi.

        Raises:
            BackendError: It was never started.
        """
        return _started(self._link)

    @property
    def port(self) -> int:
        """Port of NAOqi."""
        return self._port

    @property
    def url(self) -> str:
        """Address of NAOqi, as ``qi.Session.connect`` takes it."""
        return f"{'tcps' if self._login else 'tcp'}://{self._host}:{self._port}"

    @property
    def robot_process(self) -> subprocess.Popen[bytes]:
        """The robot process."""
        return _started(self._robot)

    @property
    def naoqi_process(self) -> subprocess.Popen[bytes]:
        """The NAOqi process. What happens to it does not touch the robot: kill, stop or continue it by its ``pid``."""
        return _started(self._naoqi)

    @checked_arguments
    def black_box(self, last: int | None = None) -> BlackBox:
        """Return the truth of the last two minutes, or ``last`` cycles; also after its process ended."""
        return self.robot.black_box(last)

    def wait(self) -> str:
        """Wait until NAOqi ends by itself, or is ended by others than a fault; returns how it ended.

        Raises:
            BackendError: The robot ended.
        """
        while True:
            if (code := self.robot_process.poll()) is not None:
                error = BackendError(f"the stand-in's robot process ended {_how(code)}")
                error.while_active = True
                raise error
            if (code := self.naoqi_process.poll()) is not None and not self._naoqi_killed:
                return _how(code)
            time.sleep(0.1)

    @deferred_signals()
    def stop(self) -> None:
        """End both processes. Does nothing when they have ended."""
        # First: the end of a fault would start NAOqi again.
        self._control.close()
        if self.proxy is not None:
            self.proxy.close()
            self.proxy = None
        for process in (self._naoqi, self._robot):
            if process is not None:
                with suppress(ProcessLookupError):
                    process.kill()  # a stopped process handles no other signal
                process.wait()
        self._naoqi = self._robot = None
        self._open.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()


def _check_integer(name: str, value: object, least: int, most: int) -> None:
    if isinstance(value, bool) or not (isinstance(value, int) and least <= value <= most):
        raise ConfigError(
            f"{name} must be a whole number from {least} to {most}, got {shown(value)}"
        )


def _started(part: T | None) -> T:
    if part is None:
        raise BackendError("the stand-in is not started: use it in a 'with' block")
    return part


def _how(code: int) -> str:
    return f"by signal {-code}" if code < 0 else f"with code {code}"
