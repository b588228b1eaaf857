"""Transforms as URDF and configuration files write them."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

import numpy as np

from pepper_driver.config.arrays import FloatArray


def transform(xyz: Sequence[float], rpy: Sequence[float]) -> FloatArray:
    """(4, 4) of a frame at ``xyz`` [m] in its parent, turned by roll, pitch, yaw [rad] about the parent's axes."""
    roll, pitch, yaw = rpy
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    x, y, z = xyz
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y],
            [-sp, cp * sr, cp * cr, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
