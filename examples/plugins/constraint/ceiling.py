"""A constraint of your own: a link stays below a height."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import RobotConfig, UnknownNameError, load_robot
from pepper_driver.controller import (
    BrakingLimits,
    Constraint,
    LimitError,
    LinearInequality,
    RobotModel,
)

APPROACH = 4.0  # [1/s] upwards no faster than this times the room that is left
NEAR = 0.5  # [m] from there on rows are made


class Ceiling(Constraint):
    """The origin of a link stays below a height [m] above the floor.

    Args:
        link: Name of the link.
        height: [m]
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such link.
        LimitError: A height that is no number above 0.
    """

    def __init__(self, link: str, height: float, *, robot: RobotConfig | None = None) -> None:
        links = (robot or load_robot()).links
        if link not in links:
            raise UnknownNameError("link", link, links)
        if not (isinstance(height, int | float) and 0.0 < height < 10.0):
            raise LimitError("height", height, "above 0 and below 10 m")
        self.name = f"ceiling {link}"  # in explain() and status
        self._link, self._height = link, height

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        """Bound the speed upwards after this cycle, z' + z'' dt, by APPROACH times the room below the ceiling."""
        frame = model.body_frame(self._link)
        room = self._height - float(model.pose(frame).translation[2])
        if room > NEAR:
            return None  # nothing to keep: no row costs nothing
        upwards = model.jacobian(frame)[2]
        speed = float(upwards @ model.v)
        bias = float(model.bias(frame)[2])
        bound = (APPROACH * room - speed) / braking_limits.dt - bias
        return LinearInequality(upwards[None, :], np.array([bound]), (self.name,))
