"""Examines a robot before it moves, and with a small motion whether its models fit."""

from pepper_driver.doctor.checks import Outcome, Result
from pepper_driver.doctor.examination import Examination, examine
from pepper_driver.doctor.model_fit import JointFit, Verdict
from pepper_driver.doctor.motion_test import Trial, try_motion

__all__ = [
    "Examination",
    "JointFit",
    "Outcome",
    "Result",
    "Trial",
    "Verdict",
    "examine",
    "try_motion",
]
