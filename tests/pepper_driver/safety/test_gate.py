"""The gate: nothing outside the limits leaves it, whatever comes in, and every fault ends in standing still."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from pepper_driver.backends import Command
from pepper_driver.config.arrays import FloatArray
from pepper_driver.safety import FaultError, FaultReason, RobotState, SafetyGate, StateError
from pepper_driver.testing import (
    Fault,
    aged,
    displaced,
    drained,
    heated,
    pressed,
    standing_measurement,
)
from support.fakes import reference
from support.safety import (
    CONTROLLER,
    ONES,
    ROBOT,
    SAFETY,
    STAND,
    STILL,
    active_gate,
    new_gate,
)

SMALL = 0.0004
"""[rad] A step that no joint's acceleration forbids, from rest."""


def test_a_reference_within_the_limits_passes_unchanged() -> None:
    g = active_gate()
    requested = STAND + SMALL
    speeds = np.array([0.03, 0.02, 0.01])
    gated = g.gate(reference(requested), ONES, speeds, 0.0)
    np.testing.assert_array_equal(gated.command.position, requested)
    np.testing.assert_array_equal(gated.command.wheel_speed, speeds)
    assert not gated.limited.any()
    assert not gated.joints_limited
    assert not gated.wheels_limited
    assert not gated.limited.flags.writeable, "it is shared by all such commands"
    requested[3] += 1.0
    assert g.sent.position[3] != requested[3], "its maker may write to it"


def test_joints_that_can_just_brake_before_their_limits_pass_unchanged() -> None:
    """Joints speed up and end 0.8 changes before their limits, which braking in whole ticks allows."""
    g = new_gate()
    change = SAFETY.acceleration_margin * CONTROLLER.joint_acceleration(ROBOT) * ROBOT.cycle**2
    g.activate(ROBOT.upper - 3.3 * change)
    for away in (2.3, 0.8):
        requested = ROBOT.upper - away * change
        gated = g.gate(reference(requested), ONES, STILL, 0.0)
        np.testing.assert_array_equal(gated.command.position, requested)
        assert not gated.limited.any()
        assert not gated.joints_limited


def test_the_stiffness_of_a_caller_is_copied() -> None:
    g = active_gate()
    stiffness = ONES.copy()
    sent = g.gate(reference(STAND), stiffness, STILL, 0.0).command.stiffness
    stiffness[3] = 0.0
    assert sent[3] == 1.0


def test_a_small_step_over_a_position_limit_is_clamped() -> None:
    g = new_gate()
    for limit, side in ((ROBOT.upper, 1), (ROBOT.lower, -1)):
        g.activate(limit)
        gated = g.gate(reference(limit + side * SMALL), ONES, STILL, 0.0)
        np.testing.assert_array_equal(gated.command.position, limit)
        assert gated.limited.all()
        g.deactivate()


@pytest.mark.parametrize(("limit", "side"), [(ROBOT.upper, 1.0), (ROBOT.lower, -1.0)])
@pytest.mark.parametrize("inwards", [-1.0, 0.0, 0.5])
def test_a_robot_that_stands_beyond_its_limits_is_sent_within_them(
    limit: FloatArray, side: float, inwards: float
) -> None:
    """Readiness lets it start so far beyond them; it is asked to go on, to stay, or to come back."""
    beyond = 0.03
    assert beyond < SAFETY.limit_activate
    g = active_gate(limit + side * beyond)
    sent = [g.sent]
    for tick in range(50):
        requested = limit + side * (beyond - 0.02 * inwards * tick)
        sent.append(g.gate(reference(requested), ONES, STILL, 0.0).command)
    for command in sent:
        assert np.isfinite(command.position).all()
        assert (command.position >= ROBOT.lower).all()
        assert (command.position <= ROBOT.upper).all()
    assert g.state is RobotState.ACTIVE


def test_a_jump_is_clamped_and_flagged_joint_by_joint() -> None:
    g = active_gate()
    requested = STAND.copy()
    requested[6] += 0.5
    gated = g.gate(reference(requested), ONES, STILL, 0.0)
    assert gated.limited.tolist() == [i == 6 for i in range(17)]
    assert gated.joints_limited
    assert not gated.wheels_limited
    assert 0 < gated.command.position[6] - STAND[6] < 0.05


