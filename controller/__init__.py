"""Task-space whole-body controller: it computes reference and load torque from tasks and limits."""

# ruff: noqa: E402
from pepper_driver.backends.naoqi.qi_library import preload_qi

preload_qi()  # before the first import of pinocchio

from pepper_driver.controller.changes import Changes
from pepper_driver.controller.constraints import BrakingLimits, Constraint, LinearInequality
from pepper_driver.controller.errors import (
    ChangesError,
    GainError,
    LimitError,
    PartError,
    RobotMismatchError,
    ShapeError,
    TargetError,
    TaskCountError,
)
from pepper_driver.controller.model import LoadTorque, RobotModel
from pepper_driver.controller.odometry import Odometry, desaturate
from pepper_driver.controller.report import ControllerStatus, TaskReport
from pepper_driver.controller.tasks import (
    BasePoseTask,
    BaseVelocityTask,
    ComplianceTask,
    ComTask,
    FrameTask,
    HandTask,
    LookAtTask,
    MomentumTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    Task,
    TaskRows,
)
from pepper_driver.controller.tick import Reference, SentCommand, Tick
from pepper_driver.controller.whole_body import WholeBodyController

__all__ = [
    "BasePoseTask",
    "BaseVelocityTask",
    "BrakingLimits",
    "Changes",
    "ChangesError",
    "ComTask",
    "ComplianceTask",
    "Constraint",
    "ControllerStatus",
    "FrameTask",
    "GainError",
    "HandTask",
    "LimitError",
    "LinearInequality",
    "LoadTorque",
    "LookAtTask",
    "MomentumTask",
    "Odometry",
    "OrientationTask",
    "PartError",
    "PositionTask",
    "PostureTask",
    "Reference",
    "RobotMismatchError",
    "RobotModel",
    "SentCommand",
    "ShapeError",
    "TargetError",
    "Task",
    "TaskCountError",
    "TaskReport",
    "TaskRows",
    "Tick",
    "WholeBodyController",
    "desaturate",
]
