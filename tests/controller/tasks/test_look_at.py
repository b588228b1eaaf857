"""Look-at: its rows against finite differences; final line of sight; difficult targets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import LookAtTask, TargetError, WholeBodyController
from support.controller import DT, MIDDLE, ROBOT, controller
from support.tasks import STEP, Bench, State, later, link_pose, random_state, refused, turn

AXIS = np.array([0.8, -0.1, 0.3])
EYE = np.array([0.05, 0.02, 0.1])
POINT = np.array([0.02, -0.03, 0.05])
WORLD = np.array([1.5, -0.7, 1.4])


def gaze(target_link: str | None) -> LookAtTask:
    task = LookAtTask(axis=AXIS, eye=EYE, target_link=target_link)
    task.target = WORLD if target_link is None else POINT
    return task


def place(state: State, target_link: str | None) -> FloatArray:
    if target_link is None:
        return WORLD
    pose = link_pose(state, target_link)
    position: FloatArray = pose[:3, :3] @ POINT + pose[:3, 3]
    return position


def line_to_target(state: State, target_link: str | None) -> FloatArray:
    """(3,) from the eye to the target, in the axes of the head."""
    head = link_pose(state, "Head")
    there: FloatArray = head[:3, :3].T @ (place(state, target_link) - head[:3, 3]) - EYE
    return there


def angle(state: State, target_link: str | None) -> float:
    direction = line_to_target(state, target_link)
    sine = np.linalg.norm(np.cross(AXIS, direction))
    return float(np.arctan2(sine, AXIS @ direction))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("target_link", [None, "l_wrist"])
def test_the_error_is_the_turn_that_is_left(target_link: str | None, seed: int) -> None:
    state = random_state(seed)
    bench = Bench(gaze(target_link))
    error, jacobian, bias = bench.at(state)
    assert np.linalg.norm(error) == pytest.approx(angle(state, target_link), abs=1e-9)
    # Turned by it, the axis points at the target.
    vector = error @ bench.task._axes[:2]  # type: ignore[attr-defined]
    pointed = Rotation.from_rotvec(vector).apply(AXIS / np.linalg.norm(AXIS))
    direction = line_to_target(state, target_link)
    np.testing.assert_allclose(pointed, direction / np.linalg.norm(direction), atol=1e-9)
    # The angle that is left shrinks by the rows along the error.
    before, after = (angle(later(state, time), target_link) for time in (-STEP, STEP))
    shrinks = jacobian @ state.v @ error / np.linalg.norm(error)
    assert shrinks == pytest.approx(-(after - before) / (2 * STEP), abs=1e-7)
    # The rows' change, in axes that do not turn about the line of sight.
    first, second, twist = relative_turn(state, target_link)
    carried = twist * np.array([-second, first])
    np.testing.assert_allclose(bias, bench.rate_changes(state) + carried, atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("target_link", [None, "l_wrist"])
def test_both_rows_are_the_turn_relative_to_the_way(target_link: str | None, seed: int) -> None:
    state = random_state(10 + seed)
    rate = Bench(gaze(target_link)).rate(state)
    np.testing.assert_allclose(rate, relative_turn(state, target_link)[:2], atol=1e-7)


def relative_turn(state: State, target_link: str | None) -> FloatArray:
    """(3,) the head's turn minus the turn of the line to the target, by finite differences, in the axes of the eye."""
    heads = [link_pose(later(state, time), "Head")[:3, :3] for time in (-STEP, 0.0, STEP)]
    lines = [
        head @ line_to_target(later(state, time), target_link)
        for head, time in zip(heads, (-STEP, 0.0, STEP), strict=True)
    ]
    lines = [w / np.linalg.norm(w) for w in lines]
    head = turn(heads[0], heads[2]) / (2 * STEP)
    sight = np.cross(lines[1], (lines[2] - lines[0]) / (2 * STEP))
    axes = gaze(target_link)._axes
    turned: FloatArray = axes @ heads[1].T @ (head - sight)
    return turned


def line_of_sight(control: WholeBodyController) -> tuple[FloatArray, FloatArray]:
    """Position of the head and its x axis in the world."""
    head = link_pose(State(control.model.q, control.model.v), "Head")
    return head[:3, 3], head[:3, 0]


def test_the_head_alone_looks_at_a_place_while_the_robot_drives() -> None:
    control = controller()
    task = LookAtTask(joints=("HeadYaw", "HeadPitch"))
    task.target = target = np.array([2.0, 0.8, 1.0])
    control.add(task)
    control.base_velocity.target = [0.1, 0.0, 0.2]
    for tick in range(300):
        control.step()
        if tick > 200:
            eye, axis = line_of_sight(control)
            direction = (target - eye) / np.linalg.norm(target - eye)
            assert np.arccos(axis @ direction) < 0.01
    head = [ROBOT.joint_index(name) for name in ("HeadYaw", "HeadPitch")]
    moved = np.abs(control.position - MIDDLE)
    assert moved[head].min() > 0.01
    assert np.delete(moved, head).max() < 1e-9


