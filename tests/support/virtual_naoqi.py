"""A stand-in NAOqi in virtual time: the services and the robot of the stand-in, without processes, network or waiting.

What it does, it does at the same moment each time. Its clients are connections of the driver, over a network with the
delays of ``config/networks``.
"""

from __future__ import annotations

import inspect
import os
import random
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from types import TracebackType
from typing import Any, Self, cast

import pytest

from pepper_driver import Pepper
from pepper_driver import robot as pepper_robot
from pepper_driver.backends import NotConnectedError
from pepper_driver.backends.naoqi.address import Address, Secret, naoqi_address
from pepper_driver.backends.naoqi.angles import AnglesBackend
from pepper_driver.backends.naoqi.backend import NaoqiBackend
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.qi_library import QiSession, QiSignal
from pepper_driver.backends.naoqi.robot import NaoqiRobot
from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.backends.naoqi_server.faults import (
    InjectedFault,
    Schedule,
    make_fault,
    parse_fault,
)
from pepper_driver.backends.naoqi_server.ipc import RobotClient
from pepper_driver.backends.naoqi_server.robot_process import RobotProcess
from pepper_driver.backends.naoqi_server.service_faults import FaultRouter, ServiceFaults
from pepper_driver.backends.naoqi_server.shared_values import BlackBox, Table, table_keys
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import NaoqiSettings, load_naoqi_settings, load_network, load_robot
from pepper_driver.config.naoqi_devices import load_naoqi_devices
from pepper_driver.realtime import RealTimePacer
from support.virtual_time import Action, Flag, VirtualTime

ROBOT = load_robot()
DEVICES = load_naoqi_devices(ROBOT)
KEYS = table_keys(ROBOT, DEVICES)
URI = "naoqi://virtual"
CYCLE = round(1e9 * ROBOT.cycle)
"""[ns]"""


PROCESSING = 2e-4
"""[s] that each message takes in addition to the network: time passes with every question."""


class VirtualFuture:
    """A future of ``qi``, in virtual time."""

    def __init__(self, time: VirtualTime) -> None:
        self._over = Flag(time)
        self._value: Any = None
        self._error: str | None = None
        self._callbacks: list[Callable[[VirtualFuture], object]] = []

    def isRunning(self) -> bool:
        return not self._over.is_set

    def wait(self, timeout: int) -> object:
        return self._over.wait(1e-3 * timeout)

    def hasError(self) -> bool:
        return self._error is not None

    def error(self) -> str:
        return self._error or ""

    def value(self) -> Any:
        assert self._over.is_set, "it would wait without end"
        if self._error is not None:
            raise RuntimeError(self._error)
        return self._value

    def addCallback(self, callback: Callable[[VirtualFuture], object]) -> None:
        if self._over.is_set:
            callback(self)
        else:
            self._callbacks.append(callback)

    def finish(self, value: Any, error: str | None = None) -> None:
        if not self._over.is_set:
            self._value, self._error = value, error
            self._over.set()
            for callback in self._callbacks:
                callback(self)


class Signal:
    """A signal of ``qi``."""

    def __init__(self) -> None:
        self._callbacks: list[Callable[..., object]] = []

    def connect(self, callback: Callable[..., object]) -> None:
        self._callbacks.append(callback)

    def __call__(self, *arguments: object) -> None:
        for callback in self._callbacks:
            callback(*arguments)


@lru_cache
def _takes(method: Any, number: int) -> bool:
    """Return True if a method takes so many arguments."""
    try:
        inspect.signature(method).bind(*range(number))
    except TypeError:
        return False
    return True


