"""A recording as a robot: ``replay://FILE``, and the differences between its commands and those it gets."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pepper_driver.backends.fields import (
    Column,
    Command,
    Imu,
    Measurement,
    fields_of,
    objects,
)
from pepper_driver.backends.interface import (
    MAX_RESPONSE_DELAY,
    Backend,
    BackendError,
    BackendInfo,
    NotConnectedError,
    Serial,
    checked_command,
    serial,
)
from pepper_driver.backends.log_file import (
    TICK_TOPIC,
    UNMATCHED_TOPIC,
    LogError,
    RawLog,
    misfit,
    read_log_file,
)
from pepper_driver.backends.selection import BackendUri
from pepper_driver.config import ConfigError, RobotConfig, RobotIdentity
from pepper_driver.config.arrays import IntArray


class CommandDifferences:
    """Differences between the commands of a program and those of a recording, bit by bit.

    Args:
        robot: Names joints and wheels.

    Attributes:
        compared: How many commands were compared.
        differing: How many of them are not the same.
        first: The first one that is not: time of its sample [s], and a human-readable difference; None if all are
            equal.
        largest: Largest size of a difference, by part of the command: ``position`` [rad], ``stiffness``,
            ``wheel_speed`` [rad/s].
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._names = {field.attribute: field.elements(robot) or () for field in fields_of("sent")}
        self.compared = self.differing = 0
        self.first: tuple[float, str] | None = None
        self.largest = dict.fromkeys(self._names, 0.0)

    def compare(self, time: float, given: Command, recorded: Command) -> None:
        """Take in the two commands of one cycle, those that the sample of ``time`` [s] answers."""
        self.compared += 1
        same = True
        for part, names in self._names.items():
            a, b = np.asarray(getattr(given, part)), getattr(recorded, part)
            # Bit by bit: == takes 0.0 and -0.0 for equal, and NaN for different.
            if a.tobytes() == b.tobytes():
                continue
            size = np.abs(a - b)
            place = int(size.argmax())
            self.largest[part] = max(self.largest[part], float(size[place]))
            if self.first is None:
                text = f"{part} of {names[place]}: {a[place]!s} in place of {b[place]!s}"
                self.first = (time, text)
            same = False
        self.differing += not same


class EndOfLogError(BackendError, EOFError):
    """The recording is over: it cannot say what the robot would have measured next."""


class ReplayBackend(Serial, Backend):
    """Steps through a log. Nothing moves: commands are compared with those recorded.

    The first command that the recording answers is the posture that the robot held: this is what ``open`` measures, so
    that a program that does the same as then sends the same.

    Args:
        robot: Its description.
        file: The log.
        uri: How it was asked for.

    Attributes:
        commands: (n) what was sent then, as the ticks answer it.
        steps: (n,) number of each tick of the recording; one that is left out did not get into the log.
        answered: (n,) step in which the command was given that a tick answers; -1 where it is before the first, or too
            old to be known.
        differences: Of the commands given since ``open``.

    Raises:
        LogError: It has no tick, is of another robot, or does not say of which backend it is.
    """

    def __init__(self, robot: RobotConfig, file: RawLog, uri: str) -> None:
        super().__init__()
        if file.joint_names != robot.joint_names:
            raise LogError(
                f"{file.path}: is of a robot with other joints, or another order of them, than '{robot.name}'"
            )
        self._robot = robot
        self._uri, self._info = uri, _info(file)
        try:
            self._measurements = _measurements(file, robot)
            self.commands = _commands(file, TICK_TOPIC)
            table = file.tables[TICK_TOPIC]
            self.steps = table["step"]
            self.answered = _match_command(table, self._info.response_delay)
            self._given = self._commands_by_step(file)
        except KeyError as error:
            raise misfit(file.path, error) from error
        self._state = "closed"
        self._next = 0
        self.differences = CommandDifferences(robot)

    @property
    def uri(self) -> str:
        """The URI it was asked for."""
        return self._uri

    @property
    def info(self) -> BackendInfo:
        """As recorded; time passes with each ``read``."""
        return self._info

    @property
    def measurements(self) -> tuple[Measurement, ...]:
        """All that was measured, one a tick."""
        return self._measurements

    @serial
    def open(self) -> Measurement:
        """Begin again. The robot is at its commanded position, a cycle before the first tick."""
        if self._state != "closed":
            raise BackendError(f"'{self.uri}' is already open")
        self._state, self._next = "open", 0
        self.differences = CommandDifferences(self._robot)
        return self._before_the_first()

    @serial
    def activate(self) -> Measurement:
        """Compare commands from now on."""
        self._check_open()
        if self._state == "active":
            raise BackendError(f"'{self.uri}' is already active")
        self._state = "active"
        return self._measurements[self._next - 1] if self._next else self._before_the_first()

    @serial
    def read(self) -> Measurement:
        """Return the next measurement.

        Raises:
            EndOfLogError: The log has no further tick.
        """
        self._check_open()
        row = self._next
        if row == len(self._measurements):
            raise EndOfLogError(f"'{self.uri}': the recording is over after {row} ticks")
        self._next += 1
        return self._measurements[row]

    @serial
    def write(self, command: Command) -> None:
        """Compare a command with the one recorded for the coming tick."""
        self._check_open()
        position, stiffness, wheel_speed = checked_command(command, len(self._robot.joint_names))
        if self._state != "active" or self._next == len(self._measurements):
            return
        recorded = self._given.get(int(self.steps[self._next]))
        if recorded is not None:
            given = Command(position=position, stiffness=stiffness, wheel_speed=wheel_speed)
            self.differences.compare(recorded[0], given, recorded[1])

    @serial
    def deactivate(self) -> None:
        """Compare no more commands."""
        if self._state == "active":
            self._state = "open"

    @serial
    def close(self) -> None:
        """Release it."""
        self._state = "closed"

    def _check_open(self) -> None:
        if self._state == "closed":
            raise NotConnectedError(f"'{self.uri}' is not open")

    def _commands_by_step(self, file: RawLog) -> dict[int, tuple[float, Command]]:
        """Each by the step it was given in, with the time of the first sample that answers it, or a later one."""
        passed_over = file.tables[UNMATCHED_TOPIC]
        rows = zip(
            (*self.answered.tolist(), *passed_over["step"].tolist()),
            (*(m.time for m in self._measurements), *passed_over["time"].tolist()),
            (*self.commands, *_commands(file, UNMATCHED_TOPIC)),
            strict=True,
        )
        given: dict[int, tuple[float, Command]] = {}
        for step, time, command in rows:
            # Several samples may answer one command: the first of them dates it.
            given.setdefault(step, (time, command))
        return given

    def _before_the_first(self) -> Measurement:
        first, sent = self._measurements[0], self.commands[0]
        return replace(
            first,
            time=max(0.0, first.time - self._info.cycle),
            tick=max(0, first.tick - 1),
            position=sent.position,
        )


