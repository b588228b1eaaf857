"""Momentum: against sums over the bodies; how it dies out and what follows a target."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import MomentumTask, PositionTask, TargetError
from support.controller import DT, MIDDLE, ROBOT, controller
from support.tasks import MODEL, STEP, Bench, State, centre_of_mass, later, random_state, turn


def momentum(state: State) -> FloatArray:
    """(6,) about the centre of mass, from the displacements and turns of the bodies in a short time."""

    def bodies(q: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        data = MODEL.pin.createData()
        pin.forwardKinematics(MODEL.pin, data, q)
        return [
            (m.act(i.lever), m.rotation.copy()) for i, m in zip(INERTIAS, data.oMi, strict=True)
        ]

    before, now, after = (bodies(later(state, time).q) for time in (-STEP, 0.0, STEP))
    centre = centre_of_mass(state)
    total = np.zeros(6)
    for inertia, (p0, r0), (p, r), (p1, r1) in zip(INERTIAS, before, now, after, strict=True):
        push = inertia.mass * (p1 - p0) / (2 * STEP)
        spin = r @ inertia.inertia @ r.T @ turn(r0, r1) / (2 * STEP)
        total[:3] += push
        total[3:] += np.cross(p - centre, push) + spin
    return total


INERTIAS = list(MODEL.pin.inertias)


@pytest.mark.parametrize("seed", range(4))
def test_the_rows_are_those_of_the_bodies(seed: int) -> None:
    state = random_state(seed)
    bench = Bench(MomentumTask())
    measured = bench.at(state)
    np.testing.assert_allclose(measured.jacobian @ state.v, momentum(state), atol=1e-6)
    change = (momentum(later(state, 1e-3)) - momentum(later(state, -1e-3))) / 2e-3
    np.testing.assert_allclose(measured.bias, change, atol=2e-3)
    np.testing.assert_allclose(measured.bias, bench.rate_changes(state), atol=1e-6)
    assert np.abs(measured.bias).max() > 1.0


def test_it_does_not_disturb_what_other_tasks_measure() -> None:
    state = random_state(9)
    bench = Bench(PositionTask("l_wrist", [0.1, 0.0, 0.0], root="Head"))
    alone = bench.at(state)
    Bench(MomentumTask()).at(state)
    bench.model.centroidal_momentum()
    bench.task.compute(bench.model, bench.rows)
    np.testing.assert_allclose(bench.rows.jacobian, alone.jacobian, atol=1e-14)
    np.testing.assert_allclose(bench.rows.bias, alone.bias, atol=1e-14)


def test_momentum_follows_its_target_as_a_first_order_lag() -> None:
    control = controller()
    for own in control.tasks:
        control.remove(own)
    task = MomentumTask(stiffness=1.0, base=True)
    control.add(task)
    target = np.array([0.4, -0.3, 0.0, 0.02, 0.03, -0.05])
    task.dim_weight = [1, 1, 0, 1, 1, 1]
    task.target = target
    asked = task.dim_weight > 0
    left = [(control.step(), task.error)[1][asked] for _ in range(60)]
    time = DT * np.arange(60)
    expected = np.exp(-2.0 * time)[:, None] * target[asked]
    assert np.abs(np.array(left) - expected).max() < 0.02 * np.abs(target).max()
    assert not task.reached(1e-3)
    for _ in range(300):
        control.step()
    assert task.reached(1e-2)
    task.target = np.zeros(6)
    assert not task.reached(1e-2)


def test_arms_balance_the_torso() -> None:
    """A swing of the hip spins the robot less where the other joints may answer it."""

    def spin(weight: float) -> float:
        control = controller()
        task = MomentumTask(weight=weight, joints=ROBOT.joint_names[5:])
        task.dim_weight = [0, 0, 0, 1, 1, 1]
        control.add(task)
        control.posture.weight = 1.0
        control.posture.target = MIDDLE + np.where(np.arange(17) == 2, 0.4, 0.0)
        largest = 0.0
        for _ in range(100):
            control.step()
            largest = max(largest, float(np.abs(task.error[3:]).max()))
        return largest

    assert spin(100.0) < 0.8 * spin(0.0)


@pytest.mark.parametrize("wrong", [np.zeros(3), [0, 0, 0, 0, 0, np.nan], None, "still"])
def test_a_momentum_that_is_none_is_refused(wrong: Any) -> None:
    task = MomentumTask()
    task.target = np.arange(6.0)
    with pytest.raises(TargetError):
        task.target = wrong
    with pytest.raises(TargetError):
        task.move_to(np.zeros(6), 1.0)
    assert task.target.tolist() == list(range(6))
    with pytest.raises(UnknownNameError):
        MomentumTask(joints=["Elbow"])
