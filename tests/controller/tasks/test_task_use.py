"""Using tasks: when a target is reached, motions cut short, tasks that come and go, and calls that make no sense."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import (
    BasePoseTask,
    ComTask,
    FrameTask,
    GainError,
    HandTask,
    LookAtTask,
    MomentumTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    TargetError,
    Task,
    WholeBodyController,
)
from support.controller import ACCELERATION, DT, MIDDLE, ROBOT, SETTINGS, VELOCITY, controller


def every_task() -> list[Task]:
    return [
        PostureTask(),
        HandTask("LHand"),
        PositionTask("l_wrist"),
        OrientationTask("l_wrist"),
        FrameTask("l_wrist", root="torso"),
        ComTask(),
        BasePoseTask(),
        LookAtTask(),
        MomentumTask(),
    ]


def reaching() -> tuple[WholeBodyController, PositionTask, FloatArray]:
    """A controller with a wrist at rest, and a place near it."""
    control, task = controller(), PositionTask("l_wrist")
    control.posture.weight = 0.1
    control.add(task)
    control.step()
    there = MIDDLE.copy()
    there[5:9] += [-0.3, 0.2, 0.3, -0.2]
    return control, task, control.model.link_pose("l_wrist", there)[:3, 3]


@pytest.mark.parametrize("task", every_task(), ids=lambda task: str(task.name))
def test_before_the_first_cycle_nothing_is_known(task: Task) -> None:
    assert np.isnan(task.error).all()
    assert task.error.shape == (task.rows,)
    assert not task.reached(1e9)
    control = controller()
    control.add(task)
    assert np.isnan(task.error).all()
    assert not task.reached(1e9)
    control.step()
    assert np.isfinite(task.error).all()


def test_a_target_just_set_is_not_reached_by_the_error_of_the_one_before() -> None:
    control, task, there = reaching()
    assert task.reached(1e-3)
    task.target = there
    assert not task.reached(1e-3)
    waited = 0
    while not task.reached(1e-3):
        control.step()
        waited += 1
        assert waited < 1000
    assert waited > 50
    assert np.linalg.norm(task.error) <= 2e-3
    assert (
        np.linalg.norm(control.model.link_pose("l_wrist", control.position)[:3, 3] - there) < 3e-3
    )


def test_passing_by_is_not_reaching() -> None:
    """An underdamped task swings through its target at full speed."""
    control = controller()
    control.posture.damping = 0.2
    control.posture.target = MIDDLE + 0.2
    passed = False
    for _ in range(300):
        control.step()
        if np.abs(control.posture.error).max() < 0.01:
            passed = True
            assert not control.posture.reached(0.01)
            break
    assert passed


def test_a_row_that_is_not_asked_for_need_not_be_reached() -> None:
    control, task, there = reaching()
    task.dim_weight = [1, 1, 0]
    task.target = there + np.array([0.0, 0.0, 0.5])
    for _ in range(600):
        control.step()
    assert abs(task.error[2]) > 0.1
    assert task.reached(5e-3)
    assert task.reached([5e-3, 5e-3, 1e-9])
    assert not task.reached([5e-3, 1e-12, 1.0])


def test_other_tasks_that_come_and_go_do_not_change_what_is_known() -> None:
    control, task, there = reaching()
    task.target = there
    for _ in range(20):
        control.step()
    error = task.error
    other = HandTask("RHand")
    for change in (control.add, control.remove):
        change(other)
        assert np.array_equal(task.error, error)
        assert not task.reached(1e-3)
        assert task.reached(10.0)
    before = control.velocity
    control.step()
    assert (np.abs(control.velocity - before) <= ACCELERATION * DT + 1e-9).all()
    assert np.linalg.norm(task.error) < np.linalg.norm(error)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, [1e-3, 1e-3], "near", None, [1, 2, 0]])
def test_a_tolerance_that_is_none_is_refused(wrong: Any) -> None:
    _, task, _ = reaching()
    for asked in (task, MomentumTask()):
        with pytest.raises(TargetError, match="tolerance"):
            asked.reached(wrong)


@pytest.mark.parametrize("task", every_task()[:-1], ids=lambda task: str(task.name))
@pytest.mark.parametrize("duration", [0.0, -1.0, 1e-4, np.nan, np.inf, None, "1 s", [1.0]])
def test_a_duration_that_is_none_is_refused(task: Task, duration: Any) -> None:
    control = controller()
    control.add(task)
    control.step()
    target = task.target  # type: ignore[attr-defined]
    with pytest.raises(TargetError):
        task.move_to(target, duration)
    with pytest.raises(TargetError):
        task.move_through([target, target], [1.0, duration])
    assert not task.has_reference
    assert np.array_equal(task.target, target)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("targets", "durations"),
    [
        ([], []),
        ([[0, 0, 1]], []),
        ([[0, 0, 1]], [1.0, 1.0]),
        (None, None),
        (3, 1.0),
        ([None], [1.0]),
    ],
)
def test_ways_that_make_no_sense_are_refused(targets: Any, durations: Any) -> None:
    task = PositionTask("l_wrist")
    with pytest.raises(TargetError):
        task.move_through(targets, durations)
    assert not task.has_reference


@pytest.mark.parametrize("make", [PostureTask, ComTask, LookAtTask, MomentumTask])
@pytest.mark.parametrize("gain", ["stiffness", "weight"])
@pytest.mark.parametrize("wrong", [-1.0, np.nan, np.inf, "high", None])
def test_gains_that_are_none_are_refused(make: Any, gain: str, wrong: Any) -> None:
    with pytest.raises(GainError, match=gain):
        make(**{gain: wrong})
    task = make()
    before = getattr(task, gain)
    with pytest.raises(GainError, match=gain):
        setattr(task, gain, wrong)
    assert getattr(task, gain) == before


def test_a_target_ends_a_motion() -> None:
    control, task, there = reaching()
    task.move_to(there, 3.0)
    for _ in range(100):
        control.step()
    assert task.reference_velocity.any()
    task.target = there
    assert not task.has_reference
    assert not task.reference_velocity.any()
    for _ in range(500):
        control.step()
    assert task.reached(2e-3)


def test_a_motion_replaces_a_motion_without_a_jump() -> None:
    control = controller()
    control.posture.move_to(MIDDLE + 0.2, 1.0)
    before = np.zeros(17)
    for tick in range(200):
        if tick == 40:
            control.posture.move_to(MIDDLE - 0.1, 1.2)
        velocity = control.step().velocity.copy()
        assert np.abs(velocity - before).max() < 0.03
        before = velocity
    assert np.abs(control.position - (MIDDLE - 0.1)).max() < 1e-3
    assert control.posture.reached(1e-3)


def test_a_bad_motion_leaves_the_one_under_way() -> None:
    control = controller()
    control.posture.move_to(MIDDLE + 0.1, 1.0)
    for tick in range(90):
        if tick == 30:
            with pytest.raises(TargetError):
                control.posture.move_to(np.full(17, np.nan), 1.0)
        control.step()
    assert np.abs(control.position - (MIDDLE + 0.1)).max() < 1e-3


@pytest.mark.parametrize("duration", [1e-3, 0.05])
def test_a_motion_that_is_too_fast_keeps_the_limits_and_arrives_late(duration: float) -> None:
    control = controller()
    before = np.zeros(17)
    control.posture.move_to(ROBOT.upper, duration)
    for _ in range(1500):
        velocity = control.step().velocity.copy()
        assert control.status.solver == "solved"
        assert (np.abs(velocity) <= VELOCITY + 1e-9).all()
        assert (np.abs(velocity - before) <= ACCELERATION * DT + 1e-9).all()
        before = velocity
    assert np.abs(control.position - (ROBOT.upper - SETTINGS.position_margin)).max() < 2e-3


def test_a_spline_that_swings_beyond_the_limits_does_not_take_the_joints_there() -> None:
    control = controller()
    durations = [0.8, 0.15, 0.15, 0.8]
    control.posture.move_through([ROBOT.upper, ROBOT.lower, ROBOT.upper, MIDDLE], durations)
    beyond = False
    for _ in range(800):
        control.step()
        beyond |= bool((control.posture.target > ROBOT.upper + 0.1).any())
        assert control.status.solver == "solved"
        assert (control.position <= ROBOT.upper).all()
        assert (control.position >= ROBOT.lower).all()
    assert beyond
    assert np.abs(control.position - MIDDLE).max() < 2e-3


def test_a_place_out_of_reach_is_no_trouble() -> None:
    control, task, there = reaching()
    task.move_through([there + 2.0, there], [0.5, 1.0])
    for _ in range(1200):
        reference = control.step()
        assert control.status.solver == "solved"
        assert np.isfinite(reference.load_torque).all()
    assert np.linalg.norm(task.error) < 5e-3


@pytest.mark.parametrize("moving", [False, True])
def test_a_task_that_was_taken_out_and_put_back_goes_on(moving: bool) -> None:
    control, task, there = reaching()
    if moving:
        task.move_to(there, 1.0)
    else:
        task.target = there
    for _ in range(30):
        control.step()
    control.remove(task)
    for _ in range(100):
        control.step()
    away = control.position
    control.add(task)
    before = control.velocity
    for _ in range(800):
        velocity = control.step().velocity.copy()
        assert (np.abs(velocity - before) <= ACCELERATION * DT + 1e-9).all()
        before = velocity
    assert task.reached(3e-3)
    if not moving:  # a motion ends where it has come to
        assert np.abs(away - control.position).max() > 0.01


def test_a_motion_asked_for_before_the_task_is_added_begins_when_it_is() -> None:
    control, task, there = reaching()
    control.remove(task)
    task.move_to(there, 1.0)
    for _ in range(200):
        control.step()
    assert task.has_reference
    control.add(task)
    for _ in range(round(1.0 / DT) + 1):
        control.step()
    assert task.reached(3e-3)


@pytest.mark.parametrize("task", every_task(), ids=lambda task: str(task.name))
def test_a_task_can_go_on_in_another_controller(task: Task) -> None:
    first, second = controller(), controller()
    first.add(task)
    first.step()
    first.remove(task)
    second.add(task)
    for _ in range(5):
        second.step()
    fresh = controller()
    twin = next(t for t in every_task() if t.name == task.name)
    fresh.add(twin)
    for _ in range(5):
        fresh.step()
    np.testing.assert_allclose(second.position, fresh.position, atol=1e-9)
    np.testing.assert_allclose(task.error, twin.error, atol=1e-9)
    first.step()
    np.testing.assert_allclose(first.position, MIDDLE, atol=1e-3)
