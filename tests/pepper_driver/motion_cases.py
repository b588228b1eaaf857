"""Motions to be played, and Peppers to play them: joints that are where they are sent, and nothing else."""

from collections.abc import Callable
from typing import Any

from pepper_driver import Pepper
from pepper_driver.config import Motion, load_robot
from pepper_driver.config.loading import parse
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.observer import Observation

ROBOT = load_robot()
YAW = ROBOT.joint_index("HeadYaw")
PITCH = ROBOT.joint_index("HeadPitch")
ARM = ["LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll", "LWristYaw"]
PLACE = [0.25, 0.2, 0.85]
REACH = {"link": "l_wrist", "root": "base_link", "target": PLACE, "joints": ARM}


def make_motion(*steps: dict[str, Any], **more: Any) -> Motion:
    return parse(Motion, {"schema": 1, "name": "mine", "steps": list(steps), **more}, "mine.yaml")


def make_pepper() -> Pepper:
    """A Pepper whose joints are where they are sent."""
    return Pepper("mock", observer=None)


def wrist(pepper: Pepper, link: str = "l_wrist") -> FloatArray:
    """(3,) in base_link, from the joints alone."""
    return pepper.controller.model.link_pose(link, pepper.controller.position)[:3, 3]


class Trace:
    """One number after each tick."""

    def __init__(self, value: Callable[[], float]) -> None:
        self.values: list[float] = []
        self._value = value

    def __call__(self, tick: Tick, observation: Observation | None) -> None:
        self.values.append(self._value())


def snapshot(pepper: Pepper) -> tuple[object, ...]:
    own = pepper.controller.base_velocity
    return (
        pepper.controller.tasks,
        own.weight,
        own.target.tolist(),
        pepper.controller.posture.weight,
    )
