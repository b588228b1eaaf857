"""Tasks: their law of motion, their targets and gains, and how they share the cost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import (
    BaseVelocityTask,
    GainError,
    PostureTask,
    RobotModel,
    TargetError,
    Task,
    WholeBodyController,
)
from pepper_driver.controller.tasks.task import TaskRows
from support.controller import DT, JOINTS, MIDDLE, ROBOT, SETTINGS, FixedRows, controller

STIFFNESS = SETTINGS.posture.stiffness
OFFSET = np.where(np.arange(JOINTS) % 2, 0.15, -0.1)


class WristTask(Task):
    """The left wrist goes to a point of base_link."""

    def __init__(self, target: FloatArray) -> None:
        super().__init__(3, stiffness=20.0, weight=1000.0)
        self.target = target

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        own = model.point_jacobian("l_wrist", np.zeros(3), model.joint_position)
        rows.jacobian[:, model.joint_columns] = own
        rows.error[:] = self.target - model.link_pose("l_wrist", model.joint_position)[:3, 3]


class BrokenTask(Task):
    """Task that requests NaN."""

    needs_kinematics = False

    def __init__(self) -> None:
        super().__init__(1, stiffness=1.0, weight=1.0)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        rows.jacobian[:] = np.nan
        rows.error[:] = np.nan


def motion(dt: float, damping: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Times [s] and joint positions over OFFSET, of 2 s from rest in the middle of all ranges."""
    control = WholeBodyController(ROBOT, SETTINGS, dt=dt)
    control.posture.target = MIDDLE + OFFSET
    if damping is not None:
        control.posture.damping = damping
    time = dt * np.arange(1, round(2.0 / dt) + 1, dtype=np.float64)
    positions = np.array([control.step().position for _ in time])
    return time, (positions - MIDDLE) / OFFSET


def critically_damped(time: FloatArray) -> FloatArray:
    w = np.sqrt(STIFFNESS)
    free: FloatArray = (1 - (1 + w * time) * np.exp(-w * time))[:, None]
    return free


@pytest.mark.parametrize(("dt", "error"), [(DT, 0.015), (DT / 8, 0.002)])
def test_posture_moves_by_a_critically_damped_law(dt: float, error: float) -> None:
    time, x = motion(dt)
    assert np.abs(x - critically_damped(time)).max() < error


def test_posture_follows_its_law_step_by_step() -> None:
    """The closed form of the discrete system: [x, v] with the acceleration held for a cycle."""
    k, d = STIFFNESS, 2 * np.sqrt(STIFFNESS)
    law = np.array([[1 - k * DT**2 / 2, DT - d * DT**2 / 2], [-k * DT, 1 - d * DT]])
    time, x = motion(DT)
    state = np.array([-1.0, 0.0])
    for at in x:
        state = law @ state
        assert np.abs(at - 1 - state[0]).max() < 1e-5
    assert len(time) > 100


def test_damping_can_be_set_and_follows_the_stiffness_again() -> None:
    damping = 1.5
    time, x = motion(DT / 8, damping)
    turn = np.sqrt(STIFFNESS - damping**2 / 4)
    free = 1 - np.exp(-damping / 2 * time) * (
        np.cos(turn * time) + damping / (2 * turn) * np.sin(turn * time)
    )
    assert np.abs(x - free[:, None]).max() < 0.003
    task = PostureTask(stiffness=4.0, weight=1.0)
    assert task.damping == 4.0
    task.damping = 1.0
    task.stiffness = 9.0
    assert task.damping == 1.0
    task.damping = None
    assert task.damping == 6.0


def test_the_base_reaches_its_twist_as_a_first_order_lag() -> None:
    control = controller()
    target = np.array([0.05, -0.03, 0.1])
    control.base_velocity.target = target
    rate = 2 * np.sqrt(SETTINGS.base.stiffness)
    for tick in range(1, 300):
        twist = control.step().base_twist
        assert np.abs(twist - target * (1 - (1 - rate * DT) ** tick)).max() < 1e-6
    assert np.abs(control.base_velocity.error).max() < 1e-4
    assert np.abs(control.position - MIDDLE).max() < 1e-9


