"""The task-space whole-body controller: tasks and limits in, reference and load torque out."""

from pepper_driver.controller.errors import GainError, TargetError
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.reference import Reference
from pepper_driver.controller.tasks import BaseVelocityTask, PostureTask, Task
from pepper_driver.controller.tick import Tick
from pepper_driver.controller.whole_body import ControllerStatus, WholeBodyController

__all__ = [
    "BaseVelocityTask",
    "ControllerStatus",
    "GainError",
    "PostureTask",
    "Reference",
    "RobotModel",
    "TargetError",
    "Task",
    "Tick",
    "WholeBodyController",
]
