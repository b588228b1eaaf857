"""Frames: their rows against finite differences of forward kinematics; targets; what may move for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import FrameTask, OrientationTask, PositionTask, TargetError
from support.controller import DT, MIDDLE, ROBOT, controller
from support.tasks import STEP, Bench, State, later, link_pose, random_state, refused, seen, turn

POINT = np.array([0.03, -0.05, 0.08])
ORIGINS = [None, "base_link", "torso", "r_wrist"]
SEEDS = [0, 1, 2]


def place(state: State, origin: str | None) -> FloatArray:
    pose = seen(state, "l_wrist", origin)
    position: FloatArray = pose[:3, :3] @ POINT + pose[:3, 3]
    return position


def place_rate(state: State, origin: str | None) -> FloatArray:
    return (place(later(state, STEP), origin) - place(later(state, -STEP), origin)) / (2 * STEP)


def turn_rate(state: State, origin: str | None) -> FloatArray:
    before, after = (seen(later(state, time), "l_wrist", origin) for time in (-STEP, STEP))
    return turn(before[:3, :3], after[:3, :3]) / (2 * STEP)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("origin", ORIGINS)
def test_a_position_and_its_rows_are_those_of_forward_kinematics(
    origin: str | None, seed: int
) -> None:
    state = random_state(seed)
    task = PositionTask("l_wrist", POINT, root=origin)
    bench = Bench(task)
    task.target = target = np.array([0.3, 0.1, 0.7])
    measured = bench.at(state)
    np.testing.assert_allclose(measured.error, target - place(state, origin), atol=1e-12)
    np.testing.assert_allclose(bench.rate(state), place_rate(state, origin), atol=1e-8)
    np.testing.assert_allclose(measured.bias, bench.rate_changes(state), atol=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("origin", ORIGINS)
def test_an_orientation_and_its_rows_are_those_of_forward_kinematics(
    origin: str | None, seed: int
) -> None:
    state = random_state(seed)
    task = OrientationTask("l_wrist", root=origin)
    bench = Bench(task)
    target = Rotation.from_rotvec([0.4, -0.9, 0.6])
    task.target = target.as_quat()
    measured = bench.at(state)
    # The error is the turn that is left: made, it leads to the target, in the axes it is seen from.
    there = (
        Rotation.from_rotvec(measured.error).as_matrix() @ seen(state, "l_wrist", origin)[:3, :3]
    )
    np.testing.assert_allclose(there, target.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(bench.rate(state), turn_rate(state, origin), atol=1e-8)
    np.testing.assert_allclose(measured.bias, bench.rate_changes(state), atol=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("origin", ORIGINS)
def test_a_pose_and_its_rows_are_those_of_forward_kinematics(origin: str | None, seed: int) -> None:
    state = random_state(seed)
    task = FrameTask("l_wrist", POINT, root=origin)
    bench = Bench(task)
    target = Rotation.from_rotvec([-0.4, 0.9, 1.6])
    task.target = [0.3, 0.1, 0.7, *target.as_quat()]
    measured = bench.at(state)
    np.testing.assert_allclose(
        measured.error[:3], [0.3, 0.1, 0.7] - place(state, origin), atol=1e-12
    )
    rotation = seen(state, "l_wrist", origin)[:3, :3]
    np.testing.assert_allclose(measured.error[3:], turn(rotation, target.as_matrix()), atol=1e-9)
    expected = np.concatenate([place_rate(state, origin), turn_rate(state, origin)])
    np.testing.assert_allclose(bench.rate(state), expected, atol=1e-8)
    np.testing.assert_allclose(measured.bias, bench.rate_changes(state), atol=1e-6)


def test_the_base_does_not_show_in_what_is_seen_from_a_link() -> None:
    bench = Bench(FrameTask("l_wrist", POINT, root="torso"))
    measured = bench.at(random_state(4))
    np.testing.assert_allclose(measured.jacobian[:, :3], 0.0, atol=1e-12)
    assert np.abs(measured.jacobian[:, 3:]).max() > 0.1


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -2, 3]])
def test_half_a_turn_is_an_error_of_half_a_turn(axis: list[float]) -> None:
    state = random_state(5)
    task = OrientationTask("Head")
    bench = Bench(task)
    half = Rotation.from_rotvec(np.pi * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    task.target = half @ link_pose(state, "Head")[:3, :3]
    error = bench.at(state).error
    assert np.linalg.norm(error) == pytest.approx(np.pi, abs=1e-6)
    assert abs(error @ axis) == pytest.approx(np.pi * np.linalg.norm(axis), abs=1e-5)


@pytest.mark.parametrize("make", [PositionTask, OrientationTask, FrameTask])
@pytest.mark.parametrize("origin", [None, "torso"])
def test_without_a_target_a_frame_stays_where_it_is_first_seen(
    make: Callable[..., Any], origin: str | None
) -> None:
    task = make("l_wrist", root=origin)
    assert np.isnan(task.target).all()
    bench = Bench(task)
    first, second = random_state(6), random_state(7)
    np.testing.assert_allclose(bench.at(first).error, 0.0, atol=1e-9)
    assert np.abs(bench.at(second).error).max() > 0.01
    np.testing.assert_allclose(bench.at(first).error, 0.0, atol=1e-9)
    assert np.isfinite(task.target).all()


def test_a_target_is_a_copy() -> None:
    given = np.eye(4)
    task = FrameTask("l_wrist")
    task.target = given
    given[0, 3] = 5.0
    task.target[0, 3] = 6.0
    np.testing.assert_allclose(task.target, np.eye(4), atol=1e-12)
    bench = Bench(task)
    state = random_state(8)
    np.testing.assert_allclose(
        bench.at(state).error[:3], -link_pose(state, "l_wrist")[:3, 3], atol=1e-12
    )


@pytest.mark.parametrize(
    "wrong",
    [
        [0.1, np.nan, 0.2],
        [np.inf, 0.0, 0.0],
        [0.1, 0.2],
        np.zeros((1, 3)),
        0.3,
        None,
        "l_wrist",
        {"x": 0.1},
        [[0.1], [0.2, 0.3]],
    ],
)
def test_a_place_that_is_none_is_refused(wrong: Any) -> None:
    task = PositionTask("l_wrist")
    task.target = [0.1, 0.2, 0.3]
    refused(task, wrong, "position l_wrist")
    assert task.target.tolist() == [0.1, 0.2, 0.3]
    assert not task.has_reference


@pytest.mark.parametrize("make", [PositionTask, OrientationTask, FrameTask])
def test_names_that_are_none_are_refused(make: Callable[..., Any]) -> None:
    with pytest.raises(UnknownNameError, match="l_wrist"):
        make("l_wirst")
    with pytest.raises(UnknownNameError):
        make("l_wrist", root="LHand")
    with pytest.raises(UnknownNameError, match="LElbowYaw"):
        make("l_wrist", joints=["LElbowYwa"])


def test_a_point_that_is_none_is_refused() -> None:
    for wrong in ([0.1, np.nan, 0.0], [0.1], "tip"):
        with pytest.raises(TargetError, match="point"):
            PositionTask("l_wrist", wrong)


def test_only_selected_joints_move() -> None:
    control = controller()
    arm = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll")
    task = PositionTask("l_wrist", joints=arm)
    control.add(task)
    there = MIDDLE.copy()
    there[5:9] += [-0.3, 0.2, 0.3, -0.2]
    task.target = control.model.link_pose("l_wrist", there)[:3, 3]
    for _ in range(400):
        control.step()
    moved = {
        name
        for name, distance in zip(ROBOT.joint_names, np.abs(control.position - MIDDLE), strict=True)
        if distance > 1e-6
    }
    assert moved == set(arm)
    assert np.abs(control.base_pose).max() < 1e-9
    assert np.linalg.norm(task.error) < 0.01


@pytest.mark.parametrize("base", [False, True])
def test_the_base_moves_for_a_task_only_if_it_may(base: bool) -> None:
    control = controller()
    task = PositionTask("l_wrist", base=base)
    control.add(task)
    start = control.model.link_pose("l_wrist", MIDDLE)[:3, 3]
    task.target = start + np.array([0.6, 0.0, 0.0])
    for _ in range(800):
        control.step()
    if base:
        assert control.base_pose[0] > 0.2
        assert np.linalg.norm(task.error) < 0.01
    else:
        assert np.abs(control.base_pose).max() < 1e-9
        assert task.error[0] > 0.1


def test_an_axis_without_weight_is_free() -> None:
    def heights(weights: list[float]) -> tuple[FloatArray, float]:
        control = controller()
        task = PositionTask("l_wrist")
        control.add(task)
        task.dim_weight = weights
        target = control.model.link_pose("l_wrist", MIDDLE)[:3, 3]
        task.target = target + np.array([0.03, 0.02, 0.1])
        for _ in range(400):
            control.step()
        return task.error, control.model.link_pose("l_wrist", control.position)[2, 3] - target[2]

    error, rise = heights([1, 1, 0])
    assert np.abs(error[:2]).max() < 1e-3
    assert abs(rise) < 0.03
    error, rise = heights([1, 1, 1])
    assert rise == pytest.approx(0.1, abs=2e-3)


def test_two_hands_keep_their_distance_while_one_moves() -> None:
    """The right hand's pose relative to the left one stays, although only the left one has a new target."""
    control = controller()
    control.posture.weight = 1.0
    together = FrameTask("r_wrist", root="l_wrist")
    lead = PositionTask("l_wrist")
    control.add(together)
    control.add(lead)
    start = link_pose(State(control.model.q, control.model.v), "l_wrist")[:3, 3]
    control.step()
    relative = seen(State(control.model.q, control.model.v), "r_wrist", "l_wrist")
    lead.move_to(start + np.array([0.04, 0.0, 0.08]), 2.0)
    drift, turned = 0.0, 0.0
    for _ in range(round(2.5 / DT)):
        control.step()
        now = seen(State(control.model.q, control.model.v), "r_wrist", "l_wrist")
        drift = max(drift, float(np.linalg.norm(now[:3, 3] - relative[:3, 3])))
        turned = max(turned, float(np.linalg.norm(turn(relative[:3, :3], now[:3, :3]))))
    moved = link_pose(State(control.model.q, control.model.v), "l_wrist")[:3, 3] - start
    assert np.linalg.norm(moved) > 0.06
    assert drift < 0.004
    assert turned < 0.03
