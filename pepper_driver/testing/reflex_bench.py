"""Reflexes without a robot and a loop: a controller that really moves, contacts and torques made by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pepper_driver.backends.mock import MockBackend
from pepper_driver.callbacks.events import ReflexEvent
from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.observer import Contact, JointState, Observation
from pepper_driver.observer.interface import Phase
from pepper_driver.reflexes import Arbiter, Reflex, prepare_reflexes

TORQUE_STD = 0.2
"""[N m] Standard deviation of every external torque."""


def make_contact(number: int = 1, phase: Phase = "begin", **changes: Any) -> Contact:  # noqa: ANN401
    """Return a contact of 3 degrees on the left upper arm, unless ``changes`` say otherwise; ``number`` is its id."""
    values: dict[str, Any] = {
        "id": number,
        "phase": phase,
        "kind": "contact",
        "limb": load_robot().limb_of(changes.get("joint", "LShoulderRoll")),
        "joint": "LShoulderRoll",
        "shown_by": "LShoulderRoll",
        "link": "LBicep",
        "direction": 1,
        "intensity_deg": 3.0,
        "torque": None,
        "torque_std": None,
        "onset_time": 0.0,
        "detection_time": 0.0,
        "time": 0.0,
    }
    return Contact(**{**values, **changes})


class ReflexBench:
    """Arbiter and reflexes on a controller; joints are where they are sent.

    Args:
        reflexes: To be tried.
        robot: Description of the robot, by default the shipped Pepper.

    Attributes:
        controller: Standing at first.
        reflexes: In the order of their priority.
        arbiter: Decides between them, user and motion.
        tick: Number of ticks so far.
        events: Begin and end of reflexes so far.
        own_tasks: The tasks that the controller had at first.

    Raises:
        PepperError: The link or joint of a reflex does not exist.
    """

    def __init__(self, *reflexes: Reflex, robot: RobotConfig | None = None) -> None:
        self._robot = robot or load_robot()
        self._still = MockBackend(self._robot).open()
        self.controller = WholeBodyController(self._robot)
        self.controller.reset(self._robot.posture("Stand"))
        self.reflexes = prepare_reflexes(reflexes, self._robot)
        self.arbiter = Arbiter(self.controller, self._robot, self.reflexes)
        self.tick = 0
        self.events: list[ReflexEvent] = []
        self.own_tasks = set(self.controller.tasks)

    @property
    def time(self) -> float:
        """Clock of the robot [s]."""
        return self.tick * self._robot.cycle

    def step(self, *contacts: Contact, torque: Mapping[str, float] | None = None) -> FloatArray:
        """Make one tick with these contacts and external torques [N m]; (17,) joint positions [rad] after it."""
        robot, count = self._robot, len(self._robot.joint_names)
        external_torque, state = np.zeros(count), np.full(count, JointState.FREE, dtype=np.int8)
        for name, value in (torque or {}).items():
            external_torque[robot.joint_index(name)] = value
            state[robot.joint_index(name)] = JointState.CONTACT
        observation = Observation(
            contacts=contacts,
            expected=np.zeros(count),
            residual=np.zeros(count),
            threshold=np.ones(count),
            torque=external_torque,
            torque_std=np.full(count, TORQUE_STD),
            state=state,
        )
        measurement = replace(self._still, time=self.time, position=self.controller.position)
        self.events += self.arbiter.step(observation, measurement)
        self.tick += 1
        return self.controller.step().position

    def run(self, seconds: float, torque: Mapping[str, float] | None = None) -> FloatArray:
        """Run without events for a time [s]; return (ticks, 17) joint positions [rad]."""
        ticks = round(seconds / self._robot.cycle)
        return np.array([self.step(torque=torque) for _ in range(ticks)])
