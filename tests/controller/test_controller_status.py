"""Reports of the controller on a cycle, commands of the safety gate, and the stop of idle joints."""

from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import TargetError, WholeBodyController
from support.controller import (
    ACCELERATION,
    DT,
    JOINTS,
    MIDDLE,
    ROBOT,
    VELOCITY,
    FixedRows,
    controller,
)


def outcome(control: WholeBodyController) -> tuple[str, tuple[str, ...]]:
    status = control.status
    return status.solver, (*status.relaxed, *status.violated)


def test_nothing_is_relaxed_in_an_ordinary_cycle() -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    control.posture.stiffness = 400.0
    for _ in range(300):
        control.step()
        assert outcome(control) == ("solved", ())


def test_a_joint_that_starts_beyond_its_limit_is_named_until_it_is_back() -> None:
    control = controller()
    start = MIDDLE.copy()
    head = ROBOT.joint_index("HeadYaw")
    start[head] = ROBOT.upper[head] + 0.05
    control.reset(start)
    control.step()
    assert outcome(control) == ("solved", ("HeadYaw position",))
    for _ in range(200):
        control.step()
    assert outcome(control) == ("solved", ())


def test_rows_that_could_not_be_kept_are_named() -> None:
    control = controller()
    matrix = np.zeros((2, control.model.nv))
    matrix[0, 5], matrix[1, 5] = 1.0, -1.0
    rows = FixedRows(matrix, np.array([-1.0, -1.0]))  # a <= -1 and a >= 1
    control.add(rows)
    control.step()
    assert outcome(control) == ("relaxed", ("row 0", "row 1"))
    assert control.step().acceleration[2] == pytest.approx(0.0, abs=1e-6)
    control.remove(rows)
    control.step()
    assert outcome(control) == ("solved", ())


def poisoned(value: float) -> FloatArray:
    position = MIDDLE.copy()
    position[3] = value
    return position


@pytest.mark.parametrize("position", [poisoned(np.nan), poisoned(np.inf), MIDDLE[:5], MIDDLE[None]])
def test_a_sent_position_that_is_none_changes_nothing(position: FloatArray) -> None:
    control, other = controller(), controller()
    for c in (control, other):
        c.posture.target = ROBOT.upper
        for _ in range(10):
            c.step()
    with pytest.raises(TargetError):
        control.override_state(position)
    for _ in range(5):
        assert np.array_equal(control.step().position, other.step().position)


@pytest.mark.parametrize("cut", [1e-4, 5e-3, 0.02])
def test_after_a_clamped_command_the_reference_goes_on_from_it(cut: float) -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    control.posture.stiffness = 50.0
    for _ in range(25):
        before, reference = control.position, control.step()
    joint = ROBOT.joint_index("RElbowYaw")
    sent = reference.position.copy()
    sent[joint] -= cut
    control.override_state(sent)
    assert np.array_equal(control.position, sent)
    speed = np.clip((sent - before) / DT, -VELOCITY, VELOCITY)[joint]
    after = control.step()
    assert abs(after.velocity[joint] - speed) <= ACCELERATION[joint] * DT + 1e-9
    distance = (speed + after.velocity[joint]) / 2 * DT
    assert after.position[joint] - sent[joint] == pytest.approx(distance, abs=1e-12)
    others = np.arange(JOINTS) != joint
    step = np.abs(after.velocity - reference.velocity)[others]
    assert (step <= ACCELERATION[others] * DT + 1e-9).all()


def test_a_command_held_again_and_again_stops_the_reference() -> None:
    """As the gate does with stale samples: the same command is sent in every cycle."""
    control = controller()
    control.posture.target = ROBOT.upper
    for _ in range(25):
        reference = control.step()
    held = reference.position
    for _ in range(5):
        reference = control.step()
        control.override_state(held)
        assert np.abs(reference.velocity).max() <= (ACCELERATION * DT).max() + VELOCITY.max()
    reference = control.step()
    assert (np.abs(reference.velocity) <= ACCELERATION * DT + 1e-9).all()


@pytest.mark.parametrize("idle", ["removed", "weightless"])
def test_what_no_task_asks_for_comes_to_rest(idle: str) -> None:
    control = controller()
    control.posture.target = ROBOT.upper
    for _ in range(60):
        reference = control.step()
    start, speed = reference.position, reference.velocity
    assert np.abs(speed).max() > 0.3
    if idle == "removed":
        control.remove(control.posture)
    else:
        control.posture.weight = 0.0
    for _ in range(400):
        reference = control.step()
    assert np.abs(reference.velocity).max() < 1e-6
    assert np.abs(reference.position - start - speed / 4.0)[3:].max() < 0.05