def test_old_data_brake_the_robot_and_new_data_let_it_go_on() -> None:
    g = active_gate()
    requested = STAND.copy()
    for step in range(1, 30):
        requested = requested.copy()
        requested[6] += min(step * SMALL, 0.02)
        assert not g.gate(reference(requested), ONES, np.full(3, 0.02), 0.0).joints_limited
    np.testing.assert_array_equal(g.sent.wheel_speed, 0.02)
    steps = []
    for _ in range(30):
        before = g.sent.position
        held = g.gate(reference(requested), ONES, np.ones(3), SAFETY.stale_hold + 0.001)
        np.testing.assert_array_equal(held.command.wheel_speed, 0.0)
        assert held.wheels_limited
        steps.append(held.command.position[6] - before[6])
    assert 0.005 < steps[0] < 0.02
    assert (np.diff(steps) <= 1e-12).all()
    assert steps[-1] == 0.0
    assert g.state is RobotState.ACTIVE
    moved = STAND + SMALL
    exactly = active_gate().gate(reference(moved), ONES, STILL, SAFETY.stale_hold)
    np.testing.assert_array_equal(exactly.command.position, moved)
    assert not g.gate(reference(g.sent.position), ONES, STILL, 0.0).limited.any()


def faulted(g: SafetyGate) -> bool:
    """Return True if the gate is in FAULT, and stays there holding still."""
    if g.state is not RobotState.FAULT:
        return False
    before = g.sent.position.copy()
    for _ in range(3):
        gated = g.gate(reference(STAND + 0.01), ONES, np.ones(3), 0.0)
        assert gated.limited.any()
        assert gated.joints_limited
        assert gated.wheels_limited
        np.testing.assert_array_equal(gated.command.position, before)
        np.testing.assert_array_equal(gated.command.wheel_speed, 0.0)
    g.deactivate()
    with pytest.raises(FaultError):
        g.activate(STAND)
    return g.state is RobotState.FAULT


def assert_fault(g: SafetyGate, reason: FaultReason, word: str) -> None:
    assert g.fault is not None
    assert g.fault.reason is reason
    assert word in g.fault.text
    assert faulted(g)


@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_reference_that_is_no_number_is_a_fault(part: int) -> None:
    g = active_gate()
    parts = [STAND.copy(), ONES.copy(), STILL.copy()]
    parts[part][1] = np.nan
    g.gate(reference(parts[0]), parts[1], parts[2], 0.0)
    assert_fault(g, FaultReason.COMMAND, "not a number")
    np.testing.assert_array_equal(g.sent.position, STAND)
    np.testing.assert_array_equal(g.sent.stiffness, 1.0)


@pytest.mark.parametrize("age", [SAFETY.stale_fault + 0.001, np.nan, np.inf])
def test_a_silent_robot_is_a_fault(age: float) -> None:
    g = active_gate()
    g.watch(aged(age)(standing_measurement()), g.sent)
    assert_fault(g, FaultReason.STALE_SAMPLE, "old")


def test_how_old_the_newest_sample_is_stands_in_the_fault() -> None:
    g = active_gate()
    g.watch(aged(SAFETY.stale_fault)(standing_measurement()), g.sent)
    assert g.state is RobotState.ACTIVE, "exactly as old as it may be"
    g.watch(aged(1.0)(standing_measurement()), g.sent)
    assert_fault(g, FaultReason.STALE_SAMPLE, "the newest sample is 1000 ms old")


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        (heated("HeadYaw", SAFETY.temperature_fault), FaultReason.TEMPERATURE),
        (drained(SAFETY.battery_fault - 0.001), FaultReason.BATTERY),
    ],
)
@pytest.mark.parametrize("before", [0, 1, 40])
def test_heat_and_charge_are_looked_at_each_period_from_the_first_tick_on(
    harm: Fault, reason: FaultReason, before: int
) -> None:
    """And a fault when they are beyond the limit so many times in a row."""
    g, period = active_gate(), round(SAFETY.check_period / ROBOT.cycle)
    for _ in range(before * period):
        g.watch(standing_measurement(), g.sent)
    for _ in range(1 + (SAFETY.confirmations - 1) * period):
        assert g.state is RobotState.ACTIVE
        g.watch(harm(standing_measurement()), g.sent)
    assert_fault(g, reason, "")


