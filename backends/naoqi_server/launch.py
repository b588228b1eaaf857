"""Starts and ends a stand-in: two processes, one robot."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from types import TracebackType
from typing import Any, Self

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.black_box import BlackBox
from pepper_driver.backends.naoqi_server.clock import wrapped
from pepper_driver.backends.naoqi_server.keys import table_keys
from pepper_driver.backends.naoqi_server.link import RobotLink
from pepper_driver.backends.naoqi_server.messages import make_pair, receive
from pepper_driver.backends.naoqi_server.table import Table
from pepper_driver.config import MissingExtraError, load_robot
from pepper_driver.config.naoqi_devices import load_naoqi_devices

START_TIME = 30.0
"""[s] for a process to start; it takes about one."""


class StandIn:
    """A stand-in NAOqi with its robot. Use it as a context manager.

    The robot stands in its posture with stiffness 0. Both processes end with the block, and with this process.

    Args:
        uri: The simulated robot, as for ``make_backend``: ``mujoco://?plant=worn&seed=3&world=table&posture=Crouch``.
        host: Address to listen at.
        port: And the port; 0 for a free one.
        clock: DCM time at the start [ms]; by default that of the day, as a robot has it.
        outlive: How long the robot goes on when this process is killed [s].
    """

    def __init__(
        self,
        uri: str = "mujoco",
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        clock: int | None = None,
        outlive: float = 1.0,
    ) -> None:
        self._uri, self._host, self._port = uri, host, port
        self._clock, self._outlive = clock, outlive
        self._robot: subprocess.Popen[bytes] | None = None
        self._naoqi: subprocess.Popen[bytes] | None = None
        self._open = ExitStack()

    def start(self) -> Self:
        """Start the robot, then NAOqi.

        Raises:
            BackendError: One of them refuses, for the reason given.
        """
        if find_spec("qi") is None:
            raise MissingExtraError(
                "a stand-in NAOqi (Linux on x86-64, Python up to 3.12)", "naoqi"
            )
        clock = wrapped(int(1000 * time.time()) if self._clock is None else self._clock)
        config = load_robot()
        devices = load_naoqi_devices(config)
        keys = table_keys(config, devices)
        self._file = Table.make_file()
        self._open.callback(os.close, self._file)
        # NAOqi's end of its line to the robot stays open here, for a NAOqi that is started anew.
        self._line, robots = make_pair()
        self._open.enter_context(self._line)
        try:
            with robots:
                self._robot, owner = self._spawn(
                    "robot_process",
                    {"uri": self._uri, "clock": clock, "outlive": self._outlive},
                    {"table": self._file, "naoqi": robots.fileno()},
                )
            self._naoqi, naoqi = self._spawn_naoqi()  # at the same time: both take a while
            _wait_for(owner)
            self._port = int(_wait_for(naoqi)["port"])
            table = Table(self._file, len(keys), config)
            self.robot = RobotLink(table, owner, keys, frozenset(devices.actuators))
        except BaseException:
            self.stop()
            raise
        return self

    def start_naoqi(self) -> None:
        """Start the NAOqi process anew after it died, at the same port.

        Raises:
            BackendError: It cannot start, for example because the port is in use by now.
        """
        self._naoqi, naoqi = self._spawn_naoqi()
        _wait_for(naoqi)

    @property
    def port(self) -> int:
        """Where NAOqi listens."""
        return self._port

    @property
    def url(self) -> str:
        """The same, as ``qi.Session.connect`` takes it."""
        return f"tcp://{self._host}:{self._port}"

    @property
    def robot_process(self) -> subprocess.Popen[bytes]:
        """The robot process."""
        assert self._robot is not None, "not started"
        return self._robot

    @property
    def naoqi_process(self) -> subprocess.Popen[bytes]:
        """The NAOqi process. What happens to it does not touch the robot: kill, stop or continue it by its ``pid``."""
        assert self._naoqi is not None, "not started"
        return self._naoqi

    def black_box(self, last: int | None = None) -> BlackBox:
        """What the robot really did in the last two minutes, or ``last`` cycles; also after its process ended."""
        return self.robot.black_box(last)

    def wait(self) -> str:
        """Wait until NAOqi ends by itself, or is ended by others; returns how it ended.

        Raises:
            BackendError: The robot ended.
        """
        while True:
            if (code := self.robot_process.poll()) is not None:
                raise BackendError(f"the stand-in's robot process ended {_how(code)}")
            if (code := self.naoqi_process.poll()) is not None:
                return _how(code)
            time.sleep(0.1)

    def stop(self) -> None:
        """End both processes. Does nothing when they have ended."""
        for process in (self._naoqi, self._robot):
            if process is not None:
                with suppress(ProcessLookupError):
                    process.kill()  # a process that was stopped takes nothing else
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

    def _spawn_naoqi(self) -> tuple[subprocess.Popen[bytes], socket.socket]:
        return self._spawn(
            "server",
            {"host": self._host, "port": self._port},
            {"table": self._file, "robot": self._line.fileno()},
        )

    def _spawn(
        self, module: str, arguments: dict[str, Any], descriptors: dict[str, int]
    ) -> tuple[subprocess.Popen[bytes], socket.socket]:
        """A process of this package, and the line on which it says it is ready and hears that we are gone."""
        mine, its = make_pair()
        self._open.enter_context(mine)
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


def _wait_for(line: socket.socket) -> dict[str, Any]:
    """What a process says when it is ready.

    Raises:
        BackendError: It refuses, for the reason given.
    """
    line.settimeout(START_TIME)
    try:
        answer = receive(line)
    except TimeoutError:
        answer = {"error": f"a process did not start within {START_TIME:.0f} s"}
    if answer is None:
        answer = {"error": "a process ended while it started"}
    if "error" in answer:
        raise BackendError(f"stand-in: {answer['error']}")
    return dict(answer["ready"])


def _how(code: int) -> str:
    return f"by signal {-code}" if code < 0 else f"with code {code}"
