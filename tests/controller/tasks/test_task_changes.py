"""Settings of tasks in use from any thread: between two ticks, and a group of settings together."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.controller import (
    BasePoseTask,
    BaseVelocityTask,
    Changes,
    ChangesError,
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
    RobotModel,
    TargetError,
    Task,
    WholeBodyController,
)
from pepper_driver.controller.tasks.targets import Target
from pepper_driver.controller.tasks.task import TaskRows
from support.controller import MIDDLE, ROBOT, controller

PLACE = [0.3, 0.2, 0.9]
TARGETS: list[tuple[Callable[[], Task], Target]] = [
    (lambda: PostureTask(["HeadYaw"]), {"HeadYaw": 0.5}),
    (lambda: HandTask("LHand"), 0.25),
    (lambda: PositionTask("l_wrist", root="base_link"), PLACE),
    (lambda: OrientationTask("Head"), [0.0, 0.0, 0.0, 1.0]),
    (lambda: FrameTask("r_wrist"), [*PLACE, 0.0, 0.0, 0.0, 1.0]),
    (ComTask, [0.0, 0.0, 0.6]),
    (LookAtTask, [1.0, 0.2, 1.0]),
    (lambda: LookAtTask(target_link="l_wrist"), [0.0, 0.0, 0.1]),
    (BasePoseTask, [0.1, 0.0, 3.5]),
    (BaseVelocityTask, [0.1, 0.0, 0.1]),
    (MomentumTask, [0.0, 0.0, 0.0, 0.1, 0.0, 0.0]),
    (lambda: ComplianceTask(["HeadYaw"]), [0.25]),
]

GAINS = [("stiffness", 7.0), ("damping", 3.0), ("weight", 17.0)]


def in_use(task: Task) -> WholeBodyController:
    control = controller()
    control.add(task)
    control.step()
    return control


def value(task: Task, name: str) -> Any:
    now = getattr(task, name)
    return now.tolist() if isinstance(now, np.ndarray) else now


def grouped(control: WholeBodyController, task: Task, name: str, new: Any) -> None:
    """A setting in a group is made at its end; not if the group fails; and it waits for the present tick."""
    before = value(task, name)
    fails(control, lambda: setattr(task, name, new))
    assert value(task, name) == before
    with control.changes.together():
        setattr(task, name, new)
        assert value(task, name) == before
    after = value(task, name)
    assert after != before
    control.remove(task)
    setattr(task, name, before)
    before = value(task, name)  # a rotation comes back rounded
    assert before != after  # at once
    control.add(task)
    waits_for_the_tick(control, lambda: setattr(task, name, new), lambda: value(task, name), before)
    assert value(task, name) == after
    control.step()


def fails(control: WholeBodyController, work: Callable[[], None]) -> None:
    """Work in a group that fails."""

    def group() -> None:
        with control.changes.together():
            work()
            raise KeyError

    with pytest.raises(KeyError):
        group()


def waits_for_the_tick(
    control: WholeBodyController, work: Callable[[], None], read: Callable[[], Any], before: Any
) -> None:
    thread = threading.Thread(target=work, daemon=True)
    with control.changes.tick():
        thread.start()
        thread.join(0.02)
        assert thread.is_alive()
        assert read() == before
    thread.join(20.0)
    assert not thread.is_alive()


@pytest.mark.parametrize(("make", "target"), TARGETS)
def test_targets_are_set_between_ticks(make: Callable[[], Task], target: Target) -> None:
    task = make()
    grouped(in_use(task), task, "target", target)


@pytest.mark.parametrize(("name", "new"), [*GAINS, ("dim_weight", [1.0, 0.5, 0.0])])
def test_gains_are_set_between_ticks(name: str, new: Any) -> None:
    task = PositionTask("l_wrist")
    grouped(in_use(task), task, name, new)


@pytest.mark.parametrize("name", ["reference_velocity", "reference_acceleration"])
def test_references_are_set_between_ticks(name: str) -> None:
    task = PositionTask("l_wrist")
    grouped(in_use(task), task, name, [0.1, 0.0, 0.0])


def test_torques_are_set_between_ticks() -> None:
    task = ComplianceTask(["HeadYaw"])
    grouped(in_use(task), task, "torque", [1.0])


@pytest.mark.parametrize(("make", "target"), TARGETS)
def test_motions_begin_and_end_between_ticks(make: Callable[[], Task], target: Target) -> None:
    task = make()
    control = in_use(task)
    if isinstance(task, BaseVelocityTask | MomentumTask):
        with pytest.raises(TargetError), control.changes.together():
            task.move_to(target, 1.0)
        return
    with control.changes.together():
        task.move_to(target, 1.0)
        assert not task.has_reference
    assert task.has_reference
    control.step()
    with control.changes.together():
        task.stop()
        assert task.has_reference
    assert not task.has_reference
    waits_for_the_tick(
        control, lambda: task.move_through([target], [1.0]), lambda: task.has_reference, False
    )
    assert task.has_reference
    waits_for_the_tick(control, task.stop, lambda: task.has_reference, True)
    assert not task.has_reference


def test_what_is_wrong_is_refused_in_a_group_where_it_is_set() -> None:
    task = PostureTask()
    control = in_use(task)
    target = task.target
    with control.changes.together():
        task.target = {"HeadYaw": 0.4}
        for wrong, error in (
            ({"HeadYaw": 9.0}, TargetError),
            ({"HeadYow": 0.1}, UnknownNameError),
            ([0.1], TargetError),
        ):
            with pytest.raises(error):
                task.target = wrong
            with pytest.raises(error):
                task.move_to(wrong, 1.0)
        for name, _ in GAINS:
            with pytest.raises(GainError):
                setattr(task, name, -1.0)
        with pytest.raises(GainError):
            task.dim_weight = [1.0]
        np.testing.assert_array_equal(task.target, target)
    target[task.joints.index("HeadYaw")] = 0.4
    np.testing.assert_array_equal(task.target, target)


def test_joints_by_name_add_up_in_a_group_and_between_threads() -> None:
    task = PostureTask(["HeadYaw", "HeadPitch", "LElbowYaw"])
    control = in_use(task)
    with control.changes.together():
        task.target = {"HeadYaw": 0.1}
        task.target = {"HeadPitch": 0.2}
        task.target = {"HeadYaw": 0.3}
        task.target = {}
    assert task.target.tolist() == [0.3, 0.2, pytest.approx(0.0, abs=1e-12)]
    with control.changes.together():
        task.target = [0.0, 0.0, 0.0]
        task.move_through([{"HeadYaw": 0.1}, {"LElbowYaw": -0.5}], [0.1, 0.1])
    for _ in range(30):
        control.step()
    assert task.target.tolist() == [0.1, 0.0, -0.5]
    assert task.checked({"HeadPitch": 0.1}).tolist() == [0.1, 0.1, -0.5]


def test_gains_that_belong_together_are_judged_when_they_are_made() -> None:
    task = ComplianceTask(["HeadYaw"])
    control = in_use(task)
    with control.changes.together():
        task.stiffness = 4.0
        task.damping = None  # goes with the stiffness that is not there yet
    assert (task.stiffness, task.damping) == (4.0, 4.0)

    def group() -> None:
        with control.changes.together():
            task.stiffness = 0.0
            task.weight = 5.0

    with pytest.raises(GainError, match="damping"):
        group()
    assert (task.stiffness, task.weight) == (4.0, 5.0)


def test_a_rest_posture_that_is_not_known_completes_no_target() -> None:
    task = ComplianceTask(["HeadYaw", "HeadPitch"])
    with pytest.raises(TargetError, match="HeadPitch"):
        task.target = {"HeadYaw": 0.1}
    task.target = {"HeadYaw": 0.1, "HeadPitch": 0.2}
    assert task.target.tolist() == [0.1, 0.2]


def test_tasks_come_and_go_together() -> None:
    control, one, other = controller(), PositionTask("l_wrist"), PositionTask("r_wrist")
    own = control.tasks
    control.add(one)
    with control.changes.together():
        control.remove(one)
        control.add(other)
        one.target = PLACE
        assert control.tasks == (*own, one)
        assert np.isnan(one.target).all()
    assert control.tasks == (*own, other)
    assert one.target.tolist() == PLACE
    fails(control, lambda: control.remove(other))
    assert control.tasks == (*own, other)
    with control.changes.together():  # taken out and in again, a motion between them counts
        control.remove(other)
        other.move_to(PLACE, 1.0)
        control.add(other)
    assert other.has_reference
    assert control.tasks == (*own, other)


def test_controllers_may_share_one_object_of_changes() -> None:
    changes = Changes()
    one, two = (WholeBodyController(ROBOT, changes=changes) for _ in range(2))
    task = PositionTask("l_wrist")
    one.add(task)
    with changes.together():
        two.add(task)
        assert task in one.tasks
    assert task not in one.tasks
    assert task in two.tasks
    assert task.changes is changes
    two.remove(task)
    assert task.changes is None


def test_nothing_steps_inside_a_group() -> None:
    control = controller()
    with control.changes.together():
        control.posture.target = MIDDLE + 0.1
        with pytest.raises(ChangesError):
            control.step()
        with pytest.raises(ChangesError):
            control.reset(MIDDLE)
    np.testing.assert_array_equal(control.posture.target, MIDDLE + 0.1)
    control.step()


class Probe(Task):
    """Task that compares the targets of two others in every tick; nothing may change meanwhile."""

    needs_kinematics = False

    def __init__(self, one: PostureTask, other: PositionTask) -> None:
        super().__init__(1, stiffness=0.0, weight=0.0)
        self._one, self._other = one, other
        self.seen: list[tuple[float, ...]] = []

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        one, other = self._one, self._other
        values = float(one.target[0]), float(other.target[0]), one.weight, other.weight
        self.seen.append(values)


def test_no_tick_sees_a_group_half_done() -> None:
    one, other = PostureTask(["HeadYaw"]), PositionTask("l_wrist", root="base_link")
    control, probe, over = controller(), Probe(one, other), threading.Event()
    for task in (one, probe, other):
        control.add(task)
    groups = 0

    def change() -> None:
        nonlocal groups
        while not over.is_set():
            groups += 1
            number = groups % 50 * 0.01
            with control.changes.together():
                one.target, one.weight = [number], 1.0 + number
                other.target, other.weight = [number, 0.2, 0.9], 1.0 + number

    with control.changes.together():
        one.target, one.weight = [0.0], 1.0
        other.target, other.weight = [0.0, 0.2, 0.9], 1.0
    thread = threading.Thread(target=change)
    thread.start()
    try:
        while len(probe.seen) < 4000:
            control.step()
    finally:
        over.set()
        thread.join()
    assert groups > 50
    assert len(set(probe.seen)) > 5
    for head, hand, *weights in probe.seen:
        assert head == hand
        assert weights == [1.0 + head] * 2
