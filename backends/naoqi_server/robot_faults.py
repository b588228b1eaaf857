"""Faults of the stand-in robot itself; ``faults.FAULTS`` has the names and arguments."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from pepper_driver.backends.naoqi_server.faults import Value, make_fault
from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock


class RobotFault:
    """Something wrong. It is made of the robot, the places of the table's values by key, and its arguments."""

    def actuators(self, values: list[float]) -> None:
        """Change what the DCM sends in this cycle: values in the order of the DCM, which come first among ``keys``."""

    def sensors(self, values: FloatArray) -> None:
        """Change what is published of this cycle: values of all keys. What really happened stays as it is."""


class Asleep(RobotFault):
    """Hardness of all joints, stiffness and speed of all wheels are zero, for any command."""

    def __init__(
        self, robot: RobotConfig, keys: Mapping[str, int], arguments: Mapping[str, Value]
    ) -> None:
        names, wheels = robot.naoqi, robot.wheels.names
        self._off = [
            *_places(robot, keys, (names.stiffness_command,), joint=robot.joint_names),
            *_places(robot, keys, (names.wheel_stiffness_command,), wheel=wheels),
            *_places(robot, keys, (names.wheel_speed_command,), wheel=wheels),
        ]

    def actuators(self, values: list[float]) -> None:
        """Nothing moves of its own."""
        for place in self._off:
            values[place] = 0.0


class Disconnected(RobotFault):
    """The sensors of a joint stand where they were; its motor has no power, for any command that the DCM shows."""

    def __init__(
        self, robot: RobotConfig, keys: Mapping[str, int], arguments: Mapping[str, Value]
    ) -> None:
        joint = str(arguments["joint"])
        if joint not in robot.joint_names:
            raise UnknownNameError("joint", joint, robot.joint_names)
        names = robot.naoqi
        (self._motor,) = _places(robot, keys, (names.stiffness_command,), joint=[joint])
        self._sensors = np.array(
            _places(robot, keys, (names.position, names.current, names.temperature), joint=[joint]),
            dtype=np.intp,
        )
        self._stands: FloatArray | None = None
        self._ordered: float | None = None

    def actuators(self, values: list[float]) -> None:
        """No current."""
        self._ordered, values[self._motor] = values[self._motor], 0.0

    def sensors(self, values: FloatArray) -> None:
        """As they were."""
        # ALMemory shows the command as if the motor had got it.
        if self._ordered is not None:
            values[self._motor] = self._ordered
        if self._stands is None:
            # NumPy copies where an array of places selects.
            self._stands = values[self._sensors]
        values[self._sensors] = self._stands


class Dropped(RobotFault):
    """In a fraction of the cycles nothing new is published, drawn for each; times stand with the values."""

    def __init__(
        self, robot: RobotConfig, keys: Mapping[str, int], arguments: Mapping[str, Value]
    ) -> None:
        self._fraction = float(arguments["fraction"])
        # The same cycles in each run, so that a test can be repeated.
        self._random = random.Random(0)
        self._shown: FloatArray | None = None

    def sensors(self, values: FloatArray) -> None:
        """Repeat the previous sample."""
        if self._shown is not None and self._random.random() < self._fraction:
            values[:] = self._shown
        else:
            self._shown = values.copy()


class Shown(RobotFault):
    """Some sensors show a value that is not true."""

    def __init__(
        self, robot: RobotConfig, keys: Mapping[str, int], shown: Iterable[str], value: float
    ) -> None:
        known = {name.removeprefix(robot.naoqi.prefix): place for name, place in keys.items()}
        names = [name.removeprefix(robot.naoqi.prefix) for name in shown]
        for name in names:
            if name not in known:
                raise UnknownNameError("sensor", name, known)
        self._places = [known[name] for name in names]
        self._value = value

    def sensors(self, values: FloatArray) -> None:
        """They show it."""
        values[self._places] = self._value


