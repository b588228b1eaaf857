"""Every task alone: a reachable target is approached by the critically damped law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import (
    BasePoseTask,
    ComTask,
    FrameTask,
    HandTask,
    LookAtTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    Task,
    WholeBodyController,
)
from support.controller import DT, MIDDLE, ROBOT, SETTINGS
from support.tasks import MODEL, State, centre_of_mass, link_pose

THERE = MIDDLE + np.where(np.arange(17) % 2, 0.12, -0.1)
STIFFNESS = 4.0


def state_there(base: FloatArray | None = None) -> State:
    q = MODEL.configuration(THERE)
    return State(q if base is None else MODEL.with_base_pose(q, base), np.zeros(20))


def alone(task: Task, start: FloatArray = MIDDLE, dt: float = DT) -> WholeBodyController:
    """A controller with nothing else to do."""
    control = WholeBodyController(ROBOT, SETTINGS, dt=dt)
    control.reset(start)
    for own in control.tasks:
        control.remove(own)
    control.add(task)
    return control


def relative_target() -> FloatArray:
    state = state_there()
    target: FloatArray = np.linalg.inv(link_pose(state, "Head")) @ link_pose(state, "r_wrist")
    return target


def cases() -> dict[str, Callable[[], tuple[Any, Any]]]:
    """A task and a target for it that some posture near the middle has."""
    k: Any = {"stiffness": STIFFNESS}
    wrist = link_pose(state_there(), "l_wrist")
    moved = np.array([0.05, -0.03, 0.1])
    return {
        "posture": lambda: (PostureTask(**k), THERE),
        "hand": lambda: (HandTask("LHand", **k), 0.3),
        "position": lambda: (PositionTask("l_wrist", **k), wrist[:3, 3]),
        "position with base": lambda: (
            PositionTask("l_wrist", [0.02, 0, 0], base=True, **k),
            wrist[:3, 3],
        ),
        "orientation": lambda: (OrientationTask("l_wrist", **k), wrist[:3, :3]),
        "pose": lambda: (FrameTask("l_wrist", **k), wrist),
        "relative pose": lambda: (
            FrameTask("r_wrist", root="Head", **k),
            relative_target(),
        ),
        "centre of mass": lambda: (ComTask(**k), centre_of_mass(state_there())),
        "centre of mass from base": lambda: (
            ComTask(root="base_link", **k),
            centre_of_mass(state_there()),
        ),
        "base pose": lambda: (BasePoseTask(**k), moved),
        "look-at": lambda: (LookAtTask(**k), [1.0, 0.3, 1.1]),
        "look-at own hand": lambda: (LookAtTask(target_link="r_wrist", **k), [0, 0, 0.4]),
    }


@pytest.mark.parametrize("name", cases())
def test_a_target_is_approached_by_the_law(name: str) -> None:
    """(1 + w t) exp(-w t) of the first error, once the limits of acceleration let the motion begin."""
    task, target = cases()[name]()
    dt = DT / 4
    control = alone(task, dt=dt)
    task.target = target
    errors = []
    for _ in range(round(3.0 / dt)):
        control.step()
        # The axes of a line of sight may turn about it: the law is that of the angle.
        errors.append([np.linalg.norm(task.error)] if "look-at" in name else task.error)
        assert not control.status.at_limit
    w, time = np.sqrt(STIFFNESS), dt * np.arange(len(errors))
    first = np.array(errors[0])
    expected = ((1 + w * time) * np.exp(-w * time))[:, None] * first
    assert np.linalg.norm(first) > 0.004
    assert np.abs(np.array(errors) - expected).max() < 0.02 * np.linalg.norm(first)


@pytest.mark.parametrize("name", cases())
def test_move_to_arrives_in_time_and_at_rest(name: str) -> None:
    task, target = cases()[name]()
    control = alone(task)
    control.step()
    duration = 1.5
    task.move_to(target, duration)
    late = 0.0
    for tick in range(round(duration / DT)):
        control.step()
        assert not task.reached(10.0)
        if tick > 0:
            late = max(late, float(np.abs(task.error).max()))
    # What holding an acceleration for a cycle is off by; most where the eye and a near hand both move.
    assert late < (5e-3 if name == "look-at own hand" else 5e-4)
    control.step()
    assert task.reached(3e-3)
    assert not task.has_reference
    assert np.array_equal(task.reference_velocity, np.zeros(task.rows))
    checked = task.checked(target)
    np.testing.assert_allclose(task.target, checked, atol=1e-9)


@pytest.mark.parametrize("name", cases())
def test_a_motion_that_starts_in_motion_starts_without_a_jump(name: str) -> None:
    task, target = cases()[name]()
    control = alone(task)
    task.target = target
    for _ in range(25):
        before = control.step()
    moving = float(np.abs([*before.velocity, *before.base_twist]).max())
    assert moving > 1e-3
    task.move_to(target, 1.0)
    after = control.step()
    jump = np.abs(after.velocity - before.velocity).max()
    assert jump < 0.05 * max(moving, 0.2)
    for _ in range(round(1.0 / DT)):
        control.step()
    assert task.reached(5e-3)


def test_a_posture_follows_the_spline_of_least_jerk() -> None:
    task = PostureTask()
    control = alone(task)
    duration = 1.2
    task.move_to(THERE, duration)
    for tick in range(1, 101):
        position = control.step().position
        s = tick * DT / duration
        expected = MIDDLE + (THERE - MIDDLE) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        assert np.abs(position - expected).max() < 2e-4


def test_a_posture_passes_its_targets_without_stopping() -> None:
    task = PostureTask()
    control = alone(task)
    half = (MIDDLE + THERE) / 2
    task.move_through([half, THERE, half, MIDDLE], [0.6, 0.6, 0.6, 0.6])
    speeds = []
    for tick in range(1, 201):
        reference = control.step()
        speeds.append(np.abs(reference.velocity).max())
        if tick == 50:
            assert np.abs(reference.position - half).max() < 1e-3
            assert speeds[-1] > 0.05
        if tick == 100:
            assert np.abs(reference.position - THERE).max() < 1e-3
    assert np.abs(reference.position - MIDDLE).max() < 1e-3
    assert speeds[-1] < 1e-3


def test_joints_that_a_target_does_not_name_stay_where_the_one_before_had_them() -> None:
    task = PostureTask()
    control = alone(task)
    task.target = MIDDLE
    task.move_through([{"HeadYaw": 0.3}, {"LElbowYaw": -0.2}], [0.5, 0.5])
    for _ in range(100):
        control.step()
    expected = MIDDLE.copy()
    expected[[ROBOT.joint_index("HeadYaw"), ROBOT.joint_index("LElbowYaw")]] = 0.3, -0.2
    np.testing.assert_allclose(task.target, expected, atol=1e-9)