def outside(joint: int, by: float) -> FloatArray:
    target = MIDDLE.copy()
    target[joint] = ROBOT.upper[joint] + by if by > 0 else ROBOT.lower[joint] + by
    return target


def with_value(value: float) -> FloatArray:
    target = MIDDLE.copy()
    target[4] = value
    return target


@pytest.mark.parametrize(
    "target",
    [
        with_value(np.nan),
        with_value(np.inf),
        MIDDLE[:-1],
        MIDDLE[None],
        np.float64(0.0),
        outside(0, 0.01),
        outside(16, -0.01),
    ],
)
def test_a_posture_that_cannot_be_is_refused(target: FloatArray) -> None:
    task = PostureTask(stiffness=1.0, weight=1.0)
    task.target = ROBOT.lower
    with pytest.raises(TargetError):
        task.target = target
    with pytest.raises(TargetError):
        task.checked(target)
    assert np.array_equal(task.target, ROBOT.lower)


def test_the_message_names_the_joint_and_its_limits() -> None:
    task = PostureTask(stiffness=1.0, weight=1.0)
    joint = ROBOT.joint_index("LElbowRoll")
    with pytest.raises(TargetError, match=f"LElbowRoll .* {ROBOT.lower[joint]:.4g} to"):
        task.target = outside(joint, 0.2)


def test_the_limits_themselves_can_be_targets() -> None:
    task = PostureTask(stiffness=1.0, weight=1.0)
    for target in (ROBOT.lower, ROBOT.upper, ROBOT.upper + 1e-7):
        task.target = target
        assert (task.target <= ROBOT.upper).all()
        assert (task.target >= ROBOT.lower).all()


def test_targets_are_copies() -> None:
    task = PostureTask(stiffness=1.0, weight=1.0)
    given = MIDDLE.copy()
    task.target = given
    given[0] = 9.0
    task.target[1] = 9.0
    assert np.array_equal(task.target, MIDDLE)


@pytest.mark.parametrize(
    "target",
    [np.array([0.1, np.nan, 0.0]), np.array([np.inf, 0, 0]), np.zeros(2), np.zeros((1, 3))],
)
def test_a_twist_that_is_none_is_refused(target: FloatArray) -> None:
    task = BaseVelocityTask(stiffness=1.0, weight=1.0)
    task.target = np.array([0.1, 0.2, 0.3])
    with pytest.raises(TargetError):
        task.target = target
    assert task.target.tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize("gain", ["stiffness", "damping", "weight"])
@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf, -np.inf, "5"])
def test_gains_that_are_negative_or_no_number_are_refused(gain: str, value: float | str) -> None:
    task = PostureTask(stiffness=3.0, weight=2.0)
    before = getattr(task, gain)
    with pytest.raises(GainError, match=gain):
        setattr(task, gain, value)
    assert getattr(task, gain) == before


@pytest.mark.parametrize("value", [0, 2, 2.5, np.float32(2.5), np.int64(2)])
def test_gains_may_be_any_number(value: float) -> None:
    task = PostureTask(stiffness=value, weight=1.0)
    assert task.stiffness == float(value)
    assert isinstance(task.stiffness, float)


def test_two_postures_meet_at_their_weighted_mean() -> None:
    control = controller()
    second = PostureTask(stiffness=STIFFNESS, weight=3 * SETTINGS.posture.weight)
    control.posture.target, second.target = MIDDLE + OFFSET, MIDDLE - OFFSET
    control.add(second)
    control.add(second)
    assert control.tasks.count(second) == 1
    for _ in range(800):
        control.step()
    assert np.abs(control.position - (MIDDLE - OFFSET / 2)).max() < 1e-5
    control.remove(second)
    control.remove(second)
    for _ in range(800):
        control.step()
    assert np.abs(control.position - (MIDDLE + OFFSET)).max() < 1e-5


