"""Messages between the processes of the stand-in, and the robot as NAOqi's process sees it."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.dcm import TimedCommand, UpdateType
from pepper_driver.backends.naoqi_server.hands import RemoteHand, TrueScene
from pepper_driver.backends.naoqi_server.shared_values import BlackBox, Table
from pepper_driver.config import PepperError

MAX_PACKET_SIZE = 1 << 18
"""[bytes] of the longest packet."""


def make_pair() -> tuple[socket.socket, socket.socket]:
    """Two ends of a connection that keeps packets whole, even if a sender is killed."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in pair:
        # Linux refuses a packet that does not fit into the send buffer (EMSGSIZE).
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * MAX_PACKET_SIZE)
    return pair


def send(end: socket.socket, message: dict[str, Any], *, wait: bool = True) -> None:
    """Send one message.

    Raises:
        BackendError: It is too long.
        OSError: The other end is closed; or, without ``wait``, it does not read.
    """
    packet = json.dumps(message).encode()
    if len(packet) > MAX_PACKET_SIZE:
        raise BackendError(
            f"a request of {len(packet)} bytes is too long: {MAX_PACKET_SIZE} is the most"
        )
    end.send(packet, 0 if wait else socket.MSG_DONTWAIT)


def receive(end: socket.socket) -> dict[str, Any] | None:
    """Return the next message; None once the other end is closed."""
    packet = end.recv(MAX_PACKET_SIZE)
    if not packet:
        return None
    message: dict[str, Any] = json.loads(packet)
    return message


REPLY_TIMEOUT = 2.0
"""[s] for an answer, which takes a millisecond; a process that was stopped gives none."""