def from_uri(uri: BackendUri, robot: RobotConfig) -> ReplayBackend:
    """``replay://path/to/run.mcap``, ``replay:///absolute/path/to/run.mcap``."""
    uri.check_keys(set(), host=True, path=True)
    path = uri.host + uri.path
    if not path:
        raise ConfigError(f"backend '{uri.text}': name the log, as in replay://path/to/run.mcap")
    return ReplayBackend(robot, read_log_file(Path(path)), uri.text)


def _info(file: RawLog) -> BackendInfo:
    run = file.metadata
    try:
        cycle, delay, identity = float(run["cycle"]), int(run["response_delay"]), run["identity"]
    except (KeyError, ValueError) as error:
        raise LogError(
            f"{file.path}: does not say of which backend it is (cycle, response_delay, identity)"
        ) from error
    if not (0.0 < cycle < math.inf and delay >= 0):
        raise LogError(f"{file.path}: a cycle of {cycle} s or a delay of {delay} ticks is invalid")
    return BackendInfo(
        joint_names=file.joint_names,
        cycle=cycle,
        response_delay=delay,
        capabilities=frozenset(),
        identity=identity,
        name=run.get("backend", ""),
        parents=parents_in(file.path, run),
    )


def parents_in(path: Path, metadata: Mapping[str, str]) -> tuple[RobotIdentity, ...]:
    """Return the plants of which the robot of a log is a variant.

    Raises:
        LogError: They cannot be read.
    """
    try:
        return tuple(RobotIdentity(**entry) for entry in json.loads(metadata.get("parents", "[]")))
    except (TypeError, ValueError) as error:
        raise LogError(f"{path}: its metadata has no 'parents' that can be read") from error


def _match_command(table: dict[str, Column], delay: int) -> IntArray:
    """Return for each row the step whose command it answers; -1 before the first, or if it is too old to be known."""
    # A log has -1 in place of None (fields.py).
    response_delay = np.where(table["response_delay"] < 0, delay, table["response_delay"])
    step = np.where(
        response_delay > max(MAX_RESPONSE_DELAY, delay), -1, table["step"] - response_delay
    )
    return np.maximum(step, -1)


def _commands(file: RawLog, topic: str) -> tuple[Command, ...]:
    """All of a topic."""
    columns = {field: file.tables[topic][field.name] for field in fields_of("sent")}
    return tuple(objects(Command, "sent", columns))


def _measurements(file: RawLog, robot: RobotConfig) -> tuple[Measurement, ...]:
    """All of a log; why the robot was stopped says the parts of a measurement that are in no row."""
    table = file.tables[TICK_TOPIC]
    if not len(table["time"]):
        raise LogError(f"{file.path}: holds no tick")
    for group in ("touch", "bumpers", "buttons"):
        if table[group].shape[1:] != (len(getattr(robot.sensors, group)),):
            raise LogError(f"{file.path}: is of a robot with other {group} than '{robot.name}'")
    columns = {
        field: table[field.name]
        for owner in ("measurement", "measurement.imu")
        for field in fields_of(owner)
    }
    imus = objects(Imu, "measurement.imu", columns)
    return tuple(objects(Measurement, "measurement", columns, imu=imus))
