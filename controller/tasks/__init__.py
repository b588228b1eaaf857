"""Tasks of the robot: each is a small object that the user makes and hands to the controller."""

from pepper_driver.controller.tasks.base_pose import BasePoseTask
from pepper_driver.controller.tasks.com import ComTask
from pepper_driver.controller.tasks.frame import FrameTask, OrientationTask, PositionTask
from pepper_driver.controller.tasks.look_at import LookAtTask
from pepper_driver.controller.tasks.posture import ComplianceTask, HandTask, PostureTask
from pepper_driver.controller.tasks.task import Task, TaskRows, checked_stiffness
from pepper_driver.controller.tasks.velocity import BaseVelocityTask, MomentumTask

__all__ = [
    "BasePoseTask",
    "BaseVelocityTask",
    "ComTask",
    "ComplianceTask",
    "FrameTask",
    "HandTask",
    "LookAtTask",
    "MomentumTask",
    "OrientationTask",
    "PositionTask",
    "PostureTask",
    "Task",
    "TaskRows",
    "checked_stiffness",
]
