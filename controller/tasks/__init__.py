"""What the robot shall do: each task is a small object the user makes and hands to the controller."""

from pepper_driver.controller.tasks.base_velocity import BaseVelocityTask
from pepper_driver.controller.tasks.posture import PostureTask
from pepper_driver.controller.tasks.task import Task

__all__ = ["BaseVelocityTask", "PostureTask", "Task"]
