"""Masks of joints: of the limb that a contact is on, or by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.config.arrays import BoolArray
from pepper_driver.config.errors import shown
from pepper_driver.config.robot import TRUNK
from pepper_driver.observer import Contact

JointSelection = str | Sequence[str] | BoolArray
"""Joints: a name of a joint or a chain, some names, or a mask (17,) of bool."""


class JointSelectionError(PepperError, ValueError):
    """Neither names of joints nor a mask of them."""


def joint_mask(joints: JointSelection, robot: RobotConfig) -> BoolArray:
    """(17,) joints by name, as a mask; a mask as it is.

    Args:
        joints: ``"LElbowRoll"``, ``"left_arm"``, ``["head", "LHand"]`` or a mask (17,) of bool.
        robot: Its description.

    Raises:
        UnknownNameError: No such joint or chain.
        JointSelectionError: A mask of another shape or type, or neither names nor a mask.
    """
    count = len(robot.joint_names)
    if isinstance(joints, np.ndarray):
        if joints.shape == (count,) and joints.dtype == np.bool_:
            return joints
        raise JointSelectionError(
            f"a mask of joints is an array ({count},) of bool, got {joints.shape} of {joints.dtype}"
        )
    names = (joints,) if isinstance(joints, str) else joints
    if not isinstance(names, Iterable) or not all(isinstance(name, str) for name in names):
        raise JointSelectionError(
            f"joints are given by names, such as 'LElbowRoll' or ['left_arm', 'head'], or by a mask ({count},) of bool,"
            f" got {shown(joints)}"
        )
    mask = np.zeros(count, dtype=np.bool_)
    for name in names:
        members = robot.chains.get(name, (name,))
        for member in members:
            if member not in robot.joint_names:
                known = (*robot.chains, *robot.joint_names)
                raise UnknownNameError("joint or chain", name, known)
            mask[robot.joint_index(member)] = True
    return mask


def limb_joints(contact: Contact, robot: RobotConfig, *, fingers: bool = False) -> BoolArray:
    """(17,) the joints of the limb that a contact is on; none on the trunk: no reflex lets the legs give way."""
    joints = np.zeros(len(robot.joint_names), dtype=np.bool_)
    if contact.limb != TRUNK:
        joints[[robot.joint_index(name) for name in robot.limbs[contact.limb]]] = True
    if not fingers:
        joints[[robot.joint_index(name) for name in robot.hands.joints]] = False
    return joints