@pytest.mark.parametrize("harm", [heated("HeadYaw", 99.0), drained(0.001)])
def test_heat_and_charge_that_were_well_once_are_counted_again(harm: Fault) -> None:
    g, period = active_gate(), round(SAFETY.check_period / ROBOT.cycle)
    for number in range(5 * SAFETY.confirmations):
        bad = number % SAFETY.confirmations != 0
        for _ in range(period):
            g.watch(harm(standing_measurement()) if bad else standing_measurement(), g.sent)
    assert g.state is RobotState.ACTIVE


def test_a_sample_whose_age_is_no_number_is_old() -> None:
    g = active_gate()
    held = g.gate(reference(STAND + 0.005), ONES, STILL, np.nan)
    np.testing.assert_array_equal(held.command.position, STAND)


@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_command_of_the_wrong_size_is_a_fault(part: int) -> None:
    g = active_gate()
    parts = [STAND.copy(), ONES.copy(), STILL.copy()]
    parts[part] = parts[part][:-1]
    gated = g.gate(reference(parts[0]), parts[1], parts[2], 0.0)
    np.testing.assert_array_equal(gated.command.position, STAND)
    assert gated.limited.all()
    assert_fault(g, FaultReason.COMMAND, "values")


@pytest.mark.parametrize(
    "stiffness", ["soft", None, [[1.0], [2.0, 3.0]], 1.0, np.float64(1.0), np.ones((17, 1))]
)
def test_a_stiffness_that_is_no_array_is_a_fault(stiffness: Any) -> None:
    g = active_gate()
    g.gate(reference(STAND), stiffness, STILL, 0.0)
    assert_fault(g, FaultReason.COMMAND, "stiffness")


def test_whole_numbers_and_lists_are_numbers() -> None:
    g = active_gate()
    requested, whole = (STAND + SMALL).tolist(), np.ones(17, dtype=np.int64)
    speeds: Any = [0.03, 0.02, 0.01]
    gated = g.gate(reference(requested), cast(Any, whole), speeds, 0.0)
    assert g.state is RobotState.ACTIVE
    assert not gated.limited.any()
    sent = gated.command
    for values, given in (
        (sent.position, requested),
        (sent.stiffness, ONES),
        (sent.wheel_speed, speeds),
    ):
        assert values.dtype == np.float64
        np.testing.assert_array_equal(values, given)


def with_gaps(values: FloatArray) -> FloatArray:
    return np.repeat(values, 2)[::2]


def of_other_bytes(values: FloatArray) -> FloatArray:
    return values.astype(">f8")


def off_the_word(values: FloatArray) -> FloatArray:
    """Not aligned."""
    raw = np.zeros(values.nbytes + 1, dtype=np.uint8)
    array = raw[1:].view(np.float64)
    array[:] = values
    return array


def not_to_be_written(values: FloatArray) -> FloatArray:
    array = values.copy()
    array.setflags(write=False)
    return array


ARRAYS = [with_gaps, of_other_bytes, off_the_word, not_to_be_written, np.float32]


@pytest.mark.parametrize("made", ARRAYS)
def test_arrays_of_any_make_are_numbers(made: Callable[[FloatArray], Any]) -> None:
    g, exact = active_gate(), active_gate()
    moved = (STAND + SMALL).astype(np.float32).astype(np.float64)  # exact in 32 bits
    half, speeds = np.full(17, 0.5), np.array([0.03125, 0.015625, 0.0])
    for _ in range(3):
        gated = g.gate(reference(made(moved)), made(half), made(speeds), 0.0)
        expected = exact.gate(reference(moved), half, speeds, 0.0)
    assert g.state is RobotState.ACTIVE
    for field in ("position", "stiffness", "wheel_speed"):
        values, numbers = getattr(gated.command, field), getattr(expected.command, field)
        assert values.dtype == np.dtype("=f8")
        np.testing.assert_array_equal(values, numbers)
    np.testing.assert_array_equal(gated.limited, expected.limited)
    assert gated.wheels_limited == expected.wheels_limited


@pytest.mark.parametrize("made", [*ARRAYS, np.ndarray.tolist])
def test_measurements_of_any_make_are_watched(made: Callable[[FloatArray], Any]) -> None:
    g = active_gate()
    standing = standing_measurement()
    sound = replace(standing, position=made(standing.position), stiffness=made(ONES))
    for _ in range(100):
        g.watch(sound, g.sent)
    assert g.state is RobotState.ACTIVE
    far = displaced("LShoulderRoll", SAFETY.following_error + 0.1)(standing)
    for _ in range(round(SAFETY.following_error_time / ROBOT.cycle) + 1):
        assert g.state is RobotState.ACTIVE
        g.watch(replace(far, position=made(far.position)), g.sent)
    assert_fault(g, FaultReason.FOLLOWING_ERROR, "LShoulderRoll")


@pytest.mark.parametrize("count", [16, 18])
def test_a_measurement_of_other_joints_is_an_error(count: int) -> None:
    """It stops the robot, as every error in a tick does."""
    g, standing, other = active_gate(), standing_measurement(), np.ones(count)
    for wrong in (replace(standing, position=other), replace(standing, stiffness=other)):
        with pytest.raises(ValueError, match="17 joints"):
            g.watch(wrong, g.sent)


def test_a_sensor_that_is_no_number_is_a_fault() -> None:
    g = active_gate()
    g.watch(displaced("HipRoll", np.nan)(standing_measurement()), g.sent)
    assert_fault(g, FaultReason.SENSOR, ROBOT.joint_names[2])


def test_a_joint_far_from_its_command_is_a_fault_after_a_while() -> None:
    g = active_gate()
    far = displaced("LShoulderRoll", SAFETY.following_error + 0.1)(standing_measurement())
    near = standing_measurement()
    ticks = round(SAFETY.following_error_time / ROBOT.cycle)
    for _ in range(ticks):
        g.watch(far, g.sent)
    assert g.state is RobotState.ACTIVE
    g.watch(near, g.sent)  # back again: the count starts again
    for _ in range(ticks):
        g.watch(far, g.sent)
    assert g.state is RobotState.ACTIVE
    g.watch(far, g.sent)
    assert_fault(g, FaultReason.FOLLOWING_ERROR, "LShoulderRoll")


def test_a_joint_without_stiffness_may_be_moved_by_hand() -> None:
    g = active_gate()
    soft = Command(position=STAND, stiffness=np.zeros(17), wheel_speed=STILL)
    for _ in range(200):
        g.watch(displaced("LShoulderRoll", 1.0)(standing_measurement()), soft)
    assert g.state is RobotState.ACTIVE


@pytest.mark.parametrize("ramp", [SAFETY.stiffness_ramp, 0.5])
def test_stiffness_changes_by_a_ramp_between_nothing_and_all(ramp: float) -> None:
    g = active_gate(stiffness_ramp=ramp)
    for requested, expected in ((-3.0, 0.0), (3.0, 1.0)):
        before = g.sent.stiffness[0]
        steps = [
            g.gate(reference(STAND), np.full(17, requested), STILL, 0.0).command.stiffness[0]
            for _ in range(100)
        ]
        assert abs(steps[0] - before) == pytest.approx(ROBOT.cycle / ramp)
        assert steps[-1] == expected


def test_an_inactive_gate_lets_nothing_through() -> None:
    g = new_gate()
    assert g.state is RobotState.INACTIVE
    assert g.sent.wheel_speed.shape == (3,)
    gated = g.gate(reference(STAND + 0.01), ONES, np.ones(3), 0.0)
    np.testing.assert_array_equal(gated.command.stiffness, 0.0)
    np.testing.assert_array_equal(gated.command.wheel_speed, 0.0)


def test_a_gate_that_is_activated_again_remembers_nothing_of_the_run_before() -> None:
    g = active_gate()
    speeds, pressed_bumper = np.full(3, 0.03), pressed("bumpers")(standing_measurement())
    far = displaced("LShoulderRoll", SAFETY.following_error + 0.1)(standing_measurement())
    assert not g.gate(reference(STAND), ONES, speeds, 0.0).wheels_limited
    g.watch(pressed_bumper, g.sent)
    assert g.base_stopped
    for _ in range(round(SAFETY.following_error_time / ROBOT.cycle)):
        g.watch(far, g.sent)
    soft = replace(standing_measurement(), stiffness=np.zeros(17))
    for _ in range(round(SAFETY.stiffness_time / ROBOT.cycle)):
        g.watch(soft, g.sent)
    g.deactivate()
    g.activate(STAND)
    assert g.base_stopped == ""
    # From rest the base takes its time, and the joint that was far counts from the start.
    begun = [
        h.gate(reference(STAND), ONES, np.full(3, 9.0), 0.0).command for h in (g, active_gate())
    ]
    np.testing.assert_array_equal(begun[0].wheel_speed, begun[1].wheel_speed)
    g.watch(far, g.sent)
    g.watch(soft, g.sent)
    assert g.state is RobotState.ACTIVE


