"""What every backend asks of a command."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import Command, CommandError

FloatArray = NDArray[np.float64]


def checked_command(command: Command, joints: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, stiffness and wheel speed, as given.

    Raises:
        CommandError: They are not what a robot with so many joints could take.
    """
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
    try:
        array = np.asarray(values)
        if array.shape == (size,) and array.dtype.kind in "fiub":
            array = array.astype(np.float64, copy=False)
            if np.isfinite(array.sum()):
                return array
    except (TypeError, ValueError):  # no array at all
        pass
    raise CommandError(f"{name}: expected {size} finite numbers")
