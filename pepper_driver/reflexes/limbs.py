"""Joints of the limb that a contact is on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import RobotConfig
from pepper_driver.observer import Contact

BoolArray = NDArray[np.bool_]

LEGS = "legs"
"""The chain that carries the robot: no reflex lets it give way."""


def limb_of(contact: Contact, robot: RobotConfig, *, fingers: bool = False) -> BoolArray:
    """(17,) the joints of the limb that a contact is on; none for one on trunk, base or legs."""
    joints = np.zeros(len(robot.joint_names), dtype=np.bool_)
    for chain, names in robot.chains.items():
        if chain != LEGS and contact.joint in names:
            joints[[robot.joint_index(name) for name in names]] = True
    if not fingers:
        joints[[robot.joint_index(name) for name in robot.hands.joints]] = False
    return joints
