"""What can be wrong with the stand-in robot, inside the robot process: switched on and off by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from pepper_driver.backends.interface import BackendError
from pepper_driver.config import RobotConfig, UnknownNameError
from pepper_driver.config.parts import FloatArray


class RobotFault:
    """Something wrong; a subclass overrides what it needs.

    Made as ``Kind(robot, keys, **arguments)`` by ``set_fault(name, **arguments)``, with the places of the values; a
    second one of the same name takes its place. A ValueError says what is wrong with the arguments.
    """

    def actuators(self, values: list[float]) -> None:
        """Change what the DCM sends in this cycle: values in the order of the DCM, which come first among ``keys``."""

    def sensors(self, values: FloatArray) -> None:
        """Change what is published of this cycle: values of all keys. What really happened stays as it is."""


class Press(RobotFault):
    """Touch sensors, bumpers or buttons that are pressed: ``press`` with ``sensors=["Head/Touch/Front", ...]``."""

    def __init__(
        self, robot: RobotConfig, keys: Mapping[str, int], sensors: list[str] | str
    ) -> None:
        names = robot.naoqi
        known: dict[str, str] = {}
        for kind, pattern, group in (
            ("touch", names.touch, robot.sensors.touch),
            ("bumper", names.bumper, robot.sensors.bumpers),
            ("button", names.button, robot.sensors.buttons),
        ):
            known |= {name: names.prefix + pattern.format(**{kind: name}) for name in group}
        chosen = [sensors] if isinstance(sensors, str) else list(sensors)
        for name in chosen:
            if name not in known:
                raise UnknownNameError("sensor to press", name, known)
        self._places = np.array([keys[known[name]] for name in chosen], dtype=np.intp)

    def sensors(self, values: FloatArray) -> None:
        """They say so."""
        values[self._places] = 1.0


class RobotFaults:
    """The faults that are on."""

    KINDS: ClassVar[dict[str, Callable[..., RobotFault]]] = {"press": Press}
    """By name; one line for each."""

    def __init__(self, robot: RobotConfig, keys: Mapping[str, int]) -> None:
        self._robot, self._keys = robot, keys
        self._on: dict[str, RobotFault] = {}

    def set(self, name: str, arguments: Mapping[str, Any]) -> None:
        """Switch one on, or change how.

        Raises:
            UnknownNameError: No such fault.
            BackendError: Arguments that it does not take.
        """
        if name not in self.KINDS:
            raise UnknownNameError("fault", name, self.KINDS)
        try:
            self._on[name] = self.KINDS[name](self._robot, self._keys, **arguments)
        except (TypeError, ValueError) as error:
            raise BackendError(f"fault '{name}': {error}") from error

    def clear(self) -> None:
        """All well again."""
        self._on.clear()

    def actuators(self, values: list[float]) -> None:
        """Let each change what the DCM sends."""
        for fault in self._on.values():
            fault.actuators(values)

    def sensors(self, values: FloatArray) -> None:
        """Let each change what is published."""
        for fault in self._on.values():
            fault.sensors(values)
