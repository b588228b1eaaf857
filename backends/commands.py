"""What every backend asks of a command."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends.interface import Command

FloatArray = NDArray[np.float64]


def checked_command(command: Command, joints: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, stiffness and wheel speed, as given.

    Raises:
        ValueError: They are not what a robot with so many joints could take.
    """
    parts = []
    for name, size in (("position", joints), ("stiffness", joints), ("wheel_speed", 3)):
        array = np.asarray(getattr(command, name), dtype=np.float64)
        if array.shape != (size,) or not np.isfinite(array.sum()):
            raise ValueError(f"command.{name}: expected {size} finite numbers")
        parts.append(array)
    position, stiffness, wheel_speed = parts
    return position, stiffness, wheel_speed
