"""Base pose and base velocity, and hands: rows, the shorter turn, limits, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.controller import (
    BasePoseTask,
    BaseVelocityTask,
    ComTask,
    FrameTask,
    HandTask,
    LookAtTask,
    MomentumTask,
    PositionTask,
    PostureTask,
    TargetError,
    Task,
    WholeBodyController,
)
from support.controller import (
    BASE_ACCELERATION,
    BASE_VELOCITY,
    DT,
    MIDDLE,
    ROBOT,
    controller,
)
from support.tasks import STEP, Bench, later, random_state, refused


def driver() -> tuple[WholeBodyController, BasePoseTask]:
    control, task = controller(), BasePoseTask()
    control.remove(control.base_velocity)
    control.add(task)
    return control, task


@pytest.mark.parametrize("seed", range(4))
def test_the_rows_of_a_base_pose_are_those_of_its_motion(seed: int) -> None:
    state = random_state(seed)
    task = BasePoseTask()
    bench = Bench(task)
    pose = bench.model.base_pose(state.q)
    task.target = pose + np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(bench.at(state).error, [0.3, -0.2, 0.5], atol=1e-12)
    before, after = (bench.model.base_pose(later(state, time).q) for time in (-STEP, STEP))
    np.testing.assert_allclose(bench.rate(state), (after - before) / (2 * STEP), atol=1e-8)
    np.testing.assert_allclose(bench.at(state).bias, bench.rate_changes(state), atol=1e-6)


@pytest.mark.parametrize("turns", [-2, 0, 1])
@pytest.mark.parametrize("turn", [3.0, -3.0, 0.5])
def test_the_base_turns_the_short_way(turn: float, turns: int) -> None:
    state = random_state(5)
    task = BasePoseTask()
    bench = Bench(task)
    task.target = bench.model.base_pose(state.q) + np.array([0, 0, turn + 2 * np.pi * turns])
    assert bench.at(state).error[2] == pytest.approx(turn, abs=1e-9)


def test_a_target_half_a_turn_away_is_turned_to_within_the_limits() -> None:
    control, task = driver()
    control.step()
    before = np.zeros(3)
    for heading in (np.pi, 0.0, -np.pi, np.pi - 0.01, -np.pi + 0.01):
        task.target = [0.0, 0.0, heading]
        for tick in range(800):
            twist = control.step().base_twist
            assert (np.abs(twist) <= BASE_VELOCITY + 1e-9).all()
            assert (np.abs(twist - before) <= BASE_ACCELERATION * DT + 1e-9).all()
            assert np.abs(twist[:2]).max() < 1e-6
            before = twist.copy()
            if abs(heading) == np.pi - 0.01 and heading < 0 and tick > 0:
                assert abs(twist[2]) < 0.1  # two hundredths over the seam, not nearly a turn back
        off = control.base_pose[2] - heading
        assert abs(np.arctan2(np.sin(off), np.cos(off))) < 2e-3
        assert task.reached(0.01)


def test_a_motion_of_the_base_takes_the_shorter_turn_and_ends_in_time() -> None:
    control, task = driver()
    task.move_to([0.0, 0.0, 3.0], 12.0)
    for _ in range(1010):
        control.step()
    assert task.reached(0.01)
    task.move_to([0.1, 0.05, -3.0], 2.0)
    for _ in range(round(2.0 / DT)):
        assert 0 <= control.step().base_twist[2] < 0.4
    np.testing.assert_allclose(control.base_pose, [0.1, 0.05, -3.0], atol=5e-3)
    control.step()
    control.step()
    np.testing.assert_allclose(task.target, [0.1, 0.05, -3.0], atol=1e-9)


@pytest.mark.parametrize("wrong", [[0, 0], [0, 0, np.nan], None, {"x": 1.0}, "home"])
def test_a_base_pose_that_is_none_is_refused(wrong: Any) -> None:
    task = BasePoseTask()
    assert np.isnan(task.target).all()
    task.target = [0.1, 0.2, 0.3]
    refused(task, wrong, "base pose")
    assert task.target.tolist() == [0.1, 0.2, 0.3]


def test_a_twist_is_reached_when_the_base_has_it() -> None:
    control = controller()
    task = control.base_velocity
    assert not task.reached(0.01)
    control.step()
    assert task.reached(0.01)
    task.target = [0.1, 0.0, -0.2]
    assert not task.reached(0.01)
    assert np.isnan(BaseVelocityTask().error).all()
    for _ in range(300):
        control.step()
    assert task.reached(0.01)
    assert not task.reached([1e-12, 1.0, 1.0])
    task.target = np.zeros(3)
    control.step()
    assert not task.reached(0.01)


def test_a_twist_has_no_target_to_move_to() -> None:
    control = controller()
    with pytest.raises(TargetError, match="no target to move to"):
        control.base_velocity.move_to([0.1, 0.0, 0.0], 1.0)
    control.step()


def test_a_hand_opens_and_closes() -> None:
    control = controller()
    task = HandTask("RHand")
    control.add(task)
    hand = ROBOT.joint_index("RHand")
    for aperture in (1.0, 0.0, 0.3):
        task.target = aperture
        for _ in range(400):
            control.step()
        assert control.position[hand] == pytest.approx(aperture, abs=0.02)
        assert np.delete(control.position - MIDDLE, hand) == pytest.approx(0.0, abs=1e-9)
    task.move_to({"RHand": 0.8}, 0.5)
    for _ in range(round(0.5 / DT)):
        control.step()
    assert control.position[hand] == pytest.approx(0.8, abs=5e-3)


@pytest.mark.parametrize(
    "wrong",
    [1.01, -0.01, np.nan, [0.1, 0.2], None, "open", {"RHand": 1.1}, [[0.1], [0.1, 0.2]], np.eye(1)],
)
def test_an_aperture_that_is_none_is_refused(wrong: Any) -> None:
    task = HandTask("RHand")
    task.target = [0.25]
    refused(task, wrong, r"Hand|posture")
    assert task.target.tolist() == [0.25]
    for one in (0.5, np.float64(0.5), np.array(0.5), [0.5]):
        assert task.checked(one).tolist() == [0.5]
    with pytest.raises(UnknownNameError):
        task.target = {"LHand": 0.5}
    with pytest.raises(UnknownNameError, match="RHand"):
        HandTask("Rhand")


BASES: list[Callable[[], Task]] = [
    lambda: PositionTask("l_gripper", base=True),
    lambda: FrameTask("l_gripper", base=True),
    lambda: ComTask(base=True),
    lambda: LookAtTask(base=True),
    lambda: MomentumTask(base=True),
    BasePoseTask,
]


def gains(control: WholeBodyController) -> list[float]:
    control.step()
    weights: list[float] = control.base_velocity.gains.weight.tolist()
    return weights


@pytest.mark.parametrize("make", BASES)
def test_the_base_has_less_weight_while_a_task_may_move_it(make: Callable[[], Task]) -> None:
    control, one, other = controller(), make(), make()
    full, relaxed = [1000.0] * 3, [10.0] * 3
    assert gains(control) == full
    control.add(one)
    control.add(other)
    assert gains(control) == relaxed
    assert control.base_velocity.weight == 1000.0
    control.hold = True
    control.step()
    control.hold = False
    assert gains(control) == relaxed
    control.remove(one)
    assert gains(control) == relaxed
    control.remove(other)
    assert gains(control) == full


def test_a_commanded_drive_keeps_its_weight() -> None:
    control = controller()
    control.add(PositionTask("l_gripper", base=True))
    assert gains(control) == [10.0] * 3
    control.base_velocity.target = [0.0, 0.0, 0.2]
    assert gains(control) == [1000.0] * 3
    control.base_velocity.weight = 500.0
    assert gains(control) == [500.0] * 3
    control.base_velocity.target = np.zeros(3)
    assert gains(control) == [5.0] * 3
    control.base_velocity.weight = 2000.0
    control.base_velocity.dim_weight = [1.0, 0.5, 0.0]
    assert gains(control) == [20.0, 10.0, 0.0]


def test_tasks_that_may_not_move_the_base_leave_it_held() -> None:
    control = controller()
    for task in (PositionTask("l_wrist"), PostureTask(), MomentumTask(), BaseVelocityTask()):
        control.add(task)
    assert gains(control) == [1000.0] * 3


def test_a_place_out_of_reach_takes_the_base_and_nothing_else() -> None:
    control = controller()
    task = PositionTask("l_gripper", base=True)
    control.add(task)
    task.move_to([1.0, 0.35, 0.85], 5.0)
    for _ in range(800):
        control.step()
    assert task.reached(0.005)
    assert control.base_pose[0] > 0.3
    control.posture.target = control.position
    control.remove(task)
    stood = control.base_pose
    for _ in range(300):
        twist = control.step().base_twist
    np.testing.assert_allclose(control.base_pose, stood, atol=5e-3)
    assert np.abs(twist).max() < 1e-4
