"""Relaxation of rows that exclude each other: which, in which order, and by how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel, WholeBodyController
from pepper_driver.controller.constraints import BrakingLimits, Constraint, LinearInequality
from pepper_driver.controller.solvers.solver import Solution
from support.controller import MIDDLE, ROBOT, SETTINGS, FixedRows, controller

YAW, LEFT, RIGHT = (3 + ROBOT.joint_index(n) for n in ("HeadYaw", "LElbowYaw", "RElbowYaw"))


class Ranked(FixedRows):
    """One row sign * a[column] <= bound."""

    def __init__(self, rank: int, column: int, sign: float, bound: float) -> None:
        matrix = np.zeros((1, 20))
        matrix[0, column] = sign
        super().__init__(matrix, np.array([bound]))
        self.priority = rank


def solved(*constraints: Constraint) -> tuple[FloatArray, WholeBodyController]:
    """(20,) accelerations of one cycle; the task of the joints is to stay."""
    control = controller()
    for constraint in constraints:
        control.add(constraint)
    a = control.step().acceleration
    return np.concatenate([np.zeros(3), a]), control


@pytest.mark.parametrize("ranks", [(0, 1), (0, 4), (2, 3)])
def test_of_two_rows_that_exclude_each_other_the_higher_rank_is_kept(
    ranks: tuple[int, int],
) -> None:
    low, high = ranks
    a, control = solved(Ranked(low, YAW, 1.0, -2.0), Ranked(high, YAW, -1.0, -3.0))
    assert control.status.solver == "relaxed"
    assert a[YAW] == pytest.approx(3.0, abs=1e-4)
    a, _ = solved(Ranked(high, YAW, 1.0, -2.0), Ranked(low, YAW, -1.0, -3.0))
    assert a[YAW] == pytest.approx(-2.0, abs=1e-4)


def test_a_row_of_high_rank_that_cannot_be_kept_does_not_take_others_with_it() -> None:
    """Rank 4 asks for more than the box has; rank 2 and rank 0 disagree on another joint: 2 prevails all the same."""
    beyond = Ranked(4, LEFT, -1.0, -20.2)  # 20 is the limit
    a, control = solved(Ranked(0, YAW, 1.0, -10.0), Ranked(2, YAW, -1.0, 0.0), beyond)
    assert control.status.solver == "relaxed"
    assert a[LEFT] == pytest.approx(20.0, abs=1e-4)
    assert a[YAW] == pytest.approx(0.0, abs=1e-3)


def test_rows_of_very_different_size_are_broken_alike() -> None:
    small, large = Ranked(0, LEFT, -1e-4, -25e-4), Ranked(0, RIGHT, -1e3, -25e3)
    a, _ = solved(small, large)
    assert a[[LEFT, RIGHT]] == pytest.approx([20.0, 20.0], abs=1e-4)
    against = Ranked(0, LEFT, 1.0, 0.0), Ranked(0, RIGHT, 1.0, 0.0)
    a, _ = solved(small, large, *against)
    assert a[LEFT] == pytest.approx(a[RIGHT], abs=1e-2)


class Unsure:
    """Solves nothing, and says that it did not converge."""

    name = "unsure"

    def solve(self, H: FloatArray, g: FloatArray, *_: FloatArray) -> Solution:
        return Solution(np.zeros(len(g)), "failed")


def test_a_solver_that_does_not_converge_gives_nothing_up() -> None:
    control, exact = controller(), controller()
    control._solver = Unsure()
    for each in (control, exact):
        each.posture.target = MIDDLE + 0.2
        each.add(Ranked(0, YAW, 1.0, 0.1))
        for _ in range(50):
            reference = each.step()
            assert each.status.solver == "solved"
    np.testing.assert_array_equal(control.position, exact.position)
    assert reference.acceleration[3] <= 0.1 + 1e-9


class Misshapen(Constraint):
    """A user's mistake."""

    name = "mine"
    needs_kinematics = False

    def __init__(self, rows: LinearInequality) -> None:
        self._rows = rows

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality:
        return self._rows


@pytest.mark.parametrize(
    "rows",
    [
        LinearInequality(np.zeros((1, 17)), np.zeros(1), ("a",)),
        LinearInequality(np.zeros((2, 20)), np.zeros(1), ("a",)),
        LinearInequality(np.zeros((1, 20)), np.zeros(1), ()),
        LinearInequality(np.full((1, 20), np.nan), np.zeros(1), ("a",)),
    ],
)
def test_rows_that_are_none_brake_the_robot_and_are_named(rows: LinearInequality) -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    for _ in range(40):
        control.step()
    mine = Misshapen(rows)
    control.add(mine)
    for _ in range(100):
        reference = control.step()
        assert control.status.solver == "failed"
        assert control.status.violated == ("mine",)
    assert np.abs(reference.velocity).max() < 1e-9
    assert "mine" in control.explain()
    control.remove(mine)
    control.step()
    assert control.status.solver == "solved"


def test_constraints_that_agree_only_one_after_the_other_are_all_asked() -> None:
    """Two lazy constraints: what the rows of one make of the motion breaks the other."""

    class Lazy(Ranked):
        lazy = True
        asked = 0

        def is_satisfied(
            self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
        ) -> bool:
            type(self).asked += 1
            rows = self._rows
            return bool((rows.matrix @ acceleration <= rows.bound + 1e-9).all())

    push = Lazy(0, LEFT, -1.0, -1.0)  # a >= 1
    matrix = np.zeros((1, 20))
    matrix[0, LEFT], matrix[0, RIGHT] = 1.0, 1.0
    couple = Lazy(0, LEFT, 1.0, 0.0)
    couple._rows = LinearInequality(
        matrix, np.zeros(1), ("both",)
    )  # a_left + a_right <= 0: kept at rest
    a, control = solved(push, couple)
    assert control.status.solver == "solved"
    assert a[LEFT] == pytest.approx(1.0, abs=1e-6)
    assert a[RIGHT] <= -1.0 + 1e-6


@pytest.mark.parametrize("dt", [0.0, -0.012, np.nan, np.inf, "12"])
def test_a_cycle_that_is_no_time_is_refused(dt: float) -> None:
    with pytest.raises(ValueError, match="dt must be"):
        WholeBodyController(ROBOT, replace(SETTINGS), dt=dt)
