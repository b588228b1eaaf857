"""The service ``ALMotion``."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.modules.motion_base import BaseCalls
from pepper_driver.backends.naoqi_server.modules.motion_joints import JointCalls
from pepper_driver.backends.naoqi_server.modules.motion_reflexes import ReflexCalls
from pepper_driver.backends.naoqi_server.modules.motion_stiffness import StiffnessCalls
from pepper_driver.backends.naoqi_server.modules.motion_tools import ToolCalls


class MotionService(JointCalls, StiffnessCalls, BaseCalls, ReflexCalls, ToolCalls):
    """Moves the robot, 50 times a second. Its parts are the chapters of NAOqi's documentation."""
