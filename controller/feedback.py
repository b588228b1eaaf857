"""Closed loop: where tasks see the robot, from what it measures."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends.interface import Measurement
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.wheels import Odometry


class Feedback:
    """The controller's own configuration less the robot's tracking error, on a base where odometry has it.

    Each measurement is held against the command that it answers, so that the transport between them is no error, and
    the error is smoothed: what acceleration and lag do to it would come back as a poorly damped motion. At rest the
    result is the measured configuration.

    Args:
        model: Of the controller.
        odometry: Of the controller.
        share: Of what is new in each cycle: cycle over smoothing time, 1 at most.
    """

    def __init__(self, model: RobotModel, odometry: Odometry, share: float) -> None:
        self._model, self._odometry, self._share = model, odometry, share
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        self._error: FloatArray = np.zeros(len(self._model.joint_columns))

    def configuration(
        self, q: FloatArray, measurement: Measurement, answered: FloatArray | None
    ) -> FloatArray:
        """What tasks see in place of the controller's configuration ``q``.

        Args:
            q: Configuration of the controller.
            measurement: The newest.
            answered: (17,) positions of the command that it answers [rad]; by default those of ``q``.
        """
        model = self._model
        position = model.joints_of_configuration(q)
        error = (position if answered is None else answered) - measurement.position
        if np.isfinite(error).all():  # the safety gate stops a robot that measures nothing
            self._error = self._error + self._share * (error - self._error)
        shifted = model.with_joint_position(q, position - self._error)
        return model.with_base_pose(shifted, self._odometry.pose)
