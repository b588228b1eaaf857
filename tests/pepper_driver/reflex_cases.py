"""A scene for reflexes: a controller that really moves, contacts and torques made by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from fakes import quiet

from pepper_driver.callbacks.events import ReflexEvent
from pepper_driver.config import load_robot
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import WholeBodyController
from pepper_driver.observer import Contact, JointState, Observation
from pepper_driver.reflexes import Arbiter, Reflex, prepare_reflexes

ROBOT = load_robot()
BLANK = quiet()
ROLL = ROBOT.joint_index("LShoulderRoll")
ARM = [ROBOT.joint_index(name) for name in ROBOT.chains["left_arm"]]
STD = 0.2


def touch(number: int = 1, phase: Any = "begin", **changes: Any) -> Contact:
    """On the left upper arm, unless said otherwise."""
    values: dict[str, Any] = {
        "id": number,
        "phase": phase,
        "kind": "contact",
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "direction": 1,
        "intensity": 3.0,
        "torque": None,
        "torque_std": None,
        "onset_time": 0.0,
        "detection_time": 0.0,
        "time": 0.0,
    }
    return Contact(**{**values, **changes})


class Stage:
    """Arbiter and reflexes on a controller without a robot and a loop; joints are where they are sent."""

    def __init__(self, *reflexes: Reflex) -> None:
        self.controller = WholeBodyController(ROBOT)
        self.controller.reset(ROBOT.posture("Stand"))
        self.reflexes = prepare_reflexes(reflexes, ROBOT)
        self.arbiter = Arbiter(self.controller, ROBOT, self.reflexes)
        self.tick = 0
        self.events: list[ReflexEvent] = []
        self.own_tasks = set(self.controller.tasks)

    @property
    def time(self) -> float:
        return self.tick * ROBOT.cycle

    def step(self, *contacts: Contact, torque: Mapping[str, float] | None = None) -> FloatArray:
        """One tick with these contacts and external torques [N m]; (17,) joint positions [rad] after it."""
        felt, state = np.zeros(17), np.full(17, JointState.FREE, dtype=np.int8)
        for name, value in (torque or {}).items():
            felt[ROBOT.joint_index(name)] = value
            state[ROBOT.joint_index(name)] = JointState.CONTACT
        observation = Observation(
            contacts=contacts,
            expected=np.zeros(17),
            residual=np.zeros(17),
            threshold=np.ones(17),
            torque=felt,
            torque_std=np.full(17, STD),
            state=state,
        )
        measurement = replace(BLANK, time=self.time, position=self.controller.position)
        self.events += self.arbiter.step(observation, measurement)
        self.tick += 1
        return self.controller.step().position

    def run(self, seconds: float, torque: Mapping[str, float] | None = None) -> FloatArray:
        """As long without events; (ticks, 17) joint positions [rad]."""
        return np.array([self.step(torque=torque) for _ in range(round(seconds / ROBOT.cycle))])
