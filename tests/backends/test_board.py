"""The motor boards against the paper's Eq. 1 and 2."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.mujoco_.board import MotorBoards
from pepper_driver.config import load_plant, load_robot

ROBOT = load_robot()
PLANT = load_plant("nominal", ROBOT)
N = len(ROBOT.joint_names)
ZERO, ONE = np.zeros(N), np.ones(N)


def test_the_voltage_is_proportional_to_a_steady_error() -> None:
    boards = MotorBoards(ROBOT, PLANT)
    error = np.full(N, 0.02)
    for _ in range(100):  # until the derivative has died away
        voltage = boards.update(error, ZERO, ZERO, ONE)
    np.testing.assert_allclose(voltage, PLANT.per_joint("kp", ROBOT) * 0.02, rtol=1e-9)
    assert not boards.saturated.any()


def test_the_derivative_acts_on_a_ramp() -> None:
    boards = MotorBoards(ROBOT, PLANT)
    speed, step = 0.5, PLANT.physics.timestep
    for n in range(1, 200):
        voltage = boards.update(np.full(N, speed * n * step), ZERO, ZERO, ONE)
    proportional = PLANT.per_joint("kp", ROBOT) * speed * n * step
    expected = proportional + PLANT.per_joint("kd", ROBOT) * speed
    free = ~boards.saturated
    assert free.sum() > 5
    # the discrete low-pass reads a ramp exactly up to half a step
    np.testing.assert_allclose(voltage[free], expected[free], rtol=0.02)


@given(st.floats(-3, 3), st.floats(-8, 8), st.floats(0, 1))
def test_current_and_voltage_stay_below_their_limits(error: float, speed: float, s: float) -> None:
    boards = MotorBoards(ROBOT, PLANT)
    boards.begin_cycle()
    voltage = boards.update(np.full(N, error), ZERO, np.full(N, speed), np.full(N, s))
    assert (np.abs(voltage) <= PLANT.board.voltage).all()
    limit = s * PLANT.per_joint("current_limit", ROBOT)
    # A joint driven faster than the battery's speed pumps current back whatever the board does.
    emf = np.abs(speed) * np.array(
        [
            ROBOT.motors.of(n).torque_constant * ROBOT.motors.joints[n].ratio
            for n in ROBOT.joint_names
        ]
    )
    controlled = emf < PLANT.board.voltage
    assert (np.abs(boards.current)[controlled] <= limit[controlled] + 1e-9).all()


def test_without_stiffness_the_motor_is_free() -> None:
    boards = MotorBoards(ROBOT, PLANT)
    boards.update(np.full(N, 0.5), ZERO, np.full(N, 1.0), ZERO)
    np.testing.assert_allclose(boards.current, 0.0, atol=1e-12)
    assert boards.saturated.all()


def test_stiffness_in_newton_metres() -> None:
    """K = kp N Kt / R."""
    index = ROBOT.joint_index("LShoulderRoll")
    assert MotorBoards(ROBOT, PLANT).stiffness[index] == pytest.approx(
        63.0 * 118.1 * 0.0192 / 5.293, rel=1e-12
    )
