"""Tasks that come and go: from other threads, from one controller to another, held back by a reflex."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.controller import (
    BaseVelocityTask,
    ComplianceTask,
    ComTask,
    FrameTask,
    GainError,
    HandTask,
    LookAtTask,
    MomentumTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    RobotMismatchError,
    Task,
    TaskCountError,
)
from pepper_driver.controller.whole_body import MAX_TASKS
from support.controller import ACCELERATION, DT, MIDDLE, ROBOT, controller


def test_tasks_may_come_and_go_from_another_thread() -> None:
    control = controller()
    tasks = [PositionTask("l_wrist"), FrameTask("r_wrist"), PostureTask()]
    over = threading.Event()

    def meddle() -> None:
        while not over.is_set():
            for task in tasks:
                control.add(task)
                if isinstance(task, PostureTask):
                    task.move_to(MIDDLE, 0.05)
                    task.reference_velocity = np.full(17, 0.01)
                    task.reference_velocity = np.zeros(17)
            for task in tasks:
                control.remove(task)

    thread = threading.Thread(target=meddle)
    thread.start()
    try:
        for _ in range(3000):
            control.step()
            assert control.status.solver == "solved"
    finally:
        over.set()
        thread.join()
    assert control.tasks == (control.posture, control.base_velocity)


def test_a_task_goes_with_the_controller_that_has_it_last() -> None:
    first, second = controller(), controller()
    task = PositionTask("l_wrist")
    first.add(task)
    first.step()
    second.add(task)
    assert task not in first.tasks
    task.target = task.target + np.array([0.05, 0.0, 0.05])
    for _ in range(300):
        at_rest, moved = first.step(), second.step()
    assert np.abs(at_rest.position - MIDDLE).max() < 1e-6
    assert task.reached(1e-3)
    assert np.abs(moved.position - MIDDLE).max() > 0.05


def test_a_task_taken_out_forgets_its_motion() -> None:
    control = controller()
    task = PositionTask("l_wrist")
    control.add(task)
    control.step()
    task.move_to(task.target + np.array([0.1, 0.0, 0.1]), 2.0)
    for _ in range(50):
        control.step()
    half = task.target
    control.remove(task)
    for _ in range(200):
        control.step()
    control.add(task)
    for _ in range(300):
        control.step()
    assert task.reached(1e-3)
    np.testing.assert_array_equal(task.target, half)


def test_reset_ends_every_motion_and_what_was_measured() -> None:
    control = controller()
    task = PositionTask("l_wrist")
    control.add(task)
    control.step()
    task.move_to(task.target + np.array([0.1, 0.0, 0.1]), 2.0)
    for _ in range(50):
        control.step()
    target = task.target
    control.odometry.update(np.ones(3), DT)
    control.reset(MIDDLE)
    control.step()
    np.testing.assert_array_equal(task.target, target)
    np.testing.assert_array_equal(control.odometry.pose, np.zeros(3))


def test_held_only_the_posture_acts_and_the_base_stops() -> None:
    control = controller()
    hand = PositionTask("l_wrist")
    control.add(hand)
    control.step()
    goal = hand.target + np.array([0.1, 0.1, 0.2])
    hand.move_to(goal, 1.0)
    control.base_velocity.target = [0.1, 0.0, 0.1]
    for _ in range(40):
        control.step()
    control.hold = True
    control.posture.target = control.position + control.velocity / 20.0
    control.posture.stiffness = 400.0
    before = control.step()
    for _ in range(45):
        reference = control.step()
        change = np.abs(reference.velocity - before.velocity)
        assert (change <= ACCELERATION * DT + 1e-9).all()
        before = reference
    assert np.abs(reference.velocity).max() < 0.01
    assert np.abs(reference.base_twist).max() < 0.01
    assert control.base_velocity.target.tolist() == [0.1, 0.0, 0.1]
    control.hold = False
    control.posture.stiffness = 5.0
    for _ in range(500):
        reference = control.step()
    assert hand.reached(1e-3)
    np.testing.assert_allclose(hand.target, goal)
    assert reference.base_twist == pytest.approx([0.1, 0.0, 0.1], abs=1e-3)


@pytest.mark.parametrize(
    ("gain", "value"), [("stiffness", 3001.0), ("damping", 121.0), ("weight", 1e13)]
)
def test_gains_that_a_cycle_is_too_long_for_are_refused(gain: str, value: float) -> None:
    task = PostureTask()
    with pytest.raises(GainError, match=f"{gain} must be a number from 0 to"):
        setattr(task, gain, value)


@pytest.mark.parametrize("stiffness", [0.5, 300.0, 3000.0])
def test_the_stiffest_law_comes_to_rest(stiffness: float) -> None:
    control = controller()
    control.posture.stiffness = stiffness
    control.posture.target = MIDDLE + 0.1
    for _ in range(2500):
        reference = control.step()
    assert np.abs(reference.velocity).max() < 1e-6
    assert control.posture.reached(1e-4)


def test_a_task_without_weight_is_never_reached() -> None:
    control = controller()
    control.posture.dim_weight = np.zeros(17)
    control.step()
    assert not control.posture.reached(10.0)


def test_a_task_for_another_robot_is_refused() -> None:
    names = {"HeadYaw": "NeckYaw"}
    joints = tuple(replace(j, name=names.get(j.name, j.name)) for j in ROBOT.joints)
    other = replace(ROBOT, name="salt", joints=joints)
    control = controller()
    before = control.tasks
    tasks: list[Task] = [
        PostureTask(robot=other),
        HandTask("LHand", robot=other),
        ComplianceTask(["NeckYaw"], robot=other),
        PositionTask("l_wrist", robot=other),
        OrientationTask("l_wrist", robot=other),
        FrameTask("l_wrist", robot=other),
        ComTask(robot=other),
        LookAtTask(robot=other),
        MomentumTask(robot=other),
    ]
    for task in tasks:
        with pytest.raises(RobotMismatchError, match=r"'salt'.*HeadYaw, NeckYaw") as caught:
            control.add(task)
        assert caught.value.names == ("HeadYaw", "NeckYaw")
    assert control.tasks == before
    turned = replace(ROBOT, links=ROBOT.links[::-1])
    with pytest.raises(RobotMismatchError, match="order"):
        control.add(ComTask(robot=turned))
    control.add(ComTask(robot=replace(ROBOT, name="the same")))
    control.add(BaseVelocityTask())
    assert len(control.tasks) == len(before) + 2


def test_there_is_a_limit_to_the_tasks_in_use() -> None:
    control = controller()
    tasks = [PostureTask(["HeadYaw"], name=f"task {i}") for i in range(MAX_TASKS)]
    for task in tasks[: MAX_TASKS - 2]:
        control.add(task)
    control.add(tasks[0])  # is there already
    before = control.tasks
    assert len(before) == MAX_TASKS
    with pytest.raises(TaskCountError, match=f"'task {MAX_TASKS - 1}' is one too many"):
        control.add(tasks[-1])
    assert control.tasks == before
    assert tasks[-1].owner is None
    control.add(tasks[-1], enforce_limit=False)
    control.remove(tasks[-1])
    with control.changes.together():  # one goes, one comes
        control.remove(tasks[0])
        control.add(tasks[-1])
    assert control.tasks == (*(task for task in before if task is not tasks[0]), tasks[-1])
    control.remove(tasks[1])

    def group() -> None:
        with control.changes.together():
            control.add(tasks[0])
            control.add(tasks[1])

    with pytest.raises(TaskCountError, match="'task 1'"):
        group()
    assert tasks[0] in control.tasks
    assert tasks[1] not in control.tasks
    control.step()