def hot(robot: RobotConfig, keys: Mapping[str, int], arguments: Mapping[str, Value]) -> RobotFault:
    """Return the temperature of a joint or a wheel."""
    joint, motors = str(arguments["joint"]), (*robot.joint_names, *robot.wheels.names)
    if joint not in motors:
        raise UnknownNameError("motor", joint, motors)
    key = robot.naoqi.temperature.format(joint=joint)
    return Shown(robot, keys, [key], float(arguments["celsius"]))


def value(
    robot: RobotConfig, keys: Mapping[str, int], arguments: Mapping[str, Value]
) -> RobotFault:
    """Any sensor."""
    return Shown(robot, keys, [str(arguments["key"])], float(arguments["value"]))


def press(
    robot: RobotConfig, keys: Mapping[str, int], arguments: Mapping[str, Value]
) -> RobotFault:
    """Touch sensors, bumpers and buttons."""
    names, sensors = robot.naoqi, robot.sensors
    known = {
        **{name: names.touch.format(touch=name) for name in sensors.touch},
        **{name: names.bumper.format(bumper=name) for name in sensors.bumpers},
        **{name: names.button.format(button=name) for name in sensors.buttons},
    }
    # Not commas, which separate the arguments of a fault on the command line.
    names_pressed = str(arguments["sensors"]).split("+")
    for name in names_pressed:
        if name not in known:
            raise UnknownNameError("sensor to press", name, known)
    return Shown(robot, keys, [known[name] for name in names_pressed], 1.0)


Maker = Callable[[RobotConfig, Mapping[str, int], Mapping[str, Value]], RobotFault]
"""Raises UnknownNameError for a joint or a sensor that is not there."""

KINDS: Mapping[str, Maker] = {
    "asleep": Asleep,
    "disconnected": Disconnected,
    "dropped": Dropped,
    "hot": hot,
    "press": press,
    "value": value,
}


class RobotFaults:
    """The faults that are set. One takes the place of another of the same name and the same texts.

    Args:
        robot: Description of the robot.
        keys: Places of the table's values.
        clock: By which they begin and end.
    """

    def __init__(
        self,
        robot: RobotConfig,
        keys: Mapping[str, int],
        clock: Clock = MONOTONIC_CLOCK,
    ) -> None:
        self._robot, self._keys, self._clock = robot, keys, clock
        self._set: dict[tuple[str, ...], tuple[float, float, RobotFault]] = {}

    def set(self, name: str, arguments: Mapping[str, object]) -> None:
        """Set a fault of the robot.

        Raises:
            UnknownNameError: No such fault, or no such joint or sensor.
            ConfigError: Arguments that it does not take.
        """
        if name not in KINDS:
            raise UnknownNameError("fault of the robot", name, KINDS)
        fault = make_fault(name, arguments)
        made = KINDS[name](self._robot, self._keys, fault.arguments)
        begin = self._clock.seconds() + fault.after
        self._set[fault.identity] = (begin, begin + fault.seconds, made)

    def clear(self) -> None:
        """All well again."""
        self._set.clear()

    def actuators(self, values: list[float]) -> None:
        """Have each fault change the output of the DCM."""
        for fault in self._on():
            fault.actuators(values)

    def sensors(self, values: FloatArray) -> None:
        """Have each fault change the published values."""
        for fault in self._on():
            fault.sensors(values)

    def _on(self) -> list[RobotFault]:
        now = self._clock.seconds()
        return [fault for begin, end, fault in self._set.values() if begin <= now < end]


def _places(
    robot: RobotConfig, keys: Mapping[str, int], patterns: Iterable[str], **names: Iterable[str]
) -> list[int]:
    """Places of the keys that patterns stand for."""
    ((slot, choices),) = names.items()
    chosen = list(choices)
    return [keys[robot.naoqi.prefix + p.format(**{slot: n})] for p in patterns for n in chosen]
