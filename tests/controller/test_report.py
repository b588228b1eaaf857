"""Report of the controller: costs by task, what limits the motion, the parts of the load torque."""

from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.controller import PositionTask, PostureTask, RobotModel
from support.controller import JOINTS, MIDDLE, ROBOT, SETTINGS, FixedRows, controller, wander


def test_tasks_that_agree_cost_nothing_and_nothing_limits_them() -> None:
    control = controller()
    control.posture.target = MIDDLE + 0.05
    control.step()
    assert all(report.cost < 1e-6 for report in control.report())
    assert control.explain() == "Nothing limits the motion."


def test_two_tasks_that_disagree_share_the_cost_by_hand() -> None:
    """w1 (a - a1)^2 + w2 (a - a2)^2 is least at the weighted mean: what is left of each is known."""
    control = controller()
    w1, w2, k = SETTINGS.posture.weight, 30.0, SETTINGS.posture.stiffness
    other = PostureTask(("HeadYaw",), stiffness=k, weight=w2, name="other")
    other.target = [0.2]
    control.add(other)
    control.step()
    mean = w2 * k * 0.2 / (w1 + w2)
    costs = {report.name: report.cost for report in control.report()}
    assert costs["posture"] == pytest.approx(w1 * mean**2, rel=1e-4)
    assert costs["other"] == pytest.approx(w2 * (k * 0.2 - mean) ** 2, rel=1e-4)
    assert sum(report.cost_fraction for report in control.report()) == pytest.approx(1.0)
    assert control.report()[0].name == "posture"  # the dearer one first
    by_name = {report.name: report for report in control.report()}
    assert by_name["other"].error == pytest.approx([0.2])
    assert by_name["other"].acceleration_error == pytest.approx([mean - k * 0.2], rel=1e-4)
    assert "posture" in control.explain()
    assert "other" in control.explain()


@pytest.mark.parametrize("kind", ["acceleration", "velocity", "position"])
def test_the_limit_that_holds_a_joint_back_is_named(kind: str) -> None:
    control = controller()
    control.posture.stiffness = 1000.0
    target = MIDDLE.copy()
    joint = ROBOT.joint_index("LShoulderPitch")
    target[joint] = ROBOT.upper[joint]
    control.posture.target = target
    seen = set()
    for _ in range(250):
        control.step()
        for name, limit in control.status.at_limit:
            assert name == "LShoulderPitch"
            seen.add(limit)
            if limit == kind:
                assert f"LShoulderPitch ({kind})" in control.explain()
    assert kind in seen


def test_active_and_violated_rows_are_distinguished() -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    matrix = np.zeros((1, 20))
    matrix[0, 3 + ROBOT.joint_index("LShoulderPitch")] = 1.0
    rows = FixedRows(matrix, np.array([0.1]))
    control.add(rows)
    control.step()
    assert control.status.active == ("row 0",)
    assert control.status.violated == ()
    assert "Active constraints: row 0" in control.explain()
    control.remove(rows)
    impossible = FixedRows(np.vstack([matrix, -matrix]), np.array([-1.0, -1.0]))
    control.add(impossible)
    control.step()
    assert control.status.solver == "relaxed"
    assert "relaxed by priority" in control.explain()


def test_a_joint_beyond_its_limit_is_explained() -> None:
    control = controller()
    start = MIDDLE.copy()
    start[3] = ROBOT.upper[3] + 0.05
    control.reset(start)
    control.step()
    assert "Relaxed limits: HeadYaw position" in control.explain()


def test_the_load_torque_is_the_sum_of_its_parts_at_the_end_of_the_cycle() -> None:
    control = controller()
    reference = wander(control, 40, seed=3)[-1]
    parts = control.load_torque_parts()
    whole = parts.inertial + parts.coriolis + parts.gravity
    np.testing.assert_allclose(whole, reference.load_torque, atol=1e-10)
    model = RobotModel(ROBOT)
    np.testing.assert_allclose(parts.gravity, model.gravity_torque(reference.position), atol=1e-10)
    # M(q) a is linear in a, C(q, v) v quadratic in v.
    q, zero = model.configuration(reference.position), np.zeros(20)
    v = np.concatenate([reference.base_twist, reference.velocity])
    once = model.load_torque_parts(q, v, zero).coriolis
    twice = model.load_torque_parts(q, 2 * v, zero).coriolis
    np.testing.assert_allclose(twice, 4 * once, atol=1e-9)
    np.testing.assert_allclose(parts.coriolis, once, atol=1e-9)
    assert np.abs(parts.inertial).max() > 0.01
    assert parts.inertial.shape == (JOINTS,)


def test_what_is_neither_task_nor_constraint_is_refused() -> None:
    control = controller()
    with pytest.raises(TypeError, match="task or a constraint"):
        control.add("posture")  # type: ignore[arg-type]


def test_an_error_is_none_before_the_first_cycle_with_the_task() -> None:
    control = controller()
    task = PositionTask("l_wrist")
    assert np.isnan(task.error).all()
    assert not task.reached(10.0)
    control.add(task)
    assert not task.reached(10.0)
    control.step()
    assert task.reached(1e-3)
