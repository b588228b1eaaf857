"""Peppers to be pushed: the nominal plant on a base that stands fast, and on one that rolls and tips."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from pepper_driver.config import load_robot
from pepper_driver.robot import Pepper

ROBOT = load_robot()

_FOLDER = TemporaryDirectory()  # gone when the tests are over


def make_pepper(base: Literal["fixed", "rolling"] = "fixed") -> Pepper:
    """A Pepper that feels nothing."""
    path = Path(_FOLDER.name) / f"{base}.yaml"
    path.write_text(f"extends: nominal\nname: {base}\ndescription: ''\nbase: {base}\n")
    return Pepper(f"mujoco://?plant={path}", observer=None, robot=ROBOT)


def limit_degrees(pepper: Pepper, joint: str) -> float:
    """Equivalent degrees that alone ask of a joint's board all it can hold."""
    plant, index = pepper.backend.plant, ROBOT.joint_index(joint)
    return float(np.degrees(plant.torque_limit[index] / plant.stiffness[index]))