class Line:
    """One end. What the other asks is done on a thread of its own.

    Args:
        end: Of the pair.
        other: Who is at the other end, for messages.
        handle_request: Answers requests of the other: ``handle_request(what, **arguments)``; its PepperError goes back.
        on_end: Called once the other end is closed.
    """

    def __init__(
        self,
        end: socket.socket,
        other: str,
        handle_request: Callable[..., None],
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        self._end, self._other = end, other
        self._handle_request, self._on_end = handle_request, on_end
        self._lock = Lock()
        self._numbers = count()
        self._answers: SimpleQueue[dict[str, Any]] = SimpleQueue()
        end.settimeout(None)
        Thread(target=self._listen, name=f"line to {other}", daemon=True).start()

    def ask(self, what: str, **arguments: object) -> None:
        """Ask the other end, and wait until it is done.

        Raises:
            BackendError: It refuses, for the reason given, or does not answer.
        """
        with self._lock:
            number = next(self._numbers)
            try:
                send(self._end, {"number": number, "ask": what, "arguments": arguments}, wait=False)
                answer = self._answers.get(timeout=REPLY_TIMEOUT)
                while answer["number"] != number:
                    answer = self._answers.get(timeout=REPLY_TIMEOUT)  # to one that was given up
            except (OSError, Empty):
                raise BackendError(f"the stand-in's {self._other} does not answer") from None
        if "error" in answer:
            raise BackendError(str(answer["error"]))

    def _listen(self) -> None:
        try:
            while (message := receive(self._end)) is not None:
                if "ask" not in message:
                    self._answers.put(message)
                    continue
                answer = {"number": message["number"]}
                try:
                    self._handle_request(message["ask"], **message["arguments"])
                except PepperError as error:
                    answer["error"] = str(error)
                # Two ends that both wait until the other one reads would hang.
                send(self._end, answer, wait=False)
        except OSError:
            pass  # closed in the middle of it
        self._on_end()


START_TIME = 30.0
"""[s] for a process to start; it takes about one."""


def spawn(
    module: str,
    arguments: Mapping[str, Any],
    descriptors: Mapping[str, int],
    first: Mapping[str, Any] | None = None,
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Return a process of this package, and the connection on which it reports that it is ready and sees our end.

    Args:
        module: Its name in this package.
        arguments: For its command line, which everybody on this machine can read.
        descriptors: Of open files, which are arguments too.
        first: A message that it finds on its line.
    """
    mine, its = make_pair()
    if first is not None:
        # Not on the command line: it may hold the token of a login.
        send(mine, dict(first))
    descriptors = {**descriptors, "owner": its.fileno()}
    words = [f"--{name}={value}" for name, value in {**arguments, **descriptors}.items()]
    with its:
        # A process group of its own: Ctrl-C is for us alone.
        process = subprocess.Popen(
            [sys.executable, "-m", f"pepper_driver.backends.naoqi_server.{module}", *words],
            pass_fds=tuple(descriptors.values()),
            stdin=subprocess.DEVNULL,
            process_group=0,
        )
    return process, mine


def wait_until_ready(process: subprocess.Popen[bytes], line: socket.socket) -> dict[str, Any]:
    """Wait for a process, and return its first message.

    Raises:
        BackendError: It refuses, for the reason given, or ended.
    """
    line.settimeout(START_TIME)
    try:
        answer = receive(line)
    except TimeoutError:
        answer = {"error": f"a process did not start within {START_TIME:.0f} s"}
    if answer is None or "error" in answer:
        process.kill()
        process.wait()
        line.close()
        reason = "a process ended while it started" if answer is None else answer["error"]
        raise BackendError(f"stand-in: {reason}")
    return dict(answer["ready"])


class Robot(Protocol):
    """The robot, seen from another process. Safe to use from several threads."""

    @property
    def keys(self) -> Mapping[str, int]:
        """Full key of each value ("Device/SubDeviceList/HeadYaw/Position/Sensor/Value", "DCM/Time"), to its place."""

    @property
    def actuators(self) -> frozenset[str]:
        """Keys that :meth:`order` takes."""

    @property
    def info(self) -> Mapping[str, Any]:
        """Description of the robot: ``identity``, ``plant``, ``links``, ``posture``, ..."""

    def values(self) -> list[float]:
        """Newest values of all keys, of one cycle, in the order of ``keys``."""

    def value(self, key: str) -> float:
        """Newest value of one key."""

    def time(self) -> int:
        """Return the DCM's time now [ms], 32 bits with a sign."""

    def order(
        self,
        actuators: Sequence[str],
        update: UpdateType,
        commands: Sequence[Sequence[TimedCommand]],
    ) -> None:
        """Give the DCM timed commands (value, DCM time), a sequence for each actuator; accepted when this returns.

        Raises:
            BackendError: A buffer is full, or the robot does not answer.
        """

    def push(self, **arguments: object) -> None:
        """Push a link; arguments of :meth:`Backend.push`.

        Raises:
            BackendError: Not possible, for the reason given.
        """

    def grab(self, **arguments: object) -> None:
        """Take a link in a springy hand; arguments of :meth:`Backend.grab`.

        Raises:
            BackendError: Not possible, for the reason given.
        """

    def set_fault(self, name: str, **arguments: object) -> None:
        """Inject a fault of the robot, or change it.

        Raises:
            BackendError: No such fault, or its arguments make no sense.
        """

    def clear_faults(self) -> None:
        """End all faults that can end."""

    def black_box(self, last: int | None = None) -> BlackBox:
        """Return the truth of the last cycles; all that are kept, or so many."""


_MAX_COMMANDS = MAX_PACKET_SIZE // 64
"""In one packet; a longer order is given in parts."""


class RobotClient:
    """A :class:`~.robot.Robot` over a table and a socket."""

    def __init__(
        self,
        table: Table,
        end: socket.socket,
        keys: Mapping[str, int],
        actuators: frozenset[str],
        *,
        reply_time: float = REPLY_TIMEOUT,
    ) -> None:
        self._table, self._end = table, end
        self._keys, self._actuators = keys, actuators
        self._lock = Lock()
        self._numbers = count(time.monotonic_ns())  # no other process had them
        end.settimeout(reply_time)

    @property
    def keys(self) -> Mapping[str, int]:
        """Full key of each value, to its place."""
        return self._keys

    @property
    def actuators(self) -> frozenset[str]:
        """Keys that :meth:`order` takes."""
        return self._actuators

    @property
    def info(self) -> dict[str, Any]:
        """Description of the robot."""
        return self._table.info

    def values(self) -> list[float]:
        """Newest values of all keys, of one cycle."""
        values: list[float] = self._table.read().tolist()
        return values

    def value(self, key: str) -> float:
        """Newest value of one key."""
        return float(self._table.read()[self._keys[key]])

    def time(self) -> int:
        """Return the DCM's time now [ms], 32 bits with a sign."""
        return self._table.clock.shown

    def order(
        self,
        actuators: Sequence[str],
        update: UpdateType,
        commands: Sequence[Sequence[TimedCommand]],
    ) -> None:
        """Give the DCM timed commands; see :meth:`Robot.order`."""
        parts: list[tuple[list[str], list[Sequence[TimedCommand]]]] = [([], [])]
        size = 0
        for actuator, its in zip(actuators, commands, strict=True):
            if size + len(its) > _MAX_COMMANDS and parts[-1][0]:
                parts.append(([], []))
                size = 0
            parts[-1][0].append(actuator)
            parts[-1][1].append(its)
            size += len(its)
        for keys, lists in parts:
            self.ask("order", actuators=keys, update=update, commands=lists)

    def push(self, **arguments: object) -> None:
        """Push a link; see :meth:`Robot.push`."""
        self.ask("push", **arguments)

    def grab(self, **arguments: object) -> None:
        """Take a link in a springy hand; see :meth:`Robot.grab`."""
        self.ask("grab", **arguments)

    def set_fault(self, name: str, **arguments: object) -> None:
        """Inject a fault of the robot; see :meth:`Robot.set_fault`."""
        self.ask("set_fault", name=name, arguments=arguments)

    def clear_faults(self) -> None:
        """End all faults that can end."""
        self.ask("clear_faults")

    def black_box(self, last: int | None = None) -> BlackBox:
        """Return the truth of the last cycles."""
        return self._table.black_box(last)

    def look(self) -> TrueScene:
        """Return the truth of the newest cycle."""
        return TrueScene.from_message(self.ask("look"))

    def take_hand(
        self, link: str, point: ArrayLike | None, *, stiffness: float, max_force: float
    ) -> RemoteHand:
        """Take a link in a hand that is moved later; see :meth:`Backend.take_hand`."""
        place = None if point is None else np.asarray(point, dtype=np.float64).tolist()
        number: int = self.ask(
            "take_hand", link=link, point=place, stiffness=stiffness, max_force=max_force
        )
        return RemoteHand(self.ask, number)

    def ask(self, what: str, **arguments: object) -> Any:  # noqa: ANN401 whatever JSON has
        """Send one request, wait until the robot process took it, and return what it answers.

        Raises:
            BackendError: It refuses, for the reason given, or does not answer.
        """
        with self._lock:
            number = next(self._numbers)
            try:
                send(self._end, {"number": number, "ask": what, "arguments": arguments})
                answer = receive(self._end)
                while answer is not None and answer["number"] != number:
                    answer = receive(self._end)  # to a request of a process that died meanwhile
            except OSError as error:
                reason = "does not answer" if isinstance(error, TimeoutError) else "has ended"
                raise BackendError(f"the stand-in's robot process {reason}") from error
        if answer is None:
            raise BackendError("the stand-in's robot process has ended")
        if "error" in answer:
            raise BackendError(str(answer["error"]))
        return answer.get("result")
