"""Decelerations that braking distances are computed with.

Limits that joints share, h(q) <= 0, are kept as those of single joints are, by braking distance: a motion is allowed as
long as the robot, if each joint braked as its box allows, would keep them all the way to rest. Braking is always inside
the box, so a robot that satisfies this now can satisfy it in the next cycle too.
"""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.constraints.braking import BRAKE_SHARE


@dataclass(frozen=True, slots=True, eq=False)
class BrakingLimits:
    """How fast base and joints can change their speed.

    Attributes:
        acceleration: (20,) limits [m/s2], [rad/s2].
        dt: Cycle [s].
    """

    acceleration: FloatArray
    dt: float

    @property
    def brake(self) -> FloatArray:
        """(20,) deceleration that the way to rest is computed with [m/s2], [rad/s2]."""
        return BRAKE_SHARE * self.acceleration
