"""Reactions to touch inside the tick."""

from pepper_driver.config.robot import JointSelectionError, joint_mask
from pepper_driver.reflexes.arbiter import Arbiter, prepare_reflexes
from pepper_driver.reflexes.basic import Hold, Ignore, Soften, StopBase
from pepper_driver.reflexes.comply import Assist, Comply
from pepper_driver.reflexes.follow_hand import FollowHand
from pepper_driver.reflexes.reflex import Reflex, ReflexError, limb_joints
from pepper_driver.reflexes.requests import ReflexRequests
from pepper_driver.reflexes.retract import Retract

__all__ = [
    "Arbiter",
    "Assist",
    "Comply",
    "FollowHand",
    "Hold",
    "Ignore",
    "JointSelectionError",
    "Reflex",
    "ReflexError",
    "ReflexRequests",
    "Retract",
    "Soften",
    "StopBase",
    "joint_mask",
    "limb_joints",
    "prepare_reflexes",
]