class Served:
    """A service and the calls that wait for it: one at a time, unless it takes several."""

    def __init__(self, time: VirtualTime, group: str, service: object, process: int) -> None:
        self._time, self._group, self.process = time, group, process
        self._several = getattr(service, "__qi_threading__", "") == "multi"
        self._waiting: deque[Action] = deque()
        self._busy = False
        self.methods: dict[str, list[Callable[..., Any]]] = {}
        for attribute in dir(service):
            value = getattr(service, attribute)
            name = getattr(value, "__qi_name__", None) or attribute
            if callable(value) and not name.startswith("_"):
                self.methods.setdefault(name, []).append(value)

    def call(
        self, method: str, arguments: Sequence[Any], answer: Callable[[Any, str | None], None]
    ) -> None:
        """Call a method as soon as it is its turn."""
        self._waiting.append(partial(self._answer, method, arguments, answer))
        if self._several or not self._busy:
            self._busy = True
            self._time.start(self._work, self._group)

    def _work(self) -> None:
        while self._waiting:
            self._waiting.popleft()()
        self._busy = False

    def _answer(
        self, method: str, arguments: Sequence[Any], answer: Callable[[Any, str | None], None]
    ) -> None:
        fitting = [each for each in self.methods[method] if _takes(each, len(arguments))]
        if not fitting:
            answer(None, f"{method} takes no {len(arguments)} arguments")
            return
        try:
            value = fitting[0](*arguments)
        except Exception as error:
            answer(None, str(error))
            return
        if not hasattr(value, "isRunning"):
            answer(_plain(value), None)
            return

        def wait() -> None:
            while value.isRunning():
                self._time.sleep(0.001)
            if value.hasError():
                answer(None, value.error())
            else:
                answer(_plain(value.value()), None)

        # A slow method has a thread of its own: the next call need not wait for it.
        if value.isRunning():
            self._time.start(wait, self._group)
        else:
            wait()


def _plain(value: Any) -> Any:
    """Return a value as it comes out of the network: lists, no tuples."""
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    return value


class VirtualProxy:
    """A service, seen from a client."""

    def __init__(self, session: VirtualSession, name: str, served: Served) -> None:
        self._session, self._name, self._served = session, name, served

    def __getattr__(self, method: str) -> Callable[..., VirtualFuture]:
        if method not in self._served.methods:
            raise AttributeError(method)

        def call(*arguments: Any, _async: bool) -> VirtualFuture:
            assert _async
            arguments = tuple(_plain(argument) for argument in arguments)
            return self._session.ask(
                lambda answer: self._served.call(method, arguments, answer),
                f"{self._name}.{method}",
            )

        return call


class VirtualSession:
    """A connection of a client with the virtual NAOqi. Messages of a direction arrive in their order.

    Attributes:
        asked: (time [s], what) of all that it asked.
    """

    def __init__(self, naoqi: VirtualNaoqi) -> None:
        self._naoqi, self._time = naoqi, naoqi.time
        self._lost = Signal()
        self.disconnected: QiSignal = self._lost
        self._connected = True
        self._last = {"there": 0, "back": 0}
        self._pending: set[VirtualFuture] = set()
        self.asked: list[tuple[float, str]] = []

    def isConnected(self) -> bool:
        return self._connected

    def service(self, name: str, *, _async: bool) -> VirtualFuture:
        def find(answer: Callable[[Any, str | None], None]) -> None:
            served = self._naoqi.offered.get(name)
            if served is None:
                answer(None, f"Cannot find service '{name}' in index")
            else:
                answer(VirtualProxy(self, name, served[1]), None)

        return self.ask(find, name)

    def services(self, *, _async: bool) -> VirtualFuture:
        def find(answer: Callable[[Any, str | None], None]) -> None:
            offered = self._naoqi.offered.items()
            answer(
                [
                    {"name": name, "serviceId": number, "processId": served.process}
                    for name, (number, served) in offered
                ],
                None,
            )

        return self.ask(find, "services")

    def registerService(self, name: str, service: object, *, _async: bool) -> VirtualFuture:
        def offer(answer: Callable[[Any, str | None], None]) -> None:
            if name in self._naoqi.offered:
                answer(None, f"Service '{name}' is already registered")
            else:
                served = Served(self._time, "client", service, os.getpid())
                answer(self._naoqi.offer(name, served, self), None)

        return self.ask(offer, "registerService")

    def unregisterService(self, number: int, *, _async: bool) -> VirtualFuture:
        def withdraw(answer: Callable[[Any, str | None], None]) -> None:
            answer(None, None if self._naoqi.withdraw(number) else f"no service {number}")

        return self.ask(withdraw, "unregisterService")

    def close(self) -> None:
        self.lose()

    def lose(self) -> None:
        """Be disconnected."""
        if self._connected:
            self._connected = False
            self._naoqi.left(self)
            for future in list(self._pending):
                future.finish(None, "Endpoint disconnected")
            self._pending.clear()
            self._lost("Endpoint disconnected")

    def ask(
        self, question: Callable[[Callable[[Any, str | None], None]], None], what: str
    ) -> VirtualFuture:
        """Carry a question there, and its answer back."""
        future = VirtualFuture(self._time)
        self.asked.append((self._time.seconds(), what))
        if not self._connected:
            future.finish(None, "Session closed")
            return future
        self._pending.add(future)

        def back(value: Any, error: str | None) -> None:
            def arrive() -> None:
                self._pending.discard(future)
                future.finish(value, error)

            self._carry("back", arrive, "")

        self._carry("there", lambda: question(back), self._naoqi.group)
        return future

    def _carry(self, direction: str, arrive: Action, group: str) -> None:
        def deliver() -> None:
            if not self._connected:
                return
            if self._naoqi.blocked is not None:  # TCP repeats it once the link is open again
                self._naoqi.blocked.append((group, deliver))
            else:
                arrive()

        due = max(self._time.now + round(1e9 * self._naoqi.delay()), self._last[direction])
        self._last[direction] = due
        self._time.later(1e-9 * (due - self._time.now), deliver, group)


