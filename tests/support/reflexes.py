"""Joints and torques of the bench that reflexes are tested on."""

from __future__ import annotations

from pepper_driver.config import load_robot
from pepper_driver.testing import ReflexBench as Stage
from pepper_driver.testing import make_contact as touch
from pepper_driver.testing import standing_measurement
from pepper_driver.testing.reflex_bench import TORQUE_STD

__all__ = ["ARM", "BLANK", "ROBOT", "ROLL", "STD", "Stage", "touch"]

ROBOT = load_robot()
BLANK = standing_measurement()
ROLL = ROBOT.joint_index("LShoulderRoll")
ARM = [ROBOT.joint_index(name) for name in ROBOT.chains["left_arm"]]
STD = TORQUE_STD
