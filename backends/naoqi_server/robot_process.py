"""The robot process: DCM and simulated Pepper in real time, whatever happens to those who give it orders.

Started by ``launch.StandIn``. It ends when told to, and when whoever started it is gone.
"""

from __future__ import annotations

import argparse
import gc
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from pepper_driver.backends.mujoco_.backend import MujocoBackend
from pepper_driver.backends.naoqi_server.body import Body
from pepper_driver.backends.naoqi_server.clock import DcmClock, wrapped
from pepper_driver.backends.naoqi_server.dcm import UPDATE_TYPES, Dcm
from pepper_driver.backends.naoqi_server.messages import receive, send
from pepper_driver.backends.naoqi_server.robot_faults import RobotFaults
from pepper_driver.backends.naoqi_server.table import Table
from pepper_driver.backends.selection import make_backend
from pepper_driver.config import PepperError, load_robot
from pepper_driver.config.naoqi_devices import load_naoqi_devices

BEHIND = 25
"""[cycles] by which the process may be late and catch up. Beyond that it leaves cycles out."""


class RobotProcess:
    """The loop.

    Args:
        uri: Of the MuJoCo backend.
        file: Descriptor of the table's file.
        clock: DCM time at the start [ms].
    """

    def __init__(self, uri: str, file: int, clock: int) -> None:
        robot = load_robot()
        devices = load_naoqi_devices(robot)
        backend = make_backend(uri, robot)
        assert isinstance(backend, MujocoBackend)  # StandIn refuses others
        self._body = Body(robot, devices, backend, clock)
        self._cycle_ms = round(1000 * robot.cycle)
        self._clock = DcmClock(begin=time.monotonic_ns(), origin=clock)
        self._dcm = Dcm(self._body.actuator_values, clock, steps=devices.steps)
        self._faults = RobotFaults(robot, self._body.keys)
        self._table = Table(file, len(self._body.keys), robot)
        self._table.start(self._clock, {**self._body.info, "pid": os.getpid()})
        self._cycle = self._orders = self._wheel_order = 0
        self._wheels = {
            robot.naoqi.prefix + robot.naoqi.wheel_speed_command.format(wheel=wheel)
            for wheel in robot.wheels.names
        }
        self._naoqi: int | None = None
        self._handlers: Mapping[str, Callable[..., None]] = {
            "order": self._order,
            "know_naoqi": self._know_naoqi,
            "push": lambda **arguments: backend.push(**_arrays(arguments, "force", "point")),
            "grab": lambda **arguments: backend.grab(**_arrays(arguments, "pull", "point")),
            "set_fault": lambda name, arguments: self._faults.set(name, arguments),
            "clear_faults": self._faults.clear,
        }
        self._publish(time.monotonic_ns())

    def run(self, ends: list[socket.socket], outlive: float) -> None:
        """Make cycles until the first of ``ends``, that of whoever started this, is closed for ``outlive`` [s]."""
        owner, last = ends[0], None
        period = self._cycle_ms * 1_000_000
        while last is None or time.monotonic_ns() < last:
            due = self._clock.begin + (self._cycle + 1) * period
            waiting = True
            while waiting:  # at least one look at the requests in every cycle
                wait = max(0, due - time.monotonic_ns())
                for end in select.select(ends, [], [], wait * 1e-9)[0]:
                    if not self._answer(end):
                        ends.remove(end)
                        if end is owner:
                            last = time.monotonic_ns() + round(1e9 * outlive)
                waiting = time.monotonic_ns() < due
            self._cycle += 1
            late = (time.monotonic_ns() - due) // period
            if late > BEHIND:
                self._cycle, due = self._cycle + late, due + late * period
            self._step(due)

    def _step(self, due: int) -> None:
        count = self._clock.origin + self._cycle * self._cycle_ms
        actuators = self._dcm.advance(count)
        self._faults.actuators(actuators)
        self._body.cycle(actuators, wrapped(count))
        self._publish(due)

    def _publish(self, due: int) -> None:
        body = self._body
        values = body.values.copy()
        self._faults.sensors(values)
        self._table.publish(values)
        date = wrapped(self._clock.origin + self._cycle * self._cycle_ms)
        end = time.monotonic_ns()
        state = (*body.true_state(), *body.commanded())
        orders = self._orders, self._wheel_order
        self._table.record((self._cycle, date, due, end, *orders, *state))

    def _answer(self, end: socket.socket) -> bool:
        """Do what one message asks for; False once nobody is left at the other end."""
        try:
            message = receive(end)
        except ConnectionError:
            return False
        if message is None:
            return False
        answer: dict[str, Any] = {"number": message["number"]}
        try:
            self._handlers[message["ask"]](**message["arguments"])
        except PepperError as error:
            answer["error"] = str(error)
        except Exception as error:  # whatever was asked for, a robot goes on
            answer["error"] = f"{message['ask']}: {type(error).__name__}: {error}"
        with suppress(OSError):  # whoever asked is gone, or does not read
            send(end, answer, wait=False)
        return True

    def _know_naoqi(self, pid: int) -> None:
        """Who is to end with this process: a NAOqi process that was stopped does not see that its owner is gone."""
        self._naoqi = os.pidfd_open(pid)

    def end(self) -> None:
        """End the NAOqi process, if it is still there."""
        if self._naoqi is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._naoqi, signal.SIGKILL)

    def _order(
        self, actuators: list[str], update: str, commands: list[list[tuple[float, int]]]
    ) -> None:
        kind = next(known for known in UPDATE_TYPES if known == update)
        self._dcm.order(actuators, kind, commands, self._clock.count)
        self._orders += 1
        if not self._wheels.isdisjoint(actuators):
            self._wheel_order = time.monotonic_ns()


def _arrays(arguments: dict[str, Any], *names: str) -> dict[str, Any]:
    """Lists into arrays."""
    return {
        name: np.array(value, dtype=np.float64) if name in names and value is not None else value
        for name, value in arguments.items()
    }


def main(arguments: list[str]) -> int:
    """Entry of the process; says in one message to whoever started it that the robot runs, or why not."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--uri", required=True)
    parser.add_argument("--clock", type=int, required=True)
    parser.add_argument("--outlive", type=float, required=True)
    for name in ("--table", "--owner", "--naoqi"):
        parser.add_argument(name, type=int, required=True, metavar="DESCRIPTOR")
    given = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for whoever started this; it then ends us
    owner, naoqi = socket.socket(fileno=given.owner), socket.socket(fileno=given.naoqi)
    with suppress(PermissionError, AttributeError):  # a robot does not wait for other programs
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
    try:
        process = RobotProcess(given.uri, given.table, given.clock)
    except PepperError as error:
        send(owner, {"error": str(error)})
        return 1
    gc.collect()
    gc.freeze()
    gc.disable()
    send(owner, {"ready": {"pid": os.getpid()}})
    try:
        process.run([owner, naoqi], given.outlive)
    except PepperError as error:
        print(f"stand-in robot: {error}", file=sys.stderr)
        return 1
    process.end()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
