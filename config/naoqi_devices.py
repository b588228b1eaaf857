"""Sensors and actuators of the robot as its device manager (DCM) lists them, and what the stand-in says of the rest."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path

from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError
from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.robot import RobotConfig

_BRACES = re.compile(r"\{([^{}]*)\}")
_RANGE = re.compile(r"(\d+)\.\.(\d+)")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _DeviceFile:
    values: dict[str, float | tuple[float, ...]]
    steps: tuple[str, ...]
    body_id: str
    texts: dict[str, str]
    events: dict[str, tuple[str, str]]


class NaoqiDevices:
    """Devices that the DCM lists; see ``naoqi_devices.yaml``.

    Attributes:
        values: Value at the start by full key, sensors and actuators, in the order of the file.
        actuators: Keys of the actuators, in the same order.
        steps: Those among them that do not interpolate.
        body_id: Key of the text that identifies a robot.
        texts: Other texts by key.
        events: Key of the sensor by whose change an event is raised, and its name in ``TouchChanged``, by event.
    """

    def __init__(self, file: _DeviceFile, robot: RobotConfig, source: str) -> None:
        prefix = robot.naoqi.prefix
        names = {"joint": robot.joint_names, "wheel": robot.wheels.names}
        self.values: dict[str, float] = {}
        for pattern, value in file.values.items():
            for key, number in _expanded(pattern, names):
                if isinstance(value, float):
                    self.values[prefix + key] = value
                elif number is not None and number < len(value):
                    self.values[prefix + key] = value[number]
                else:
                    raise ConfigError(f"{source}: key '{pattern}': {len(value)} values are too few")
        self.actuators = tuple(key for key in self.values if key.endswith("/Actuator/Value"))
        steps = [prefix + key for pattern in file.steps for key, _ in _expanded(pattern, names)]
        if unknown := set(steps) - set(self.actuators):
            raise ConfigError(f"{source}: key 'steps': no actuator {sorted(unknown)[0]}")
        self.steps = frozenset(steps)
        self.body_id = file.body_id
        self.texts = dict(file.texts)
        self.events = {name: (prefix + key, touch) for name, (key, touch) in file.events.items()}
        for name, (key, _) in self.events.items():
            if key not in self.values:
                raise ConfigError(f"{source}: key 'events.{name}': no sensor {key}")


def _expanded(pattern: str, names: Mapping[str, tuple[str, ...]]) -> list[tuple[str, int | None]]:
    """Keys that a pattern stands for, each with its place in the pattern's range of numbers."""
    parts = _BRACES.split(pattern)  # text and insides of braces in turn
    choices: list[list[tuple[str, int | None]]] = []
    for place, part in enumerate(parts):
        numbers = _RANGE.fullmatch(part)
        if place % 2 == 0:
            choices.append([(part, None)])
        elif numbers:
            first, last = numbers.groups()
            texts = [str(n).zfill(len(first)) for n in range(int(first), int(last) + 1)]
            choices.append([(text, number) for number, text in enumerate(texts)])
        else:
            choices.append([(text, None) for text in names.get(part, tuple(part.split(",")))])
    found: list[tuple[str, int | None]] = []
    for combination in product(*choices):
        number = next((n for _, n in combination if n is not None), None)
        found.append(("".join(text for text, _ in combination), number))
    return found


def load_naoqi_devices(robot: RobotConfig, path: Path | str | None = None) -> NaoqiDevices:
    """Return the device list from ``path``, by default the shipped ``naoqi_devices.yaml``.

    Raises:
        ConfigError: One line naming the file, the key and what is possible.
    """
    path = own_or_shipped(path, "naoqi_devices.yaml")
    return NaoqiDevices(load(_DeviceFile, path), robot, str(path))
