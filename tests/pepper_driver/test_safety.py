"""The gate: nothing outside the limits leaves it, whatever comes in, and every fault ends in standing still."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pepper_driver.backends import Command
from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings
from pepper_driver.controller import Reference
from pepper_driver.safety import FaultError, RobotState, SafetyGate

from fakes import FakeBackend, aged, displaced  # isort: skip

ROBOT = load_robot()
SAFETY = load_safety_settings()
CONTROLLER = load_controller_settings(ROBOT)
STAND = ROBOT.posture("Stand")
ONES, STILL = np.ones(17), np.zeros(3)
Array = NDArray[np.float64]


def gate() -> SafetyGate:
    gate = SafetyGate(ROBOT, SAFETY, CONTROLLER)
    gate.activate(STAND)
    return gate


def reference(position: Array) -> Reference:
    zero = np.zeros(17)
    return Reference(
        position=position, velocity=zero, acceleration=zero, load_torque=zero, base_twist=STILL
    )


angles = st.lists(
    st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=17, max_size=17
)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(angles, angles, st.floats(0, 0.2)), min_size=1, max_size=5))
def test_nothing_outside_the_limits_ever_leaves(
    inputs: list[tuple[list[float], list[float], float]],
) -> None:
    g = gate()
    speed = SAFETY.speed_margin * np.array(
        [CONTROLLER.velocity_limit[n] for n in ROBOT.joint_names]
    )
    before = g.sent
    for wanted, stiffness, age in inputs:
        gated = g.gate(reference(np.array(wanted)), np.array(stiffness), np.array(wanted[:3]), age)
        sent = gated.command
        assert np.isfinite(sent.position).all()
        assert (sent.position >= ROBOT.lower).all()
        assert (sent.position <= ROBOT.upper).all()
        assert (np.abs(sent.position - before.position) <= speed * ROBOT.cycle + 1e-12).all()
        assert (sent.stiffness >= 0).all()
        assert (sent.stiffness <= 1).all()
        assert (np.abs(sent.wheel_speed) <= ROBOT.wheels.speed_limit).all()
        before = sent


def test_a_reference_within_the_limits_passes_unchanged() -> None:
    g = gate()
    wanted = STAND + 0.005
    gated = g.gate(reference(wanted), ONES, np.array([0.1, 0.2, 0.3]), 0.0)
    np.testing.assert_array_equal(gated.command.position, wanted)
    np.testing.assert_array_equal(gated.command.wheel_speed, [0.1, 0.2, 0.3])
    assert not gated.changed.any()


def test_a_small_step_over_a_position_limit_is_clamped() -> None:
    g = SafetyGate(ROBOT, SAFETY, CONTROLLER)
    for limit, side in ((ROBOT.upper, 1), (ROBOT.lower, -1)):
        g.activate(limit)
        gated = g.gate(reference(limit + side * 0.002), ONES, STILL, 0.0)
        np.testing.assert_array_equal(gated.command.position, limit)
        assert gated.changed.all()
        g.deactivate()


def test_a_jump_is_clamped_and_flagged_joint_by_joint() -> None:
    g = gate()
    wanted = STAND.copy()
    wanted[6] += 0.5
    gated = g.gate(reference(wanted), ONES, STILL, 0.0)
    assert gated.changed.tolist() == [i == 6 for i in range(17)]
    assert 0 < gated.command.position[6] - STAND[6] < 0.05


def test_old_data_hold_the_robot_and_new_data_let_it_go_on() -> None:
    g = gate()
    wanted = STAND + 0.005
    g.gate(reference(STAND), ONES, np.ones(3), 0.0)
    np.testing.assert_array_equal(g.sent.wheel_speed, 1.0)
    held = g.gate(reference(wanted), ONES, np.ones(3), SAFETY.stale_hold + 0.001)
    np.testing.assert_array_equal(held.command.position, STAND)
    np.testing.assert_array_equal(held.command.wheel_speed, 0.0)
    assert held.changed.all()
    assert g.state is RobotState.ACTIVE
    assert not g.gate(reference(wanted), ONES, STILL, 0.0).changed.any()


def faulted(g: SafetyGate) -> bool:
    """Whether the gate is in FAULT, and stays there holding still."""
    if g.state is not RobotState.FAULT:
        return False
    before = g.sent.position.copy()
    for _ in range(3):
        gated = g.gate(reference(STAND + 0.01), ONES, np.ones(3), 0.0)
        np.testing.assert_array_equal(gated.command.position, before)
        np.testing.assert_array_equal(gated.command.wheel_speed, 0.0)
    g.deactivate()
    with pytest.raises(FaultError):
        g.activate(STAND)
    return g.state is RobotState.FAULT


@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_reference_that_is_no_number_is_a_fault(part: int) -> None:
    g = gate()
    parts = [STAND.copy(), ONES.copy(), STILL.copy()]
    parts[part][1] = np.nan
    g.gate(reference(parts[0]), parts[1], parts[2], 0.0)
    assert "not a number" in g.fault
    assert faulted(g)


@pytest.mark.parametrize("age", [SAFETY.stale_fault + 0.001, np.nan, np.inf])
def test_a_silent_robot_is_a_fault(age: float) -> None:
    g, backend = gate(), FakeBackend()
    g.watch(aged(age)(backend.open()), g.sent)
    assert "old" in g.fault
    assert faulted(g)


def test_a_sample_whose_age_is_no_number_is_old() -> None:
    g = gate()
    held = g.gate(reference(STAND + 0.005), ONES, STILL, np.nan)
    np.testing.assert_array_equal(held.command.position, STAND)


@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_command_of_the_wrong_size_is_a_fault(part: int) -> None:
    g = gate()
    parts = [STAND.copy(), ONES.copy(), STILL.copy()]
    parts[part] = parts[part][:-1]
    gated = g.gate(reference(parts[0]), parts[1], parts[2], 0.0)
    np.testing.assert_array_equal(gated.command.position, STAND)
    assert gated.changed.all()
    assert faulted(g)


def test_a_sensor_that_is_no_number_is_a_fault() -> None:
    g, backend = gate(), FakeBackend()
    g.watch(displaced(2, np.nan)(backend.open()), g.sent)
    assert faulted(g)


def test_a_joint_far_from_its_command_is_a_fault_after_a_while() -> None:
    g, backend = gate(), FakeBackend()
    far = displaced(6, SAFETY.divergence + 0.1)(backend.open())
    near = backend.open()
    ticks = round(SAFETY.divergence_time / ROBOT.cycle)
    for _ in range(ticks):
        g.watch(far, g.sent)
    assert g.state is RobotState.ACTIVE
    g.watch(near, g.sent)  # back again: the count starts anew
    for _ in range(ticks):
        g.watch(far, g.sent)
    assert g.state is RobotState.ACTIVE
    g.watch(far, g.sent)
    assert "LShoulderRoll" in g.fault
    assert faulted(g)


def test_a_joint_without_stiffness_may_be_moved_by_hand() -> None:
    g, backend = gate(), FakeBackend()
    soft = Command(position=STAND, stiffness=np.zeros(17), wheel_speed=STILL)
    for _ in range(200):
        g.watch(displaced(6, 1.0)(backend.open()), soft)
    assert g.state is RobotState.ACTIVE


def test_stiffness_changes_by_a_ramp() -> None:
    g = gate()
    steps = [
        g.gate(reference(STAND), np.zeros(17), STILL, 0.0).command.stiffness[0] for _ in range(100)
    ]
    assert steps[0] == pytest.approx(1.0 - ROBOT.cycle / SAFETY.stiffness_ramp)
    assert steps[-1] == 0.0


def test_an_inactive_gate_lets_nothing_through() -> None:
    g = SafetyGate(ROBOT, SAFETY, CONTROLLER)
    assert g.state is RobotState.INACTIVE
    gated = g.gate(reference(STAND + 0.01), ONES, np.ones(3), 0.0)
    np.testing.assert_array_equal(gated.command.stiffness, 0.0)
    np.testing.assert_array_equal(gated.command.wheel_speed, 0.0)
