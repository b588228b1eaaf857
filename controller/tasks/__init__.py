"""What the robot shall do: each task is a small object the user makes and hands to the controller."""

from pepper_driver.controller.tasks.base_pose import BasePoseTask
from pepper_driver.controller.tasks.base_velocity import BaseVelocityTask
from pepper_driver.controller.tasks.com import ComTask
from pepper_driver.controller.tasks.compliance import ComplianceTask
from pepper_driver.controller.tasks.frame import FrameTask, OrientationTask, PositionTask
from pepper_driver.controller.tasks.gains import checked_stiffness
from pepper_driver.controller.tasks.hand import HandTask
from pepper_driver.controller.tasks.look_at import LookAtTask
from pepper_driver.controller.tasks.momentum import MomentumTask
from pepper_driver.controller.tasks.posture import PostureTask
from pepper_driver.controller.tasks.task import Task, TaskRows

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
