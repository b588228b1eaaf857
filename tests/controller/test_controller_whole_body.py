"""The controller's cycle: integration, solvers, constraints, the gate's feedback, determinism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference, RobotModel, TargetError, WholeBodyController
from support.controller import (
    ACCELERATION,
    BASE_ACCELERATION,
    BASE_VELOCITY,
    DT,
    JOINTS,
    MIDDLE,
    ROBOT,
    SETTINGS,
    VELOCITY,
    FixedRows,
    controller,
    wander,
)

TEN_SECONDS = round(10 / DT)


def stack(references: list[Reference], field: str) -> FloatArray:
    return np.array([getattr(reference, field) for reference in references])


def max_difference(one: list[Reference], other: list[Reference], field: str) -> float:
    return float(np.abs(stack(one, field) - stack(other, field)).max())


# -- integration ------------------------------------------------------------------------------------------------


def test_a_reference_belongs_to_one_instant() -> None:
    control = controller()
    model = RobotModel(ROBOT)
    position, velocity, twist = MIDDLE, np.zeros(JOINTS), np.zeros(3)
    for reference in wander(control, 600, seed=0):
        a = reference.acceleration
        expected = position + velocity * DT + a * DT**2 / 2
        assert np.abs(reference.position - expected).max() < 1e-13
        assert np.abs(reference.velocity - (velocity + a * DT)).max() < 1e-13
        v, acceleration = np.empty(20), np.empty(20)
        v[:3], v[model.joint_columns] = reference.base_twist, reference.velocity
        acceleration[:3] = (reference.base_twist - twist) / DT
        acceleration[model.joint_columns] = a
        torque = model.load_torque(model.configuration(reference.position), v, acceleration)
        assert np.abs(reference.load_torque - torque).max() < 1e-9
        position, velocity, twist = reference.position, reference.velocity, reference.base_twist
    assert np.array_equal(control.position, position)


def test_standing_still_the_load_is_gravity() -> None:
    control = controller()
    reference = control.step()
    assert np.abs(reference.acceleration).max() < 1e-12
    expected = control.model.gravity_torque(MIDDLE)
    assert np.abs(reference.load_torque - expected).max() < 1e-9


def test_references_do_not_change_afterwards() -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    reference = control.step()
    fields = ("position", "velocity", "acceleration", "load_torque", "base_twist")
    kept = {field: getattr(reference, field).copy() for field in fields}
    control.position[:] = 0.0
    for _ in range(5):
        control.step()
    control.override_state(MIDDLE)
    assert all(np.array_equal(getattr(reference, field), kept[field]) for field in fields)


def test_long_runs_do_not_drift() -> None:
    control = controller()
    wander(control, 3000, seed=1)
    control.posture.target = MIDDLE + 0.1
    control.base_velocity.target = np.zeros(3)
    for _ in range(1200):
        reference = control.step()
    assert np.abs(reference.position - MIDDLE - 0.1).max() < 1e-7
    assert np.abs(reference.base_twist).max() < 1e-9


def test_reset_stands_still() -> None:
    control = controller()
    wander(control, 100, seed=2)
    start = ROBOT.posture(next(iter(ROBOT.postures)))
    control.reset(start)
    assert np.array_equal(control.position, start)
    assert np.array_equal(control.posture.target, start)
    for _ in range(50):
        reference = control.step()
    assert np.abs(reference.base_twist).max() < 1e-12
    inside = np.clip(
        start, ROBOT.lower + SETTINGS.position_margin, ROBOT.upper - SETTINGS.position_margin
    )
    assert (np.abs(reference.position - start) <= np.abs(inside - start) + 1e-9).all()


@pytest.mark.parametrize(
    "position", [np.full(JOINTS, np.nan), np.where(MIDDLE > 0, np.nan, MIDDLE)]
)
def test_reset_to_nonsense_changes_nothing(position: FloatArray) -> None:
    control, twin = controller(), controller()
    wander(control, 60, seed=3)
    wander(twin, 60, seed=3)
    with pytest.raises(TargetError):
        control.reset(position)
    assert np.array_equal(control.step().position, twin.step().position)


# -- solvers ----------------------------------------------------------------------------------------------------


def test_osqp_takes_the_same_path_as_daqp() -> None:
    exact = wander(controller("daqp"), TEN_SECONDS, seed=4)
    other = wander(controller("osqp"), TEN_SECONDS, seed=4)
    assert max_difference(exact, other, "position") < 1e-6
    assert max_difference(exact, other, "load_torque") < 1e-4


@pytest.mark.parametrize(("solver", "error"), [("daqp", 1e-9), ("osqp", 1e-6)])
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_the_unit_of_the_weights_does_not_matter(solver: str, error: float, scale: float) -> None:
    control, scaled = controller(solver), controller(solver)
    for task in scaled.tasks:
        task.weight *= scale
    one, other = wander(control, TEN_SECONDS, seed=5), wander(scaled, TEN_SECONDS, seed=5)
    assert max_difference(one, other, "position") < error


@pytest.mark.parametrize("weight", [0.1, 1e5])
def test_the_weight_of_the_base_does_not_soften_the_posture(weight: float) -> None:
    control, other = controller(), controller()
    other.base_velocity.weight = weight
    one, two = wander(control, 500, seed=6), wander(other, 500, seed=6)
    assert max_difference(one, two, "position") < 2e-5


def test_unknown_solvers_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="daqp"):
        WholeBodyController(ROBOT, replace(SETTINGS, solver="quadprig"))


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_the_same_inputs_give_the_same_bits(solver: str) -> None:
    one, two = controller(solver), controller(solver)
    first = wander(one, 400, seed=7)
    second = wander(two, 400, seed=7)
    for field in ("position", "velocity", "acceleration", "load_torque", "base_twist"):
        assert np.array_equal(stack(first, field), stack(second, field)), field


# -- constraints ------------------------------------------------------------------------------------------------


def row(joint: str, sign: float = 1.0) -> FloatArray:
    matrix = np.zeros((1, 20))
    matrix[0, RobotModel(ROBOT).joint_columns[ROBOT.joint_index(joint)]] = sign
    return matrix


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_a_row_is_kept_and_touches_only_its_joint(solver: str) -> None:
    control, free = controller(solver), controller(solver)
    joint = ROBOT.joint_index("LShoulderPitch")
    rows = FixedRows(row("LShoulderPitch"), np.array([0.5]))
    control.add(rows)
    control.add(rows)
    for each in (control, free):
        each.posture.target = ROBOT.upper
    held, unheld = ([each.step() for _ in range(60)] for each in (control, free))
    assert control.status.solver == "solved"
    assert stack(held, "acceleration")[:, joint].max() <= 0.5 + 1e-5
    assert stack(unheld, "acceleration")[:, joint].max() > 5
    others = np.delete(stack(held, "position") - stack(unheld, "position"), joint, axis=1)
    assert np.abs(others).max() < 1e-6
    control.remove(rows)
    control.step()
    assert np.abs(control.step().acceleration[joint]) > 1


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
@pytest.mark.parametrize("layout", ["whole numbers", "by columns", "every second", "read-only"])
def test_rows_of_a_user_may_be_of_any_layout(solver: str, layout: str) -> None:
    matrix = np.concatenate([row("LShoulderPitch"), row("HeadYaw")])
    plain, bound = FixedRows(matrix, np.array([1.0, 2.0])), np.array([1.0, 2.0])
    if layout == "whole numbers":
        rows = FixedRows(matrix.astype(np.int64), bound.astype(np.int32))
    elif layout == "by columns":
        rows = FixedRows(np.asfortranarray(matrix), bound)
    elif layout == "every second":
        rows = FixedRows(np.repeat(matrix, 2, axis=1)[:, ::2], np.repeat(bound, 2)[::2])
    else:
        matrix, bound = matrix.copy(), bound.copy()
        matrix.flags.writeable = bound.flags.writeable = False
        rows = FixedRows(matrix, bound)
    control, expected = controller(solver), controller(solver)
    control.add(rows)
    expected.add(plain)
    for each in (control, expected):
        each.posture.target = ROBOT.upper
    for _ in range(30):
        found = control.step().acceleration
        np.testing.assert_array_equal(found, expected.step().acceleration)
        assert control.status.solver == "solved"
    assert control.status.active == expected.status.active


def test_a_row_that_couples_joints_shares_by_weight() -> None:
    """qdd_a + qdd_b <= 0 with equal wishes w: by symmetry both stay where they are."""
    control = controller()
    left, right = ROBOT.joint_index("LShoulderPitch"), ROBOT.joint_index("RShoulderPitch")
    control.add(FixedRows(row("LShoulderPitch") + row("RShoulderPitch"), np.zeros(1)))
    target = MIDDLE.copy()
    target[left], target[right] = target[left] + 0.2, target[right] + 0.4
    control.posture.target = target
    a = control.step().acceleration
    assert a[left] == pytest.approx(-SETTINGS.posture.stiffness * 0.1, rel=1e-4)
    assert a[right] == pytest.approx(SETTINGS.posture.stiffness * 0.1, rel=1e-4)


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
@pytest.mark.parametrize(
    ("matrix", "bound"),
    [
        (row("HeadYaw"), np.array([-1e31])),
        (row("HeadYaw"), np.array([np.nan])),
    ],
)
def test_rows_without_solution_brake_to_rest(
    solver: str, matrix: FloatArray, bound: FloatArray
) -> None:
    control = controller(solver)
    control.posture.target = ROBOT.upper
    control.base_velocity.target = np.array([0.3, -0.3, 0.5])
    for _ in range(40):
        before = control.step()
    assert np.abs(before.velocity).max() > 0.3
    rows = FixedRows(matrix, bound)
    control.add(rows)
    slowest = np.ceil(
        max((VELOCITY / ACCELERATION / 0.9).max(), (BASE_VELOCITY / BASE_ACCELERATION).max()) / DT
    )
    for _ in range(int(slowest) + 2):
        reference = control.step()
        assert control.status.solver == ("failed" if np.isnan(bound).any() else "infeasible")
        assert control.status.violated == (("rows",) if np.isnan(bound).any() else ("row 0",))
        assert (np.abs(reference.velocity) <= np.abs(before.velocity) + 1e-12).all()
        assert (np.abs(reference.acceleration) <= ACCELERATION + 1e-9).all()
        change = np.abs(reference.base_twist - before.base_twist)
        assert (change <= BASE_ACCELERATION * DT + 1e-12).all()
        assert (reference.position <= ROBOT.upper).all()
        before = reference
    assert np.abs(reference.velocity).max() < 1e-12
    assert np.abs(reference.base_twist).max() < 1e-12
    control.remove(rows)
    control.posture.target = MIDDLE
    for _ in range(1000):
        control.step()
    assert control.status.solver == "solved"
    assert np.abs(control.position - MIDDLE).max() < 1e-5


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
@pytest.mark.parametrize(
    ("matrix", "bound"),
    [
        (np.zeros((1, 20)), np.array([-1.0])),
        (np.concatenate([row("HeadYaw"), row("HeadYaw", -1.0)]), np.array([1.0, -2.0])),
    ],
)
def test_rows_that_contradict_each_other_are_relaxed_and_the_rest_goes_on(
    solver: str, matrix: FloatArray, bound: FloatArray
) -> None:
    control = controller(solver)
    control.posture.target = ROBOT.upper
    control.add(FixedRows(matrix, bound))
    for _ in range(1500):
        reference = control.step()
        assert control.status.solver == "relaxed"
        assert set(control.status.violated) & {"row 0", "row 1"}
        assert (np.abs(reference.acceleration) <= ACCELERATION + 1e-9).all()
        assert (np.abs(reference.velocity) <= VELOCITY + 1e-9).all()
    others = np.arange(JOINTS) != ROBOT.joint_index("HeadYaw")
    reached = np.abs(reference.position - (ROBOT.upper - SETTINGS.position_margin))[others]
    assert reached.max() < 1e-3


# -- the gate ---------------------------------------------------------------------------------------------------


def moving() -> WholeBodyController:
    control = controller()
    control.posture.target = ROBOT.upper
    for _ in range(30):
        control.step()
    return control


def test_a_clamped_joint_goes_on_from_what_was_sent() -> None:
    control, twin = moving(), moving()
    joint = ROBOT.joint_index("RElbowYaw")
    before = control.position
    reference, same = control.step(), twin.step()
    assert np.array_equal(reference.position, same.position)
    sent = reference.position.copy()
    sent[joint] = before[joint] + 0.25 * (sent[joint] - before[joint])
    assert sent[joint] != reference.position[joint]
    control.override_state(sent)
    assert np.array_equal(control.position, sent)
    following, free = control.step(), twin.step()
    step = following.position - sent
    assert abs(step[joint]) <= 1.01 * VELOCITY[joint] * DT
    # It has the speed that the sent positions had, and speeds up from there.
    speed = (sent[joint] - before[joint]) / DT
    change = following.velocity[joint] - speed
    assert change == pytest.approx(following.acceleration[joint] * DT, abs=1e-12)
    assert np.abs(np.delete(following.position - free.position, joint)).max() < 1e-12
    assert np.abs(np.delete(following.velocity - free.velocity, joint)).max() < 1e-10
    for _ in range(1500):
        reference = control.step()
    expected = ROBOT.upper - SETTINGS.position_margin
    assert np.abs(reference.position - expected).max() < 1e-3


def test_a_gate_that_changes_nothing_has_no_effect() -> None:
    control, twin = moving(), moving()
    for _ in range(20):
        control.override_state(control.step().position)
        twin.step()
    assert np.array_equal(control.position, twin.position)


def test_a_gate_that_holds_the_robot_holds_the_controller() -> None:
    control = moving()
    held = control.position
    for _ in range(100):
        reference = control.step()
        control.override_state(held)
        assert np.array_equal(control.position, held)
    # From rest, one cycle's acceleration: no speed has wound up behind the gate.
    assert (np.abs(reference.position - held) <= ACCELERATION * DT**2 / 2 + 1e-12).all()


def test_a_gate_that_jumps_does_not_throw_the_joint() -> None:
    control = moving()
    control.step()
    far = MIDDLE - 0.2
    control.override_state(far)
    previous = far
    for _ in range(300):
        reference = control.step()
        assert (np.abs(reference.position - previous) <= 1.01 * VELOCITY * DT).all()
        assert (np.abs(reference.velocity) <= VELOCITY + 1e-9).all()
        assert (reference.position <= ROBOT.upper).all()
        assert (reference.position >= ROBOT.lower).all()
        previous = reference.position


def test_a_gate_that_limits_the_speed_slows_the_controller_without_winding_it_up() -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    sent = control.position
    allowed = 0.3 * VELOCITY * DT
    for _ in range(1500):
        reference = control.step()
        sent = sent + np.clip(reference.position - sent, -allowed, allowed)
        control.override_state(sent)
        assert (np.abs(reference.position - sent) <= VELOCITY * DT).all()
    expected = ROBOT.upper - SETTINGS.position_margin
    assert np.abs(sent - expected).max() < 5e-3
