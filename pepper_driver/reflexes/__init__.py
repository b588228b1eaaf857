"""Reactions to touch inside the tick."""

from pepper_driver.reflexes.arbiter import Arbiter, prepare_reflexes
from pepper_driver.reflexes.assist import Assist
from pepper_driver.reflexes.comply import Comply
from pepper_driver.reflexes.follow_hand import FollowHand
from pepper_driver.reflexes.hold import Hold
from pepper_driver.reflexes.ignore import Ignore
from pepper_driver.reflexes.limbs import JointSelectionError, joint_mask, limb_joints
from pepper_driver.reflexes.reflex import Reflex, ReflexError
from pepper_driver.reflexes.requests import ReflexRequests
from pepper_driver.reflexes.retract import Retract
from pepper_driver.reflexes.soften import Soften
from pepper_driver.reflexes.stop_base import StopBase

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
