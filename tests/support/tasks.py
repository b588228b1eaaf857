"""A task on its own, away from any controller, and where things are by forward kinematics alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel, TargetError, Task
from pepper_driver.controller.tasks.task import TaskRows
from support.controller import JOINTS, ROBOT, random_posture

MODEL = RobotModel(ROBOT)
STEP = 1e-5
"""[s] Of central differences; their own error is below 1e-7 for the motions here."""


class State(NamedTuple):
    """Configuration and velocity."""

    q: FloatArray
    v: FloatArray


class Measured(NamedTuple):
    """Values of a task in a state."""

    error: FloatArray
    jacobian: FloatArray
    bias: FloatArray


def random_state(seed: int) -> State:
    """Any posture, the base anywhere and turned, everything in motion."""
    random = np.random.default_rng(seed)
    q = MODEL.configuration(random_posture(random))
    q = MODEL.with_base_pose(q, random.uniform([-2, -2, -np.pi], [2, 2, np.pi]))
    return State(q, random.uniform(-1.5, 1.5, 3 + JOINTS))


def later(state: State, time: float) -> State:
    """State that a motion without accelerations leads to."""
    return State(MODEL.integrate(state.q, state.v * time), state.v)


class Bench:
    """A task with rows of its own."""

    def __init__(self, task: Task) -> None:
        self.task, self.model = task, RobotModel(ROBOT)
        self.rows = TaskRows.empty(task.rows, self.model.nv)
        task.attach(self.model, self.rows)

    def at(self, state: State) -> Measured:
        self.model.set_state(state.q, state.v)
        self.model.update_kinematics()
        self.task.compute(self.model, self.rows)
        return Measured(
            *(part.copy() for part in (self.rows.error, self.rows.jacobian, self.rows.bias))
        )

    def rate(self, state: State) -> FloatArray:
        rate: FloatArray = self.at(state).jacobian @ state.v
        return rate

    def rate_changes(self, state: State) -> FloatArray:
        """d/dt (J v) without accelerations, by central differences: what the bias must be."""
        change: FloatArray = self.rate(later(state, STEP)) - self.rate(later(state, -STEP))
        return change / (2 * STEP)


def link_pose(state: State, link: str) -> FloatArray:
    """(4, 4) of a link in the world."""
    x, y, heading = MODEL.base_pose(state.q)
    base = np.eye(4)
    base[:3, :3] = Rotation.from_euler("z", heading).as_matrix()
    base[:2, 3] = x, y
    pose: FloatArray = base @ MODEL.link_pose(link, MODEL.joints_of_configuration(state.q))
    return pose


def seen(state: State, link: str, origin: str | None) -> FloatArray:
    """(4, 4) of a link in another, or in the world."""
    pose = link_pose(state, link)
    return pose if origin is None else np.linalg.inv(link_pose(state, origin)) @ pose


def turn(before: FloatArray, after: FloatArray) -> FloatArray:
    """(3,) rotation vector from one (3, 3) rotation to another, in the fixed axes."""
    vector: FloatArray = Rotation.from_matrix(after @ before.T).as_rotvec()
    return vector


def centre_of_mass(state: State) -> FloatArray:
    """(3,) in the world, body by body."""
    data = MODEL.pin.createData()
    pin.forwardKinematics(MODEL.pin, data, state.q)
    places = zip(MODEL.pin.inertias, data.oMi, strict=True)
    moments = [(body.mass, body.mass * placement.act(body.lever)) for body, placement in places]
    centre: FloatArray = sum(m for _, m in moments) / sum(mass for mass, _ in moments)
    return centre


def refused(task: Any, wrong: Any, words: str) -> None:
    """A target is refused in both ways to give one."""
    with pytest.raises(TargetError, match=words):
        task.target = wrong
    with pytest.raises(TargetError, match=words):
        task.move_to(wrong, 1.0)