def test_the_head_follows_the_own_hand() -> None:
    control = controller()
    task = LookAtTask(target_link="l_wrist", joints=("HeadYaw", "HeadPitch"))
    control.add(task)
    for _ in range(250):
        control.step()
    control.posture.move_to({"LShoulderPitch": 0.1, "LShoulderRoll": 0.3, "LElbowRoll": -1.3}, 2.0)
    yaw = control.position[3]
    for _ in range(200):
        control.step()
        eye, axis = line_of_sight(control)
        hand = link_pose(State(control.model.q, control.model.v), "l_wrist")[:3, 3]
        assert axis @ (hand - eye) / np.linalg.norm(hand - eye) > np.cos(0.1)
    assert abs(control.position[3] - yaw) > 0.1
    for _ in range(200):
        control.step()
    assert np.linalg.norm(task.error) < 1e-3


def test_without_a_target_it_goes_on_looking_where_it_looks() -> None:
    control = controller()
    task = LookAtTask()
    assert np.isnan(task.target).all()
    eye, axis = line_of_sight(control)
    control.add(task)
    control.step()
    np.testing.assert_allclose(task.target, eye + axis, atol=1e-9)
    assert task.reached(1e-6)


@pytest.mark.parametrize("distance", [0.0, 1e-9, 0.01, 0.049])
def test_a_target_in_the_eye_holds_the_line_of_sight(distance: float) -> None:
    state = random_state(3)
    bench = Bench(gaze(None))
    head = link_pose(state, "Head")
    eye = head[:3, :3] @ EYE + head[:3, 3]
    bench.task.target = eye + np.array([0.0, 0.0, distance])  # type: ignore[attr-defined]
    error, jacobian, bias = bench.at(state)
    assert not error.any()
    before, after = (link_pose(later(state, time), "Head")[:3, :3] for time in (-STEP, STEP))
    axes = bench.task._axes[:2]  # type: ignore[attr-defined]
    expected = axes @ head[:3, :3].T @ turn(before, after) / (2 * STEP)
    np.testing.assert_allclose(jacobian @ state.v, expected, atol=1e-7)
    assert np.isfinite(bias).all()


def test_a_target_behind_is_looked_at_by_a_turn() -> None:
    control = controller()
    task = LookAtTask(joints=("HeadYaw", "HeadPitch"), base=True)
    control.add(task)
    eye, axis = line_of_sight(control)
    task.target = eye - axis
    control.step()
    assert np.linalg.norm(task.error) == pytest.approx(np.pi, abs=1e-6)
    for _ in range(2000):
        assert np.isfinite(control.step().position).all()
        assert control.status.solver == "solved"
    eye, axis = line_of_sight(control)
    assert axis @ (task.target - eye) > 0


@pytest.mark.parametrize("target_link", [None, "r_wrist"])
def test_a_gaze_moves_to_a_target_along_its_way(target_link: str | None) -> None:
    control = controller()
    control.posture.weight = 1e-3
    task = LookAtTask(target_link=target_link)
    control.add(task)
    control.posture.move_to({"RShoulderRoll": -0.4, "RElbowRoll": 1.2, "HipPitch": -0.1}, 1.5)
    for _ in range(50):
        control.step()
    end = [1.0, 0.5, 0.9] if target_link is None else [0.0, 0.1, 0.05]
    task.move_to(end, 1.2)
    late = 0.0
    for _ in range(round(1.2 / DT)):
        control.step()
        late = max(late, float(np.abs(task.error).max()))
    control.step()
    assert late < 2e-3
    assert task.reached(2e-3)
    assert task.target.tolist() == end


@pytest.mark.parametrize("wrong", [[0, 0], [0, np.nan, 0], None, "me", np.eye(3)])
def test_a_target_that_is_none_is_refused(wrong: Any) -> None:
    task = gaze(None)
    refused(task, wrong, "look-at")
    assert np.array_equal(task.target, WORLD)


def test_a_look_at_that_makes_no_sense_is_refused() -> None:
    with pytest.raises(UnknownNameError):
        LookAtTask("head")
    with pytest.raises(UnknownNameError):
        LookAtTask(target_link="hand")
    with pytest.raises(UnknownNameError):
        LookAtTask(joints=["Head"])
    with pytest.raises(TargetError, match="own"):
        LookAtTask(target_link="Head")
    for axis in ([0, 0, 0], [1, 0], [np.nan, 0, 0]):
        with pytest.raises(TargetError, match="axis"):
            LookAtTask(axis=axis)
    with pytest.raises(TargetError, match="eye"):
        LookAtTask(eye=[0.0])
