"""Peppers to be pushed: the nominal plant on a base that stands fast, and on one that rolls and tips."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from pepper_driver.config import Experiment, load_robot
from pepper_driver.config.loading import parse
from pepper_driver.observer import Contact
from pepper_driver.robot import Pepper

ROBOT = load_robot()

PUSHED_ARMS = parse(
    Experiment,
    {
        "schema": 2,
        "name": "pushed arms",
        "plant": "integral",
        "stiffness": 5.0,
        "steps": [
            {
                "setpoints": {
                    "joints": ["LShoulderRoll", "RElbowRoll"],
                    "secondary_joints": ["LElbowRoll", "RShoulderRoll"],
                    "range": 0.75,
                    "secondary_range": 0.3,
                    "period": 7.968,
                    "count": 6,
                }
            }
        ],
        "contacts": [
            {
                "kind": "random_pushes",
                "times": [0.25, 5.0],
                "jitter": 0.4,
                "joints": ["LShoulderRoll", "RElbowRoll"],
                "degrees": [2.5, 6.0],
                "duration": [0.5, 1.2],
                "points": {
                    "LShoulderRoll": {"link": "LBicep", "xyz": [0.16, 0.015, 0.0]},
                    "RElbowRoll": {"link": "RForeArm", "xyz": [0.14, 0.0, 0.0]},
                },
            }
        ],
    },
    "pushed arms",
)
"""Random set-points of both arms, with one push in motion and one at rest in every period."""

_FOLDER = TemporaryDirectory()  # removed when the tests are over


def make_pepper(base: Literal["fixed", "rolling"] = "fixed") -> Pepper:
    """A Pepper without an observer."""
    path = Path(_FOLDER.name) / f"{base}.yaml"
    path.write_text(f"extends: nominal\nname: {base}\ndescription: ''\nbase: {base}\n")
    return Pepper(f"mujoco://?plant={path}", observer=None, robot=ROBOT)


def limit_degrees(pepper: Pepper, joint: str) -> float:
    """Equivalent degrees that alone ask of a joint's board all it can hold."""
    plant, index = pepper.backend.plant, ROBOT.joint_index(joint)
    return float(np.degrees(plant.torque_limit[index] / plant.stiffness[index]))


def joints_of_a_push(pepper: Pepper) -> list[str | None]:
    """Joints of the contacts that a program receives while a robot raises its left arm and is pushed on it."""
    received: list[Contact] = []
    with pepper:
        pepper.on_contact()(received.append)
        pepper.set_posture({"LShoulderRoll": 0.6}, duration=1.5)
        pepper.run(2.5)
        pepper.push("LBicep", [0.0, 30.0, 0.0], point=[0.16, 0.0, 0.0], duration=1.0)
        pepper.run(1.5)
    return [contact.joint for contact in received]
