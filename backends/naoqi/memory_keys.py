"""Names of measured and commanded values in the robot's memory, and the meaning of a list of its values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from math import isfinite

import numpy as np

from pepper_driver.backends.fields import Imu
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray

MAY_LACK = ("temperature", "battery", "charging_flap")
"""A sample without these is still valid: the monitors that use them handle missing values."""

ONE_BOARD = 2
"""Joints that a motor board drives at most, assumed: as many are missing when it is off."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Values:
    """One sample as the robot sent it; arrays as in :class:`~pepper_driver.backends.interface.Measurement`.

    ``shown`` is what the DCM's clock showed at its cycle [ms]. ``commanded`` (20,) is what it then sent to joints
    [rad] and wheels [rad/s], NaN where it does not say; None where that was not asked for.
    """

    shown: int
    position: FloatArray
    current: FloatArray
    wheel_speed: FloatArray
    imu: Imu
    touch: FloatArray
    bumpers: FloatArray
    buttons: FloatArray
    temperature: FloatArray
    stiffness: FloatArray
    battery: float
    charging_flap: float
    commanded: FloatArray | None = None


VALUES = tuple(field.name for field in fields(Values) if field.name not in ("shown", "commanded"))
"""Parts of a sample that enter a measurement."""


class SensorKeys:
    """The keys that are read in every cycle, and what their values are.

    Args:
        robot: Its description.
        complete: True if the robot must have all, except those of ``MAY_LACK``; else it may lack any.

    Attributes:
        names: In the order in which they are asked for.
        with_commands: The same, followed by the DCM's commands to joints and wheels.
        needed: Those without which there is no sample.
    """

    def __init__(self, robot: RobotConfig, *, complete: bool = True) -> None:
        naoqi, sensors = robot.naoqi, robot.sensors
        groups = {
            "position": [naoqi.position.format(joint=name) for name in robot.joint_names],
            "current": [naoqi.current.format(joint=name) for name in robot.joint_names],
            "temperature": [naoqi.temperature.format(joint=name) for name in robot.joint_names],
            "stiffness": [naoqi.stiffness_command.format(joint=name) for name in robot.joint_names],
            "wheel_speed": [naoqi.wheel_speed.format(wheel=name) for name in robot.wheels.names],
            "acceleration": list(naoqi.accelerometer),
            "angular_velocity": list(naoqi.gyroscope),
            "attitude": list(naoqi.attitude),
            "touch": [naoqi.touch.format(touch=name) for name in sensors.touch],
            "bumpers": [naoqi.bumper.format(bumper=name) for name in sensors.bumpers],
            "buttons": [naoqi.button.format(button=name) for name in sensors.buttons],
            "battery": [naoqi.battery_charge],
            "charging_flap": [naoqi.charging_flap],
        }
        self.names: list[str] = []
        self._places: dict[str, slice] = {}
        needed: list[bool] = []
        for group, keys in groups.items():
            self._places[group] = slice(len(self.names), len(self.names) + len(keys))
            self.names += [naoqi.prefix + key for key in keys]
            needed += [complete and group not in MAY_LACK] * len(keys)
        self._joint_at = {
            place: joint
            for group in ("position", "current", "stiffness")
            for place, joint in enumerate(robot.joint_names, self._places[group].start)
        }
        self._time = len(self.names)
        self.names.append(naoqi.time)
        self._needed = np.array([*needed, complete])
        self.needed = [name for name, is_ in zip(self.names, self._needed, strict=True) if is_]
        actuators = actuator_keys(robot)
        commands = actuators[Alias.POSITION] + actuators[Alias.WHEEL_SPEED]
        self.with_commands = self.names + commands

    def values(self, answer: Sequence[object]) -> Values | str:
        """Return what the answer to a question for ``names`` or ``with_commands`` means.

        Returns:
            The sample, or a human-readable reason why it is invalid.
        """
        try:
            # A missing value is None, which becomes NaN.
            values = np.array(answer, dtype=np.float64)
        # One text among the values must not cost the others: they are converted one by one, which is slower.
        except (TypeError, ValueError):
            values = np.array([_number(value) for value in _listed(answer)])
        commanded = None
        if values.shape == (len(self.with_commands),):
            values, commanded = values[: len(self.names)], values[len(self.names) :]
        if values.shape != (len(self.names),):
            return f"{values.size} values in place of {len(self.names)}"
        bad = ~np.isfinite(values) & self._needed
        if np.count_nonzero(bad):
            return self._without(np.flatnonzero(bad).tolist())
        values.setflags(write=False)  # part of measurements, which are immutable
        shown = float(values[self._time])
        part = {group: values[place] for group, place in self._places.items()}
        return Values(
            # NaN only of a robot that may lack any key (`complete=False`).
            shown=int(shown) if isfinite(shown) else 0,
            position=part["position"],
            current=part["current"],
            wheel_speed=part["wheel_speed"],
            imu=Imu(
                acceleration=part["acceleration"],
                angular_velocity=part["angular_velocity"],
                attitude=part["attitude"],
            ),
            touch=part["touch"],
            bumpers=part["bumpers"],
            buttons=part["buttons"],
            temperature=part["temperature"],
            stiffness=part["stiffness"],
            battery=float(part["battery"][0]),
            charging_flap=float(part["charging_flap"][0]),
            commanded=commanded,
        )

    def _without(self, places: list[int]) -> str:
        """Explain values that are not numbers."""
        more = f" and {len(places) - 1} more" if len(places) > 1 else ""
        lacking = f"no number for {self.names[places[0]]}{more}"
        joints = list(dict.fromkeys(self._joint_at.get(place, "") for place in places))
        if "" in joints or len(joints) > ONE_BOARD:
            return lacking
        return f"no answer from {' and '.join(joints)}, whose board is off or unplugged ({lacking})"


class Alias(StrEnum):
    """Groups of actuators, by the names under which the DCM gets to know them."""

    POSITION = "PepperDriverPosition"
    STIFFNESS = "PepperDriverHardness"
    WHEEL_SPEED = "PepperDriverWheelSpeed"
    WHEEL_STIFFNESS = "PepperDriverWheelStiffness"


def actuator_keys(robot: RobotConfig) -> dict[Alias, list[str]]:
    """Keys of what is commanded."""
    naoqi = robot.naoqi

    def of(key: str, names: Sequence[str]) -> list[str]:
        return [naoqi.prefix + key.format(joint=name, wheel=name) for name in names]

    return {
        Alias.POSITION: of(naoqi.position_command, robot.joint_names),
        Alias.STIFFNESS: of(naoqi.stiffness_command, robot.joint_names),
        Alias.WHEEL_SPEED: of(naoqi.wheel_speed_command, robot.wheels.names),
        Alias.WHEEL_STIFFNESS: of(naoqi.wheel_stiffness_command, robot.wheels.names),
    }


def _listed(answer: object) -> list[object]:
    return list(answer) if isinstance(answer, list | tuple) else []


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan
