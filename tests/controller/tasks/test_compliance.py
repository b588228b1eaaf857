"""Compliance: closed forms of a joint that is pushed, and what ends the push."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import ComplianceTask, GainError, TargetError, WholeBodyController
from support.controller import DT, MIDDLE, ROBOT, controller

JOINT = "LElbowYaw"
INDEX = ROBOT.joint_index(JOINT)
INERTIA, DAMPING = 0.2, 4.0


def compliant(**settings: Any) -> tuple[WholeBodyController, ComplianceTask]:
    """A controller with a compliant left elbow; no posture holds it."""
    control = controller()
    own = np.ones(17)
    own[INDEX] = 0.0
    control.posture.dim_weight = own
    given = {"inertia": INERTIA, "damping": DAMPING, "dead_band": 0.0, **settings}
    task = ComplianceTask((JOINT,), **given)
    control.add(task)
    control.step()
    return control, task


def pushed(
    control: WholeBodyController, task: ComplianceTask, torque: float, ticks: int
) -> FloatArray:
    """(ticks,) velocity of the elbow [rad/s] under a torque renewed in every cycle."""
    speeds = []
    for _ in range(ticks):
        task.torque = [torque]
        speeds.append(control.step().velocity[INDEX])
    return np.array(speeds)


@pytest.mark.parametrize("torque", [0.4, -0.4])
def test_a_pushed_joint_takes_up_speed_as_a_mass_with_friction(torque: float) -> None:
    control, task = compliant()
    speeds = pushed(control, task, torque, 120)
    ticks = np.arange(1, 121)
    expected = torque / (INERTIA * DAMPING) * (1 - (1 - DAMPING * DT) ** ticks)
    np.testing.assert_allclose(speeds, expected, atol=1e-5)
    moved = np.abs(control.position - MIDDLE)
    assert moved[INDEX] > 0.3
    assert np.delete(moved, INDEX).max() < 1e-9


def test_it_stays_where_it_was_led() -> None:
    control, task = compliant()
    pushed(control, task, 0.5, 60)
    task.torque = [0.0]
    for _ in range(300):
        control.step()
    left = control.position[INDEX]
    assert left - MIDDLE[INDEX] > 0.2
    for _ in range(300):
        control.step()
    assert control.position[INDEX] == pytest.approx(left, abs=1e-6)


def test_with_stiffness_it_comes_back_to_where_it_was() -> None:
    control, task = compliant(stiffness=9.0, damping=None)
    assert task.damping == 6.0
    assert task.target == pytest.approx(MIDDLE[[INDEX]], abs=1e-9)
    pushed(control, task, 0.5, 400)
    assert control.position[INDEX] - MIDDLE[INDEX] == pytest.approx(0.5 / INERTIA / 9.0, abs=1e-4)
    for _ in range(400):
        control.step()
    assert control.position[INDEX] == pytest.approx(MIDDLE[INDEX], abs=1e-4)


def test_a_torque_that_is_not_renewed_ends() -> None:
    """0.1 s are 8 cycles of 12 ms: after them the speed only dies out."""
    control, task = compliant()
    task.torque = [0.5]
    speeds = np.array([control.step().velocity[INDEX] for _ in range(40)])
    assert (np.diff(speeds[:8]) > 0).all()
    np.testing.assert_allclose(speeds[8:] / speeds[7:-1], 1 - DAMPING * DT, atol=1e-4)
    assert task.torque.tolist() == [0.0]
    assert not task.has_reference


def test_the_dead_band_is_subtracted_without_a_jump() -> None:
    def first(torque: float) -> float:
        control, task = compliant(dead_band=0.3)
        return float(pushed(control, task, torque, 1)[0])

    assert first(0.2) == first(0.3) == first(-0.29) == 0.0
    assert 0 < first(0.3001) < 1e-4
    assert first(0.5) == pytest.approx(0.2 / INERTIA * DT, rel=1e-5)
    assert first(-0.5) == pytest.approx(-0.2 / INERTIA * DT, rel=1e-5)


def test_beyond_the_largest_torque_nothing_is_added() -> None:
    for torque in (1.0, 1.1, 50.0):
        control, task = compliant(dead_band=0.3, max_torque=0.7)
        speed = pushed(control, task, torque, 1)[0]
        assert speed == pytest.approx(0.7 / INERTIA * DT, rel=1e-5)


def test_by_default_half_the_joints_effort_is_the_most() -> None:
    effort = ROBOT.joints[INDEX].effort
    control, task = compliant(inertia=50.0)
    assert pushed(control, task, 9 * effort, 1)[0] == pytest.approx(effort / 100 * DT, rel=1e-5)


def test_the_limits_of_the_robot_hold() -> None:
    control, task = compliant()
    pushed(control, task, 2.0, 600)
    assert control.position[INDEX] <= ROBOT.upper[INDEX]
    assert ROBOT.upper[INDEX] - control.position[INDEX] < 0.05
    assert control.status.solver == "solved"


def test_over_a_posture_of_the_usual_weight_it_leads_the_joint() -> None:
    """A part in a thousand of the posture's pull is left: 5 mrad/s2 a radian at its stiffness of 5."""
    control = controller()
    task = ComplianceTask(inertia=INERTIA, damping=DAMPING, dead_band=0.0)
    control.add(task)
    torque = np.zeros(17)
    torque[INDEX] = 0.4
    for _ in range(120):
        task.torque = torque
        speed = control.step().velocity[INDEX]
    expected = 0.4 / (INERTIA * DAMPING) * (1 - (1 - DAMPING * DT) ** 120)
    assert speed == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("wrong", [[np.nan], [np.inf], [0.1, 0.2], 0.1, None, "push"])
def test_a_torque_that_is_none_is_refused(wrong: Any) -> None:
    task = ComplianceTask((JOINT,))
    task.torque = [0.4]
    with pytest.raises(TargetError, match="torque"):
        task.torque = wrong
    assert task.torque.tolist() == [0.4]
    task.torque[0] = 3.0
    assert task.torque.tolist() == [0.4]


def test_without_stiffness_there_must_be_damping() -> None:
    for damping in (0.0, None):
        with pytest.raises(GainError, match="damping"):
            ComplianceTask(damping=damping)
    task = ComplianceTask(stiffness=4.0, damping=None)
    with pytest.raises(GainError, match="damping"):
        task.stiffness = 0.0
    assert (task.stiffness, task.damping) == (4.0, 4.0)
    task.damping = 3.0
    task.stiffness = 0.0
    for nothing in (0.0, None):
        with pytest.raises(GainError, match="damping"):
            task.damping = nothing
    assert (task.stiffness, task.damping) == (0.0, 3.0)


@pytest.mark.parametrize("name", ["inertia", "dead_band", "max_torque"])
@pytest.mark.parametrize("wrong", [-0.1, np.nan, np.inf, [0.1, 0.2], "soft"])
def test_numbers_that_are_none_are_refused(name: str, wrong: Any) -> None:
    with pytest.raises(GainError, match=name):
        ComplianceTask((JOINT,), **{name: wrong})


def test_what_else_makes_no_sense_is_refused() -> None:
    with pytest.raises(GainError, match="inertia"):
        ComplianceTask(inertia=0.0)
    with pytest.raises(GainError, match="max_torque"):
        ComplianceTask(max_torque=0.0)
    with pytest.raises(UnknownNameError, match="LElbowYaw"):
        ComplianceTask(("LElbowYwa",))
    task = ComplianceTask((JOINT,))
    with pytest.raises(TargetError, match="limits"):
        task.target = [9.0]
    assert np.isnan(task.target).all()
    task.target = {JOINT: 0.5}
    assert task.target.tolist() == [0.5]
