"""A recording as a mirror at the xz-plane shows it: left and right swapped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig

# The reflection turns the sign of y of a vector, and of all but y of an axis of rotation.
_TWIST_SIGNS = np.array([1.0, -1.0, -1.0])
_VECTOR_SIGNS = np.array([1.0, -1.0, 1.0])
_AXIS_SIGNS = np.array([-1.0, 1.0, -1.0])

_UNSIGNED = ("stiffness", "changed", "current")
_SIGNS = {
    "base_twist": _TWIST_SIGNS,
    "linear_acceleration": _VECTOR_SIGNS,
    "angular_velocity": _AXIS_SIGNS,
    "attitude": _AXIS_SIGNS,
}
_WHEELS = ("sent_wheel_speed", "wheel_speed")


def mirrored_columns(
    columns: Mapping[str, NDArray[Any]], per_joint: Iterable[str], robot: RobotConfig
) -> dict[str, NDArray[Any]]:
    """What a mirror changes of the columns of a :class:`pepper_driver.observer.recording.Recording`.

    Args:
        columns: By name.
        per_joint: Names of those with a value for each joint.
        robot: Gives the partners and signs of the joints, and the places of the wheels.
    """
    partner = [index for index, _ in robot.mirror]
    signs = np.array([sign for _, sign in robot.mirror])
    changed = {}
    for name in per_joint:
        swapped = columns[name][:, partner]
        changed[name] = swapped if name in _UNSIGNED else swapped * signs
    for name, factors in _SIGNS.items():
        changed[name] = columns[name] * factors
    reflection = (robot.wheels.matrix * _TWIST_SIGNS) @ robot.wheels.inverse
    for name in _WHEELS:
        changed[name] = columns[name] @ reflection.T
    return changed
