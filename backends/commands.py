"""Checks of commands that all backends make."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends.fields import Command
from pepper_driver.backends.interface import CommandError
from pepper_driver.config.arguments import real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import shown


def checked_command(command: Command, joints: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, stiffness and wheel speed, as given.

    Raises:
        CommandError: They are not what a robot with so many joints could take.
    """
    if not isinstance(command, Command):
        raise CommandError(f"a command is expected, got {shown(command)}")
    parts = []
    for name, size in (("position", joints), ("stiffness", joints), ("wheel_speed", 3)):
        parts.append(finite_numbers(f"command.{name}", getattr(command, name), size))
    position, stiffness, wheel_speed = parts
    return position, stiffness, wheel_speed


def finite_numbers(name: str, values: object, size: int) -> FloatArray:
    """``values`` as an array (size,): a float64 array itself, others as a new one.

    Raises:
        CommandError: They are no such numbers.
    """
    array = values if isinstance(values, np.ndarray) else real_array(values)
    if array is not None and array.shape == (size,) and array.dtype.kind in "fiu":
        array = array.astype(np.float64, copy=False)
        if np.isfinite(array.sum()):
            return array
    raise CommandError(f"{name}: expected {size} finite numbers, got {shown(values)}")