def test_a_row_without_weight_leaves_its_joint_alone() -> None:
    control = controller()
    control.posture.target = MIDDLE + OFFSET
    weights = np.ones(JOINTS)
    weights[5] = 0.0
    control.posture.dim_weight = weights
    for _ in range(800):
        control.step()
    left = np.abs(control.position - (MIDDLE + OFFSET))
    assert left[5] == pytest.approx(abs(OFFSET[5]), abs=1e-9)
    assert np.delete(left, 5).max() < 1e-5


def test_without_any_task_nothing_moves() -> None:
    control = controller()
    for task in control.tasks:
        control.remove(task)
    assert control.tasks == ()
    for _ in range(10):
        control.step()
    assert control.status.solver == "solved"
    assert np.array_equal(control.position, MIDDLE)


def test_a_posture_without_weight_does_not_disturb_the_base() -> None:
    control = controller()
    control.posture.weight = 0.0
    control.base_velocity.target = np.array([0.05, 0.0, 0.0])
    for _ in range(300):
        control.step()
    assert control.status.solver == "solved"
    assert control.step().base_twist == pytest.approx([0.05, 0, 0], abs=1e-4)
    assert np.abs(control.position - MIDDLE).max() < 1e-9


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_a_task_of_ones_own_puts_the_wrist_in_its_place(solver: str) -> None:
    control = controller(solver)
    control.posture.weight = 0.01
    there = MIDDLE.copy()
    there[5:9] += [0.3, 0.2, -0.4, -0.3]
    place = control.model.link_pose("l_wrist", there)[:3, 3]
    task = WristTask(place)
    start = control.model.link_pose("l_wrist", control.position)[:3, 3]
    control.add(task)
    for _ in range(400):
        control.step()
        assert control.status.solver == "solved"
    assert np.linalg.norm(start - place) > 0.03
    assert np.linalg.norm(task.error) < 2e-4
    control.remove(task)
    for _ in range(1000):
        control.step()
    assert np.abs(control.position - MIDDLE).max() < 1e-4


def test_kinematics_are_computed_for_those_who_need_them(monkeypatch: pytest.MonkeyPatch) -> None:
    control = controller()
    calls: list[FloatArray] = []
    update: Callable[[], None] = control.model.update_kinematics

    def spy() -> None:
        calls.append(control.model.joint_position)
        update()

    monkeypatch.setattr(control.model, "update_kinematics", spy)
    control.step()
    assert not calls
    task = WristTask(np.zeros(3))
    control.add(task)
    before = control.position
    control.step()
    assert len(calls) == 1
    assert np.array_equal(calls[0], before)
    control.remove(task)
    control.step()
    assert len(calls) == 1
    rows = FixedRows(np.zeros((1, 20)), np.ones(1))
    rows.needs_kinematics = True
    control.add(rows)
    control.step()
    assert len(calls) == 2


def test_a_task_with_nonsense_brakes_the_robot() -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    control.base_velocity.target = np.array([0.3, 0.0, 0.5])
    for _ in range(40):
        control.step()
    broken = BrokenTask()
    control.add(broken)
    for _ in range(200):
        reference = control.step()
        assert control.status.solver == "failed"
        assert np.isfinite(reference.load_torque).all()
    assert np.abs(reference.velocity).max() < 1e-12
    assert np.abs(reference.base_twist).max() < 1e-12
    control.remove(broken)
    for _ in range(1500):
        control.step()
    assert control.status.solver == "solved"
    assert np.abs(control.position - (ROBOT.upper - SETTINGS.position_margin)).max() < 1e-3


@pytest.mark.parametrize(
    "value", [np.ones(16), -np.ones(17), np.full(17, np.nan), np.full(17, np.inf)]
)
def test_wrong_dim_weights_are_refused(value: FloatArray) -> None:
    task = controller().posture
    with pytest.raises(GainError, match="dim_weight"):
        task.dim_weight = value
    np.testing.assert_array_equal(task.dim_weight, 1.0)
