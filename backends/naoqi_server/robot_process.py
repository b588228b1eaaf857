"""Process of the simulated robot: one cycle every 12 ms, its hardware by keys of the DCM.

Started by ``launch.StandIn``. It ends on request, and when its parent process has ended.
"""

from __future__ import annotations

import argparse
import gc
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.backends.mujoco_.backend import MujocoBackend
from pepper_driver.backends.naoqi_server.dcm import UPDATE_TYPES, Dcm, DcmClock, wrapped
from pepper_driver.backends.naoqi_server.hands import HeldHands, TrueScene
from pepper_driver.backends.naoqi_server.ipc import receive, send
from pepper_driver.backends.naoqi_server.robot_faults import RobotFaults
from pepper_driver.backends.naoqi_server.shared_values import Table, table_keys
from pepper_driver.backends.selection import make_backend
from pepper_driver.config import PepperError, RobotConfig, load_robot
from pepper_driver.config.arrays import FloatArray, IndexArray
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock
from pepper_driver.config.naoqi_devices import NaoqiDevices, load_naoqi_devices

HOT, VERY_HOT = 68.0, 74.0
"""[deg C] Where ``Temperature/Sensor/Status`` becomes 1 and 2: levels of public ROS drivers of Pepper."""


class DcmHardware:
    """A simulated Pepper behind the DCM.

    Attributes:
        backend: The simulation.
        keys: Key of each value of the table, to its place.
        values: Their newest values, sensors and what was sent to the actuators.
        sent: The command of the last cycle, as the boards took it.
        measurement: The sample of the last cycle.

    ``date`` is that of the start, as the robot's clock shows it.
    """

    def __init__(
        self, robot: RobotConfig, devices: NaoqiDevices, backend: MujocoBackend, date: int
    ) -> None:
        self.backend = backend
        self.keys = table_keys(robot, devices)
        self.values = np.array([devices.values.get(key, 0.0) for key in self.keys])
        self._robot = robot
        self._actuators = len(devices.actuators)
        names, joints, wheels = robot.naoqi, robot.joint_names, robot.wheels.names
        place = self._places
        self._position_command = place(names.position_command, joint=joints)
        self._stiffness_command = place(names.stiffness_command, joint=joints)
        self._wheel_command = place(names.wheel_speed_command, wheel=wheels)
        self._wheel_stiffness = place(names.wheel_stiffness_command, wheel=wheels)
        self._temperature_status = place("{joint}/Temperature/Sensor/Status", joint=joints)
        self._sensors: Mapping[str, IndexArray] = {
            "position": place(names.position, joint=joints),
            "current": place(names.current, joint=joints),
            "temperature": place(names.temperature, joint=joints),
            "wheel_speed": place(names.wheel_speed, wheel=wheels),
            "touch": place(names.touch, touch=tuple(robot.sensors.touch)),
            "bumpers": place(names.bumper, bumper=tuple(robot.sensors.bumpers)),
            "buttons": place(names.button, button=tuple(robot.sensors.buttons)),
        }
        self._imu = place("{imu}", imu=(*names.accelerometer, *names.gyroscope, *names.attitude))
        self._battery = self.keys[names.prefix + names.battery_charge]
        self._date = self.keys[names.time]
        self.values[self._date] = date
        self._mirrored = [
            (self.keys[key], self.keys[sensor])
            for key in devices.actuators
            if (sensor := key.replace("/OperationMode/Actuator/", "/OperationMode/Sensor/")) != key
        ]
        self.measurement = backend.open()
        backend.switch_on()
        start = np.clip(self.measurement.position, robot.lower, robot.upper)
        self.values[self._position_command] = start
        self.sent = self._command()
        self._take(self.measurement)

    @property
    def actuator_values(self) -> dict[str, float]:
        """Last values of the actuators, in the order of the DCM."""
        return dict(zip(self.keys, self.values[: self._actuators].tolist(), strict=False))

    def cycle(self, actuators: list[float], date: int) -> None:
        """One cycle of 12 ms, towards what the DCM sends.

        Args:
            actuators: Their values, in the order of the DCM.
            date: Of this cycle, as the robot's clock shows it.

        Raises:
            BackendError: The simulation diverged.
        """
        self.values[: self._actuators] = actuators
        self.sent = self._command()
        self.backend.wheel_stiffness = np.clip(self.values[self._wheel_stiffness], 0.0, 1.0)
        self.backend.write(self.sent)
        self.measurement = self.backend.read()
        self._take(self.measurement)
        self.values[self._date] = date

    def _command(self) -> Command:
        """Return the command of the boards: targets of joints stay within the joints' ranges."""
        robot, values = self._robot, self.values
        limit = robot.wheels.speed_limit
        return Command(
            position=np.clip(values[self._position_command], robot.lower, robot.upper),
            stiffness=np.clip(values[self._stiffness_command], 0.0, 1.0),
            wheel_speed=np.clip(values[self._wheel_command], -limit, limit),
        )

    def _take(self, measurement: Measurement) -> None:
        values = self.values
        for name, places in self._sensors.items():
            values[places] = getattr(measurement, name)
        imu = measurement.imu
        values[self._imu] = np.concatenate([imu.acceleration, imu.angular_velocity, imu.attitude])
        values[self._battery] = measurement.battery
        heat = measurement.temperature
        values[self._temperature_status] = np.where(heat >= VERY_HOT, 2.0, heat >= HOT)
        for actuator, sensor in self._mirrored:
            values[sensor] = values[actuator]

    @property
    def info(self) -> dict[str, Any]:
        """Description of the robot, for the other processes."""
        info, plant = self.backend.info, self.backend.plant.config
        assert plant is not None  # of MuJoCo
        return {
            "identity": info.identity,
            "parents": [[parent.name, parent.identity] for parent in info.parents],
            "uri": self.backend.uri,
            "plant": plant.name,
            "rolling": plant.base == "rolling",
            "response_delay": info.response_delay,
            "cycle_ms": round(1000 * info.cycle),
        }

    def true_state(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(17,) joints [rad], (3,) wheel speeds [rad/s] and (3,) base (x, y [m], yaw [rad]), as they really are."""
        truth = self.backend.truth
        return truth.position, self.measurement.wheel_speed, truth.base

    def commanded(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the DCM's commands: positions (17,), hardness (17,), wheel speeds (3,), wheel stiffness (3,)."""
        values = self.values
        return (
            values[self._position_command],
            values[self._stiffness_command],
            values[self._wheel_command],
            values[self._wheel_stiffness],
        )

    def _places(self, pattern: str, **names: tuple[str, ...]) -> IndexArray:
        ((slot, choices),) = names.items()
        prefix = self._robot.naoqi.prefix
        return np.array([self.keys[prefix + pattern.format(**{slot: n})] for n in choices])


MAX_LAG = 25
"""[cycles] by which the process may be late and catch up. Beyond that it leaves cycles out."""


class RobotProcess:
    """The loop.

    Args:
        uri: Of the MuJoCo backend.
        file: Descriptor of the table's file.
        date: DCM time at the start [ms].
        clock: Time of its cycles.
    """

    def __init__(self, uri: str, file: int, date: int, clock: Clock = MONOTONIC_CLOCK) -> None:
        robot = load_robot()
        devices = load_naoqi_devices(robot)
        backend = make_backend(uri, robot)
        assert isinstance(backend, MujocoBackend)  # StandIn refuses others
        self._now = clock.now
        self._body = DcmHardware(robot, devices, backend, date)
        self._cycle_ms = round(1000 * robot.cycle)
        self._clock = DcmClock(begin=clock.now(), origin=date, now=clock.now)
        self._dcm = Dcm(self._body.actuator_values, date, steps=devices.steps)
        self._faults = RobotFaults(robot, self._body.keys, clock)
        self._table = Table(file, len(self._body.keys), robot)
        self._table.start(self._clock, {**self._body.info, "pid": os.getpid()})
        self._cycle = self._orders = self._wheel_order = 0
        self._wheels = {
            robot.naoqi.prefix + robot.naoqi.wheel_speed_command.format(wheel=wheel)
            for wheel in robot.wheels.names
        }
        self._naoqi: int | None = None
        hands = HeldHands(backend)
        self._handlers: Mapping[str, Callable[..., object]] = {
            "order": self._order,
            "know_naoqi": self._know_naoqi,
            "push": lambda **arguments: backend.push(**_arrays(arguments, "force", "point")),
            "grab": lambda **arguments: backend.grab(**_arrays(arguments, "pull", "point")),
            "look": lambda: TrueScene.message(backend),
            "take_hand": lambda **arguments: hands.take(**_arrays(arguments, "point")),
            "move_hand": hands.move,
            "release_hand": hands.release,
            "look_at_hand": hands.look,
            "set_fault": lambda name, arguments: self._faults.set(name, arguments),
            "clear_faults": self._faults.clear,
        }
        self._publish(clock.now())

    def run(self, ends: list[socket.socket], outlive: float) -> None:
        """Make cycles until the first of ``ends``, that of the parent process, is closed for ``outlive`` [s]."""
        owner, last = ends[0], None
        period = self._cycle_ms * 1_000_000
        while last is None or self._now() < last:
            due = self._clock.begin + (self._cycle + 1) * period
            waiting = True
            while waiting:  # requests are read at least once in every cycle
                wait = max(0, due - self._now())
                for end in select.select(ends, [], [], wait * 1e-9)[0]:
                    if not self._answer(end):
                        ends.remove(end)
                        if end is owner:
                            last = self._now() + round(1e9 * outlive)
                waiting = self._now() < due
            late = (self._now() - due) // period
            if late > MAX_LAG:
                self._cycle, due = self._cycle + late, due + late * period
            self.step(due)

    def step(self, due: int) -> None:
        """Make the cycle that was due at a time of the clock [ns]."""
        self._cycle += 1
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
        end = self._now()
        state = (*body.true_state(), *body.commanded())
        orders = self._orders, self._wheel_order
        self._table.record((self._cycle, date, due, end, *orders, *state))

    def _answer(self, end: socket.socket) -> bool:
        """Execute the request of one message; return False once the other end is closed."""
        try:
            message = receive(end)
        except ConnectionError:
            return False
        if message is None:
            return False
        answer: dict[str, Any] = {"number": message["number"]}
        try:
            answer["result"] = self.handle(message["ask"], **message["arguments"])
        except PepperError as error:
            answer["error"] = str(error)
        except Exception as error:  # a failed request must not stop the robot
            answer["error"] = f"{message['ask']}: {type(error).__name__}: {error}"
        with suppress(OSError):  # the client has ended, or does not read
            send(end, answer, wait=False)
        return True

    def handle(self, request: str, **arguments: object) -> object:
        """Execute a request; return what JSON can hold.

        Raises:
            PepperError: It is refused, for the reason given.
        """
        return self._handlers[request](**arguments)

    def _know_naoqi(self, pid: int) -> None:
        """Remember the NAOqi process, which ends with this one: a stopped one does not see that its owner has ended."""
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
            self._wheel_order = self._now()


def _arrays(arguments: dict[str, Any], *names: str) -> dict[str, Any]:
    """Convert lists into arrays."""
    return {
        name: np.array(value, dtype=np.float64) if name in names and value is not None else value
        for name, value in arguments.items()
    }


def main(arguments: list[str]) -> int:
    """Entry of the process; reports in one message to its parent that the robot runs, or why not."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--uri", required=True)
    parser.add_argument("--clock", type=int, required=True)
    parser.add_argument("--outlive", type=float, required=True)
    for name in ("--table", "--owner", "--naoqi"):
        parser.add_argument(name, type=int, required=True, metavar="DESCRIPTOR")
    given = parser.parse_args(arguments)
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # handled by the parent process, which then ends us
    owner, naoqi = socket.socket(fileno=given.owner), socket.socket(fileno=given.naoqi)
    with suppress(PermissionError, AttributeError):  # a robot does not wait for other programs
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))
    try:
        process = RobotProcess(given.uri, given.table, given.clock)
    except PepperError as error:
        send(owner, {"error": str(error)})
        return 1
    # A full collection takes longer than a cycle may.
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
