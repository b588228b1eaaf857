"""Controller that plays recorded references: for replays, where the recorded tasks are unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import BASE
from pepper_driver.controller.tick import Reference
from pepper_driver.controller.whole_body import WholeBodyController


class PlaybackController(WholeBodyController):
    """Moves from reference to reference, in the state in which they were made.

    Tasks can be added and removed, and change nothing. Where no reference is known it stays as it is.

    Args:
        robot: Its description.
        settings: Of the recorded controller.
        references: One a cycle; None where it is not known.
    """

    def __init__(
        self,
        robot: RobotConfig,
        settings: ControllerSettings,
        references: Sequence[Reference | None],
    ) -> None:
        super().__init__(robot, settings)
        self._references = iter(references)
        self._last: Reference | None = None

    def step(
        self, measurement: Measurement | None = None, answered: FloatArray | None = None
    ) -> Reference:
        """Return the next reference."""
        model, dt = self.model, self._dt
        reference = next(self._references, None)
        if reference is None:
            reference = self._last
        if reference is None:  # of nothing
            return super().step(measurement, answered)
        self._last = reference
        if measurement is not None:
            self.odometry.update(measurement.wheel_speed, dt)
        velocity, acceleration = np.zeros(model.nv), np.zeros(model.nv)
        velocity[:BASE] = reference.base_twist
        velocity[model.joint_columns] = reference.velocity
        acceleration[:BASE] = (reference.base_twist - self._v[:BASE]) / dt
        acceleration[model.joint_columns] = reference.acceleration
        self._before = self._q
        rolled = model.integrate(self._q, 0.5 * dt * (self._v + velocity))
        self._q = model.with_joint_position(rolled, reference.position)
        self._v, self._acceleration = velocity, acceleration
        model.set_state(self._q, self._v)
        return reference
