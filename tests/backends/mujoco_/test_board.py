"""The motor boards against the paper's Eq. 1 and 2, and what the plant adds to them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.mujoco_.motors import MotorBoards
from pepper_driver.config import PlantConfig
from pepper_driver.config.arrays import FloatArray
from support.plant import ROBOT, ZERO, N, plain

PLANT = plain()
VOLTAGE = PLANT.board.voltage
STEP = PLANT.physics.timestep
KP, KD = PLANT.per_joint("kp", ROBOT), PLANT.per_joint("kd", ROBOT)
LIMIT = PLANT.per_joint("current_limit", ROBOT)
RESISTANCE = np.array([ROBOT.motors.of(n).resistance for n in ROBOT.joint_names])
TORQUE_CONSTANT = np.array(
    [ROBOT.motors.of(n).torque_constant * ROBOT.motors.joints[n].ratio for n in ROBOT.joint_names]
)  # [N m/A] at the joint
LONG = 300
"""Updates in which the derivative has long died away."""


def boards_of(plant: PlantConfig = PLANT, **settings: Any) -> MotorBoards:
    boards = MotorBoards(ROBOT, plant)
    begin(boards, **settings)
    return boards


def begin(
    boards: MotorBoards,
    *,
    stiffness: float = 1.0,
    copper: float = 1.0,
    magnet: float = 1.0,
    supply: float = VOLTAGE,
) -> None:
    boards.warm(np.full(N, copper), np.full(N, magnet))
    boards.begin_cycle(np.full(N, stiffness), supply)


def update(
    boards: MotorBoards, target: float | FloatArray, speed: float = 0.0, count: int = 1
) -> FloatArray:
    """Voltages after ``count`` updates with the joints at 0."""
    for _ in range(count):
        voltage = boards.update(np.full(N, target), ZERO, np.full(N, speed))
    return voltage.copy()


def small(plant: PlantConfig = PLANT) -> FloatArray:
    """(17,) errors [rad] that ask for a quarter of what the current limit leaves."""
    bound = np.minimum(LIMIT * RESISTANCE, VOLTAGE)
    return np.asarray(bound / 4 / plant.per_joint("kp", ROBOT))


def test_the_voltage_is_proportional_to_a_steady_error() -> None:
    boards = boards_of()
    voltage = update(boards, small(), count=LONG)
    np.testing.assert_allclose(voltage, KP * small(), rtol=1e-9)
    assert not boards.saturated.any()
    np.testing.assert_allclose(boards.current, voltage / RESISTANCE)


def test_the_derivative_acts_on_a_ramp() -> None:
    boards = boards_of()
    speed = small() / (20 * PLANT.board.derivative_time)
    count = round(10 * PLANT.board.derivative_time / STEP)
    for n in range(1, count + 1):
        voltage = update(boards, speed * n * STEP)
    expected = KP * speed * count * STEP + KD * speed
    assert not boards.saturated.any()
    np.testing.assert_allclose(voltage - KP * speed * count * STEP, KD * speed, rtol=1e-3)
    np.testing.assert_allclose(voltage, expected, rtol=1e-3)


def test_the_board_sees_the_joint_in_counts_of_its_encoder() -> None:
    count = 2 * np.pi / 2**PLANT.board.encoder_bits
    for ratio, seen in ((0.4, 0.0), (0.6, 1.0)):
        boards = boards_of()
        for _ in range(LONG):
            voltage = boards.update(ZERO, np.full(N, (7 + ratio) * count), ZERO)
        np.testing.assert_allclose(voltage, -KP * (7 + seen) * count, rtol=1e-9)


@given(
    st.floats(-3, 3), st.floats(-8, 8), st.floats(0, 1), st.floats(0.5, 2.0), st.floats(0.7, 1.2)
)
def test_current_and_voltage_stay_below_their_limits(
    error: float, speed: float, s: float, copper: float, fill: float
) -> None:
    boards = boards_of(stiffness=s, copper=copper, supply=fill * VOLTAGE)
    voltage = update(boards, error, speed, count=2)
    assert (np.abs(voltage) <= fill * VOLTAGE).all()
    # A joint driven faster than the battery's speed pumps current back whatever the board does.
    controlled = np.abs(speed) * TORQUE_CONSTANT < fill * VOLTAGE
    assert (np.abs(boards.current)[controlled] <= s * LIMIT[controlled] + 1e-9).all()
    emf = TORQUE_CONSTANT * speed
    np.testing.assert_allclose(boards.current, (voltage - emf) / (RESISTANCE * copper), atol=1e-12)


@pytest.mark.parametrize("stiffness", [0.25, 0.5, 1.0])
def test_a_large_error_draws_stiffness_times_the_current_limit(stiffness: float) -> None:
    weak = plain(current_limit=0.2)  # far below what the supply could drive
    boards = boards_of(weak, stiffness=stiffness)
    update(boards, 1.0)
    np.testing.assert_allclose(boards.current, 0.2 * stiffness, rtol=1e-12)
    update(boards, -1.0, count=LONG)
    np.testing.assert_allclose(boards.current, -0.2 * stiffness, rtol=1e-12)
    assert boards.saturated.all()


def test_without_stiffness_the_motor_is_free() -> None:
    boards = boards_of(stiffness=0.0)
    speed = VOLTAGE / (2 * TORQUE_CONSTANT.max())
    voltage = update(boards, 0.5, speed)
    np.testing.assert_allclose(boards.current, 0.0, atol=1e-12)
    np.testing.assert_allclose(voltage, TORQUE_CONSTANT * speed, rtol=1e-12)
    assert boards.saturated.all()


def test_saturation_is_reported_until_the_next_cycle() -> None:
    boards = boards_of()
    update(boards, 3.0)
    assert boards.saturated.all()
    update(boards, 0.0, count=LONG)
    assert boards.saturated.all()
    begin(boards)
    assert not boards.saturated.any()


def test_the_integral_winds_at_ki_times_the_error() -> None:
    ki = 30.0
    boards = boards_of(plain(ki=ki))
    error, count = small() / 4, LONG
    voltage = update(boards, error, count=count)
    # The error of an update enters with the next one.
    np.testing.assert_allclose(voltage, KP * error + ki * error * (count - 1) * STEP, rtol=1e-9)
    assert not boards.saturated.any()


def test_the_integral_stands_still_while_a_bound_is_met() -> None:
    boards = boards_of(plain(ki=1000.0))
    update(boards, 3.0, count=LONG)
    assert boards.saturated.all()
    begin(boards)
    boards.boards["smoothed"] = small()  # as if the derivative had died away
    np.testing.assert_allclose(update(boards, small()), KP * small(), rtol=1e-9)


def test_the_integral_unwinds_out_of_a_bound() -> None:
    """Wound up as far as it goes, it holds the voltage at its bound; an error of the other sign lets it down there."""
    ki, wound_up = 1000.0, VOLTAGE
    boards = boards_of(plain(ki=ki))
    boards.boards["integral"] = wound_up
    boards.boards["smoothed"] = -small()  # no derivative
    update(boards, -small(), count=10)
    assert boards.saturated.all()
    np.testing.assert_allclose(
        boards.boards["integral"], wound_up - ki * small() * 10 * STEP, rtol=1e-9
    )


def test_the_integral_is_bounded() -> None:
    bound = 0.25 * float(np.min(np.minimum(LIMIT * RESISTANCE, VOLTAGE)))
    plant = plain(ki=1000.0)
    boards = boards_of(replace(plant, board=replace(plant.board, integral_limit=bound)))
    for sign in (1, -1):
        voltage = update(boards, sign * small(), count=20 * LONG)
        np.testing.assert_allclose(voltage, sign * (KP * small() + bound), rtol=1e-9)


def test_the_integral_stands_still_at_small_errors() -> None:
    """They are still seen by the proportional part, and what was summed up before stays."""
    band, plant = float(small().min()) / 4, plain(ki=30.0)
    boards = boards_of(replace(plant, board=replace(plant.board, integral_band=band)))
    np.testing.assert_allclose(update(boards, 0.99 * band, count=LONG), KP * 0.99 * band)
    wound = update(boards, 1.01 * band, count=LONG) - KP * 1.01 * band
    np.testing.assert_allclose(wound, 30.0 * 1.01 * band * (LONG - 1) * STEP)
    update(boards, -0.5 * band)  # sees the last error of before
    kept = update(boards, -0.5 * band, count=LONG) + KP * 0.5 * band
    np.testing.assert_allclose(kept, 30.0 * 1.01 * band * LONG * STEP)


def test_the_integral_is_let_go_without_stiffness() -> None:
    boards = boards_of(plain(ki=30.0))
    update(boards, small() / 4, count=LONG)
    begin(boards, stiffness=0.0)
    begin(boards)
    boards.boards["smoothed"] = small() / 4
    np.testing.assert_allclose(update(boards, small() / 4), KP * small() / 4, rtol=1e-9)


def test_nothing_is_remembered_over_a_reset() -> None:
    used, fresh = boards_of(plain(ki=30.0)), boards_of(plain(ki=30.0))
    update(used, small() / 4, count=LONG)
    used.reset()
    assert not used.current.any()
    np.testing.assert_array_equal(update(used, small()), update(fresh, small()))


def test_the_dead_band_is_silent_inside_and_continuous_at_its_edge() -> None:
    band = 0.25 * small()
    for ki in (0.0, 30.0):
        for ratio, seen in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (1.001, 0.001), (2.0, 1.0)):
            for sign in (1, -1):
                plant = plain(ki=ki, dead_band=0.001)
                boards = boards_of(plant)
                boards.boards["dead_band"] = band
                voltage = update(boards, sign * ratio * band, count=LONG)
                expected = sign * seen * band * (KP + ki * (LONG - 1) * STEP)
                np.testing.assert_allclose(voltage, expected, atol=1e-9, rtol=1e-6)


def test_the_derivative_damps_inside_the_dead_band_too() -> None:
    boards = boards_of(plain(dead_band=1.0))
    error = small() * PLANT.board.derivative_time / STEP / 100
    gain = KD * (1 - np.exp(-STEP / PLANT.board.derivative_time)) / STEP
    np.testing.assert_allclose(update(boards, error), gain * error, rtol=1e-9)


def test_gains_grow_with_the_supply() -> None:
    """The board sets a duty cycle."""
    law = plain(ki=30.0)
    full, low = boards_of(law), boards_of(law, supply=0.8 * VOLTAGE)
    for count in (1, 10, LONG):  # derivative, all, integral
        np.testing.assert_allclose(
            update(low, small() / 4, count=count),
            0.8 * update(full, small() / 4, count=count),
            rtol=1e-9,
        )
    assert not full.saturated.any()


def test_a_hot_winding_takes_more_voltage_for_the_current_limit() -> None:
    weak = plain(current_limit=0.1)
    voltages = [update(boards_of(weak, copper=copper), 1.0) for copper in (1.0, 1.5)]
    np.testing.assert_allclose(voltages[0], 0.1 * RESISTANCE, rtol=1e-12)
    np.testing.assert_allclose(voltages[1], 1.5 * voltages[0], rtol=1e-12)


def test_a_weak_magnet_turns_faster_on_the_same_voltage() -> None:
    speed = 0.5
    for magnet in (1.0, 0.8):
        boards = boards_of(stiffness=0.0, magnet=magnet)
        np.testing.assert_allclose(update(boards, 0.0, speed), magnet * TORQUE_CONSTANT * speed)


def test_stiffness_and_torque_limit_in_newton_metres() -> None:
    """K = kp N Kt / R; the limit is that of the current, or of a stalled motor at full voltage."""
    boards = MotorBoards(ROBOT, PLANT)
    for index, name in enumerate(ROBOT.joint_names):
        motor, ratio = ROBOT.motors.of(name), ROBOT.motors.joints[name].ratio
        kt, r = motor.torque_constant, motor.resistance
        assert boards.stiffness[index] == pytest.approx(
            PLANT.actuator(name).kp * ratio * kt / r, rel=1e-12
        )
        held = min(PLANT.actuator(name).current_limit, VOLTAGE / r)
        assert boards.torque_limit[index] == pytest.approx(held * kt * ratio, rel=1e-12)
    assert boards_of().stiffness.tolist() == boards_of(supply=VOLTAGE / 2).stiffness.tolist()
