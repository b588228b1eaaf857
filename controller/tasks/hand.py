"""Hands: open and close."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import check_name
from pepper_driver.controller.errors import TargetError
from pepper_driver.controller.tasks.posture import PostureTask
from pepper_driver.controller.tasks.targets import Target, finite_vector


@checked_arguments
class HandTask(PostureTask):
    """A hand goes to an aperture, 0 closed to 1 open.

    Its weight is above the posture task's, so that the hand does what this task says.

    Args:
        hand: ``LHand`` or ``RHand``.
        stiffness: [1/s2].
        weight: In the cost.
        robot: Description of the robot, by default the shipped Pepper's.

    Raises:
        UnknownNameError: No such hand.
    """

    def __init__(
        self,
        hand: str,
        *,
        stiffness: float = 20.0,
        weight: float = 1e3,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = load_robot() if robot is None else robot
        check_name("hand", hand, robot.hands.joints)
        super().__init__(
            (hand,), stiffness=stiffness, weight=weight, name=f"hand {hand}", robot=robot
        )

    def checked(self, target: Target) -> FloatArray:
        """(1,) aperture; one number is taken too."""
        return super().checked(target)

    def _checked_part(self, target: Target) -> FloatArray:
        hand = self.joints[0]
        if isinstance(target, Mapping):
            return super()._checked_part(target)
        single = isinstance(target, Real) or (isinstance(target, np.ndarray) and target.ndim == 0)
        aperture: Any = [target] if single else target
        value = finite_vector(f"the aperture of {hand}", aperture, 1)
        if not 0.0 <= value[0] <= 1.0:
            raise TargetError(
                f"{hand} cannot open to {value[0]:.4g}: 0 is closed, 1 is open",
                joint=hand,
                value=float(value[0]),
                lower=0.0,
                upper=1.0,
            )
        return value
