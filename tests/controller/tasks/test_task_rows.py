"""Rows of a task: what an author assigns is what the QP gets, or it is refused by name and shape."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel, ShapeError, Task, TaskRows, WholeBodyController
from support.controller import JOINTS, ROBOT, controller

GOAL = np.array([0.25, 0.20, 0.90])


class Assigning(Task):
    """The left wrist goes to a point of base_link, written as one writes it first."""

    def __init__(self) -> None:
        super().__init__(3, stiffness=20.0, weight=1000.0)

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        rows.error, rows.jacobian = wrist(model)
        rows.bias = np.zeros(3)


class Filling(Assigning):
    """The same, filled in place."""

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        rows.error[:], rows.jacobian[:] = wrist(model)


def wrist(model: RobotModel) -> tuple[FloatArray, FloatArray]:
    jacobian = np.zeros((3, model.nv))
    jacobian[:, model.joint_columns] = model.point_jacobian(
        "l_wrist", np.zeros(3), model.joint_position
    )
    return GOAL - model.link_pose("l_wrist", model.joint_position)[:3, 3], jacobian


def moved_by(task: Task) -> WholeBodyController:
    control = controller()
    control.reset(ROBOT.posture("Stand"))
    control.add(task)
    for _ in range(150):
        control.step()
    return control


def test_what_is_assigned_moves_the_robot_as_what_is_filled_in() -> None:
    assigned, filled = Assigning(), Filling()
    one, other = moved_by(assigned), moved_by(filled)
    np.testing.assert_array_equal(one.position, other.position)
    reached = one.model.link_pose("l_wrist", one.position)[:3, 3]
    assert np.abs(reached - GOAL).max() < 0.01
    np.testing.assert_allclose(assigned.error, GOAL - reached, atol=1e-3)
    assert assigned.reached(0.02)


def test_an_assigned_array_is_copied_and_the_rows_stay_those_of_the_qp() -> None:
    rows, mine = TaskRows.empty(2, 20), np.array([1.0, 2.0])
    of_qp = rows.error
    rows.error = mine
    mine[:] = 9.0
    assert rows.error is of_qp
    np.testing.assert_array_equal(of_qp, [1.0, 2.0])
    rows.error -= 1.0
    np.testing.assert_array_equal(of_qp, [0.0, 1.0])
    assert rows.error is of_qp


WRONG: list[tuple[str, Any, str]] = [
    (
        "jacobian",
        np.zeros((20, 2)),
        r"rows\.jacobian takes an array \(2, 20\) .* an array \(20, 2\)",
    ),
    ("jacobian", np.zeros((2, JOINTS)), r"\(2, 20\) .* \(2, 17\)"),
    ("jacobian", np.zeros(20), r"\(2, 20\) .* \(20,\)"),
    ("error", 0.3, r"rows\.error takes an array \(2,\) .* an array \(\)"),
    ("bias", np.zeros((2, 1)), r"rows\.bias .* \(2, 1\)"),
    ("error", "left", r"rows\.error .* got str"),
    ("error", [[0.0], [0.0, 1.0]], r"rows\.error .* got list"),
]


@pytest.mark.parametrize(("name", "value", "words"), WRONG)
def test_another_shape_is_refused_by_name_and_shape(name: str, value: Any, words: str) -> None:
    rows = TaskRows.empty(2, 20)
    with pytest.raises(ShapeError, match=words) as caught:
        setattr(rows, name, value)
    assert caught.value.name == f"rows.{name}"
    assert not getattr(rows, name).any()


def test_a_misspelt_field_is_refused() -> None:
    with pytest.raises(AttributeError, match=r"'jacobain'.*did you mean jacobian"):
        TaskRows.empty(2, 20).jacobain = np.zeros((2, 20))
