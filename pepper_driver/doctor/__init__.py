"""Examines a robot before it moves, and with a small motion whether its models fit."""

from pepper_driver.backends.readiness import CheckResult, CheckStatus
from pepper_driver.doctor.examination import Examination, examine
from pepper_driver.doctor.model_fit import JointFit, Verdict
from pepper_driver.doctor.motion_test import MotionTest, try_motion

__all__ = [
    "CheckResult",
    "CheckStatus",
    "Examination",
    "JointFit",
    "MotionTest",
    "Verdict",
    "examine",
    "try_motion",
]