def test_a_gate_is_activated_once() -> None:
    g = active_gate()
    with pytest.raises(StateError, match="from active to active"):
        g.activate(STAND)
    assert g.state is RobotState.ACTIVE


def test_wheels_start_and_turn_round_no_faster_than_the_base_may_and_keep_the_direction() -> None:
    g = active_gate()
    requested = ROBOT.wheels.matrix @ np.array([0.2, 0.1, 0.0])
    base = ROBOT.limits.base
    limits = np.array(
        [base.linear_acceleration, base.linear_acceleration, base.angular_acceleration]
    )
    largest = SAFETY.acceleration_margin * np.abs(ROBOT.wheels.matrix) @ limits * ROBOT.cycle
    before = STILL
    for sign in (1.0, -1.0):
        count = 0
        while count < 200:
            count += 1
            gated = g.gate(reference(STAND), ONES, sign * requested, 0.0)
            sent = gated.command.wheel_speed
            assert (np.abs(sent - before) <= largest + 1e-12).all()
            np.testing.assert_allclose(np.cross(sent, requested), 0.0, atol=1e-9)
            assert gated.wheels_limited == (not np.array_equal(sent, sign * requested))
            before = sent
            if np.array_equal(sent, sign * requested):
                break
        assert 10 < count < 199


@pytest.mark.parametrize("wheel", [0, 1, 2])
@pytest.mark.parametrize("excess", [0.01, 0.5, 30.0])
def test_wheels_turn_no_faster_than_they_may(wheel: int, excess: float) -> None:
    g = active_gate()
    requested = np.roll([1.0, -0.5, 0.25], wheel) * (ROBOT.wheels.speed_limit + excess)
    for _ in range(600):
        sent = g.gate(reference(STAND), ONES, requested, 0.0).command.wheel_speed
    np.testing.assert_allclose(
        sent, requested * ROBOT.wheels.speed_limit / requested[wheel], rtol=1e-6
    )


@pytest.mark.parametrize(
    "wheels", [(1, 1, 1), (5, 5, 5), (5, 5, 0), (0, 5, 5), (5, 0, 0), (0, 0, 5)]
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_wheel_starts_at_once(wheels: tuple[int, ...], sign: float) -> None:
    base = ROBOT.limits.base
    linear, angular = base.linear_acceleration, base.angular_acceleration
    most = np.abs(ROBOT.wheels.matrix) @ np.array([linear, linear, angular]) * ROBOT.cycle
    requested = sign * np.array(wheels, dtype=np.float64)
    sent = active_gate().gate(reference(STAND), ONES, requested, 0.0).command.wheel_speed
    assert (np.abs(sent) <= SAFETY.acceleration_margin * most + 1e-12).all()
    assert (sent * requested >= 0.0).all()
    assert sent.any()


@pytest.mark.parametrize("wheels", [(1, 1, 1), (-1, -1, -1), (1, 1, 0), (0, 1, 1), (0.01, 0, 0)])
def test_while_a_bumper_is_pressed_wheels_stand_and_then_start_again(
    wheels: tuple[float, ...],
) -> None:
    g, requested = active_gate(), np.array(wheels, dtype=np.float64)
    for _ in range(20):
        g.gate(reference(STAND), ONES, np.array([0.4, -0.3, 0.5]), 0.0)
    g.watch(pressed("bumpers")(standing_measurement()), g.sent)
    gated = g.gate(reference(STAND), ONES, requested, 0.0)
    np.testing.assert_array_equal(gated.command.wheel_speed, 0.0)
    assert gated.wheels_limited
    assert not g.gate(reference(STAND), ONES, STILL, 0.0).wheels_limited
    for _ in range(round(SAFETY.bumper_release / ROBOT.cycle) + 1):
        assert g.base_stopped
        g.watch(standing_measurement(), g.sent)
    assert g.base_stopped == ""
    begun = [
        h.gate(reference(STAND), ONES, 9.0 * requested, 0.0).command for h in (g, active_gate())
    ]
    np.testing.assert_array_equal(begun[0].wheel_speed, begun[1].wheel_speed)


def test_wheels_that_stand_share_a_command_that_is_read_only() -> None:
    assert not active_gate().hold().wheel_speed.flags.writeable