def pacer_of(backend: NaoqiRobot) -> RealTimePacer:
    """Return the pacer of a loop on this backend."""
    return RealTimePacer(ROBOT.cycle, backend, clock=backend.clock)


class VirtualRobotClient(RobotClient):
    """The robot as the services see it: in the same process."""

    def __init__(self, process: RobotProcess, table: Table, time: VirtualTime) -> None:
        self._process, self._table, self._time = process, table, time
        self._keys, self._actuators = KEYS, frozenset(DEVICES.actuators)
        clock = table.clock
        self._begin, self._origin = clock.begin, clock.origin

    def time(self) -> int:
        return wrapped(self._origin + (self._time.now - self._begin) // 1_000_000)

    def ask(self, what: str, **arguments: object) -> Any:
        return self._process.handle(what, **arguments)


@dataclass
class Faults:
    """Control of faults for the service ``StandIn``."""

    robot: VirtualNaoqi
    services: ServiceFaults

    def set(self, name: str, arguments: Mapping[str, Any]) -> None:
        self.robot.inject(make_fault(name, arguments))

    def clear(self) -> None:
        self.robot.clear_faults()


class VirtualNaoqi:
    """NAOqi, its robot and the network in virtual time, with the controls of ``launch.StandIn``. A context manager.

    Args:
        uri: The simulated robot.
        clock: DCM time at the start [ms].
        consent: True if the owner of the robot allows safety reflexes to be switched off.
        version: Of NAOqi; "" for that of ``naoqi_services.yaml``.
        network: Between the robot and its clients.
        seed: Of the delays.

    Attributes:
        time: In which all happens.
        robot: The robot, past NAOqi.
        offered: Number and service by name.
        blocked: Messages that the blocked link holds; None where it is open.
        group: Threads of the present NAOqi.
    """

    def __init__(
        self,
        uri: str = "mujoco://?seed=3",
        *,
        clock: int = 5_000_000,
        consent: bool = True,
        version: str = "",
        network: str = "wired",
        seed: int = 0,
    ) -> None:
        self.time = VirtualTime()
        self._consent, self._version = consent, version
        self._before = self._network = load_network(network)
        self._random = random.Random(seed)
        self.blocked: list[tuple[str, Action]] | None = None
        self._cut = False
        self._sessions: set[VirtualSession] = set()
        self._file = Table.make_file()
        self._process = RobotProcess(uri, self._file, clock, self.time.clock("robot"))
        self._table = Table(self._file, len(KEYS), ROBOT)
        self.robot = VirtualRobotClient(self._process, self._table, self.time)
        self._due = self.time.now
        self.time.later(ROBOT.cycle, self._cycle, "robot")
        self._starts = 0
        self.offered: dict[str, tuple[int, Served]] = {}
        self._owners: dict[str, VirtualSession] = {}
        self._numbers = 0
        self._schedule = Schedule(self.time.later)
        self._running = False
        self.start_naoqi()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.time.close()
        os.close(self._file)

    def _cycle(self) -> None:
        self._due += CYCLE
        self.time.later(ROBOT.cycle, self._cycle, "robot")
        self._process.step(self._due)

    # -- NAOqi --------------------------------------------------------------------------------------------------

    def start_naoqi(self) -> None:
        """Start NAOqi, again after it was killed."""
        from pepper_driver.backends.naoqi_server.server import make_context, make_services  # qi

        self._starts += 1
        self.group = f"naoqi {self._starts}"
        clock = self.time.clock(self.group)
        self._service_faults = ServiceFaults(clock)
        context = make_context(
            self.robot,
            cast(FaultRouter, Faults(self, self._service_faults)),
            consent=self._consent,
            version=self._version,
            services=lambda: self.offered,
            call=self._call,
            clock=clock,
        )
        self._services = {
            name: Served(self.time, self.group, service, 0)
            for name, service in make_services(context).items()
        }
        for name, served in self._services.items():
            self.offer(name, served)
        context.start()
        self._running = True

    def kill_naoqi(self) -> None:
        """End NAOqi, as kill -9 does; the robot goes on."""
        self._running = False
        self.time.kill(self.group)
        self.offered.clear()
        for session in list(self._sessions):
            session.lose()

    def suspend_naoqi(self) -> None:
        """Stop NAOqi, as SIGSTOP does; the robot goes on."""
        self.time.suspend(self.group)

    def resume_naoqi(self) -> None:
        """Let NAOqi continue."""
        self.time.resume(self.group)

    def offer(self, name: str, served: Served, owner: VirtualSession | None = None) -> int:
        """Register a service."""
        self._numbers += 1
        self.offered[name] = (self._numbers, served)
        if owner is not None:
            self._owners[name] = owner
        return self._numbers

    def withdraw(self, number: int) -> bool:
        """Unregister a service; return True if there was one."""
        names = [name for name, (known, _) in self.offered.items() if known == number]
        for name in names:
            del self.offered[name]
            self._owners.pop(name, None)
        return bool(names)

    def left(self, session: VirtualSession) -> None:
        """Forget a session and the services it offers."""
        self._sessions.discard(session)
        for name in [name for name, owner in self._owners.items() if owner is session]:
            self.offered.pop(name, None)
            del self._owners[name]

    def _call(self, service: str, method: str, *arguments: object) -> None:
        if service in self.offered:
            self.offered[service][1].call(method, arguments, lambda _value, _error: None)

    # -- clients ------------------------------------------------------------------------------------------------

    def delay(self) -> float:
        """Return the time of a message on its way [s]."""
        network, draw = self._network, self._random
        delay = network.delay + PROCESSING
        if network.jitter:
            delay += draw.expovariate(1.0 / network.jitter)
        if draw.random() < network.stall_probability:
            delay += network.stall
        return delay

    def session(self) -> VirtualSession:
        """Return a new session.

        Raises:
            NotConnectedError: There is no NAOqi, or no link.
        """
        if self._cut or not self._running:
            raise NotConnectedError(f"'{URI}': no server listens")
        self.time.sleep(4 * self.delay())
        session = VirtualSession(self)
        self._sessions.add(session)
        return session

    def connect(
        self,
        address: Address | None = None,
        secret: Secret | None = None,
        on_lost: Callable[[], None] | None = None,
        settings: NaoqiSettings | None = None,
    ) -> Connection:
        """Connect, as ``connection.connect`` does."""
        call_time = (settings or load_naoqi_settings()).call_time
        address = address or naoqi_address(parse_uri(URI), set())
        session = cast(QiSession, self.session())
        return Connection(address, session, on_lost, call_time, self.time.clock())

    def backend(
        self,
        mode: str = "dcm",
        settings: NaoqiSettings | None = None,
        *,
        wake: bool = False,
        force: bool = False,
    ) -> NaoqiRobot:
        """Return a backend that drives this robot."""
        kind = NaoqiBackend if mode == "dcm" else AnglesBackend
        return kind(
            naoqi_address(parse_uri(URI), set()),
            ROBOT,
            settings or load_naoqi_settings(),
            wake=wake,
            force=force,
            clock=self.time.clock(),
            connect=self.connect,
        )

    def pepper(
        self,
        mode: str = "dcm",
        settings: NaoqiSettings | None = None,
        *,
        wake: bool = False,
        **arguments: Any,
    ) -> Pepper:
        """Return a Pepper that drives this robot and ticks in the thread of the test."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                pepper_robot, "make_backend", lambda *_: self.backend(mode, settings, wake=wake)
            )
            return Pepper(URI, **{"observer": None, "loop": "caller", **arguments})

    def call(self, service: str, method: str, *arguments: object) -> Any:
        """Call a service as another program does, and wait for the answer."""
        connection = self.connect()
        try:
            return connection.call(service, method, *arguments, timeout=60.0)
        finally:
            connection.close()

    def wake_up(self) -> None:
        """Have the robot stand up."""
        self.call("ALMotion", "wakeUp")

    # -- faults and truth ---------------------------------------------------------------------------------------

    def set_fault(self, text: str) -> None:
        """Inject a fault; see ``faults.parse_fault``."""
        self.inject(parse_fault(text))

    def inject(self, fault: InjectedFault) -> None:
        """Inject a fault."""
        place = fault.kind.place
        if place == "robot":
            self.robot.set_fault(fault.name, **fault.all_arguments)
        elif fault.name == "missing":
            name = str(fault.arguments["service"])
            self._schedule.set(
                fault,
                lambda: self._withhold(name),
                lambda: self._give_back(name),
            )
        elif place == "services":
            self._service_faults.set(fault)
        else:
            begin, end = {
                "network": (
                    lambda: self._change_network(str(fault.arguments["name"])),
                    lambda: self._change_network(None),
                ),
                "cut": (self._cut_link, self._open_link),
                "blocked": (self._block_link, self._open_link),
                "hang": (self.suspend_naoqi, self.resume_naoqi),
                "kill": (self.kill_naoqi, self.start_naoqi),
            }[fault.name]
            self._schedule.set(fault, begin, end)

    def _withhold(self, name: str) -> None:
        self.offered.pop(name, None)

    def _give_back(self, name: str) -> None:
        self.offer(name, self._services[name])

    def clear_faults(self) -> None:
        """End all faults that can end."""
        self._schedule.clear()
        self.robot.clear_faults()
        self._service_faults.clear()

    def _change_network(self, name: str | None) -> None:
        self._network = self._before if name is None else load_network(name)

    def _cut_link(self) -> None:
        self._cut = True
        for session in list(self._sessions):
            session.lose()

    def _block_link(self) -> None:
        self.blocked = []

    def _open_link(self) -> None:
        self._cut = False
        waiting, self.blocked = self.blocked or [], None
        for group, deliver in waiting:
            self.time.later(0.0, deliver, group)

    def black_box(self, last: int | None = None) -> BlackBox:
        """Return the truth of the last cycles."""
        return self._table.black_box(last)

    def since(self, moment: float) -> BlackBox:
        """Return the truth of the cycles that were due after a moment of virtual time [s]."""
        box = self.black_box()
        return BlackBox(**{name: rows[box.begin > moment] for name, rows in vars(box).items()})
