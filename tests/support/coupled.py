"""Controllers with coupled limits, and where a posture lies in their region."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.constraints import CoupledLimits
from support.controller import ROBOT, SETTINGS

Velocity = Literal["safe", "robot"]

MARGIN = 0.005
DIGITS = 1e-6  # the tables have fewer than the URDF
YAW, PITCH = ROBOT.joint_index("HeadYaw"), ROBOT.joint_index("HeadPitch")


def coupled(robot: RobotConfig = ROBOT, velocity: Velocity = "safe") -> WholeBodyController:
    control = WholeBodyController(robot, replace(SETTINGS, velocity=velocity))
    control.add(CoupledLimits(robot, MARGIN))
    return control


def room(position: FloatArray, robot: RobotConfig = ROBOT) -> FloatArray:
    """Distance from each coupled limit, lower, then upper, negative beyond it."""
    left = []
    for limit in robot.limits.coupled:
        angles, lower, upper = np.array(limit.table).T
        driver = position[robot.joint_index(limit.driver)]
        driven = position[robot.joint_index(limit.driven)]
        left += [driven - np.interp(driver, angles, lower)]
        left += [np.interp(driver, angles, upper) - driven]
    return np.array(left)
