"""Settings and references for tests of loop and gate."""

from dataclasses import replace

import numpy as np

from pepper_driver.config import ControllerSettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference


def slowed(settings: ControllerSettings, speed: float) -> ControllerSettings:
    """Settings for a gate that lets no joint pass faster than ``speed`` [rad/s] times its margin."""
    return replace(settings, velocity_limit=dict.fromkeys(settings.velocity_limit, speed))


def reference(position: FloatArray) -> Reference:
    """At rest at a posture."""
    zero = np.zeros(17)
    return Reference(
        position=position,
        velocity=zero,
        acceleration=zero,
        load_torque=zero,
        base_twist=np.zeros(3),
    )
