from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.models.closed_form import (
    MotorParameters,
    expected_error,
    external_torque,
)
from support.observer import CYCLE, motion

MOTOR = MotorParameters(
    resistance=7.0,
    torque_constant=0.02,
    speed_constant=0.021,
    rotor_inertia=1.2e-6,
    motor_damping=2e-6,
    ratio=150.0,
    proportional_gain=60.0,
)


def constant(
    n: int, velocity: float = 0.0, acceleration: float = 0.0, load: float = 0.0
) -> FloatArray:
    return np.tile((velocity, acceleration, load), (n, 1))


def test_stiffness_and_lag_by_hand() -> None:
    assert MOTOR.stiffness == pytest.approx(60.0 * 150.0 * 0.02 / 7.0)
    assert MOTOR.lag == pytest.approx((7.0 / 0.02 * 2e-6 + 0.021) * 150.0 / 60.0)


def test_at_constant_velocity_the_error_is_the_lag() -> None:
    error = expected_error(MOTOR, constant(50, velocity=0.8), CYCLE)
    np.testing.assert_allclose(error, MOTOR.lag * 0.8)
    np.testing.assert_allclose(
        expected_error(MOTOR, constant(50, velocity=-0.8), CYCLE), -MOTOR.lag * 0.8
    )


def test_at_rest_the_error_is_load_over_stiffness() -> None:
    error = expected_error(MOTOR, constant(50, load=-3.0), CYCLE)
    np.testing.assert_allclose(error, -3.0 / MOTOR.stiffness)


def test_acceleration_carries_the_rotor() -> None:
    # First term of Eq. 11: R Jm N / (Kt Kp).
    error = expected_error(MOTOR, constant(50, acceleration=10.0), CYCLE)
    np.testing.assert_allclose(error, 10.0 * 7.0 * 1.2e-6 * 150.0 / (0.02 * 60.0))


def test_friction_has_the_sign_of_the_velocity_and_vanishes_at_rest() -> None:
    rough = replace(MOTOR, coulomb_friction=0.6, viscous_friction=0.1, friction_velocity=0.01)
    for velocity in (0.5, -0.5):
        extra = expected_error(rough, constant(3, velocity=velocity), CYCLE) - expected_error(
            MOTOR, constant(3, velocity=velocity), CYCLE
        )
        np.testing.assert_allclose(
            extra, (0.6 * np.sign(velocity) + 0.1 * velocity) / MOTOR.stiffness
        )
    assert expected_error(rough, constant(3), CYCLE)[0] == 0.0
    small = expected_error(rough, constant(3, velocity=1e-4), CYCLE)
    assert np.abs(small).max() < 0.1 * 0.6 / MOTOR.stiffness


def test_derivative_term_is_the_exact_filter() -> None:
    features = motion(5.0, 0, 6.0)
    damped = replace(MOTOR, derivative_gain=60.0 * 0.03)
    settled = expected_error(MOTOR, features, CYCLE)
    time = np.arange(len(settled)) * CYCLE
    # y + T y' = u from rest, around the first value; lsim also takes u as linear between samples.
    _, expected, _ = lsim(([1.0], [0.03, 1.0]), settled - settled[0], time)
    np.testing.assert_allclose(
        expected_error(damped, features, CYCLE), expected + settled[0], atol=1e-12
    )


def test_delay_compares_with_a_command_that_has_moved_on() -> None:
    velocity = 0.5
    error = expected_error(MOTOR, constant(50, velocity=velocity), CYCLE, delay=2)
    np.testing.assert_allclose(error[2:], (MOTOR.lag + 2 * CYCLE) * velocity)
    features = motion(4.0, 1, 6.0)
    position = np.concatenate(([0.0], np.cumsum(features[:-1, 0] + features[1:, 0]) * CYCLE / 2))
    error = expected_error(MOTOR, features, CYCLE)
    delayed = expected_error(MOTOR, features, CYCLE, delay=3)
    np.testing.assert_allclose(delayed[3:], position[3:] - (position - error)[:-3], atol=1e-12)
    with pytest.raises(ValueError, match="-1"):
        expected_error(MOTOR, features, CYCLE, delay=-1)


def test_agrees_with_the_motor_itself_on_a_smooth_motion() -> None:
    """Eq. 1 to 6 integrated, against Eq. 11: signs, gear ratio and derivative term at once."""
    motor = replace(MOTOR, derivative_gain=0.9, viscous_friction=0.3)
    inertia, rate, size = 0.08, 2.0, 0.5

    def desired(t: float) -> tuple[float, float, float]:
        return (
            size * (1 - np.cos(rate * t)),
            size * rate * np.sin(rate * t),
            size * rate**2 * np.cos(rate * t),
        )

    def law(t: float, state: FloatArray) -> tuple[float, float]:
        q, speed = state
        q_d, speed_d, _ = desired(t)
        u = motor.proportional_gain * (q_d - q) + motor.derivative_gain * (speed_d - speed)
        omega = motor.ratio * speed
        current = (u - motor.speed_constant * omega) / motor.resistance
        shaft = motor.torque_constant * current - motor.motor_damping * omega
        torque = motor.ratio * shaft - motor.viscous_friction * speed + 2.0  # 2 N m from outside
        return speed, torque / (inertia + motor.rotor_inertia * motor.ratio**2)

    time = np.arange(0.0, 6.0, CYCLE)
    q = solve_ivp(law, (0.0, 6.0), (0.0, 0.0), t_eval=time, max_step=1e-3, rtol=1e-8).y
    reference = np.array([desired(t) for t in time])
    measured = reference[:, 0] - q[0]
    features = np.column_stack((reference[:, 1], reference[:, 2], inertia * reference[:, 2]))
    late = time > 2.0
    # Eq. 11 puts desired for true motion: an error of second order in the lag.
    expected = expected_error(motor, features, CYCLE) - 2.0 / motor.stiffness
    assert np.abs(expected - measured)[late].max() < 0.2 * np.abs(measured)[late].max()
    true_speed = np.gradient(q[1], CYCLE)
    true = np.column_stack((q[1], true_speed, inertia * true_speed))
    found = external_torque(motor, measured, true, CYCLE)
    np.testing.assert_allclose(found[late][1:-1], 2.0, atol=0.02)


def test_external_torque_undoes_expected_error() -> None:
    features = motion(4.0, 2, 8.0)
    pushed = features.copy()
    push = 3.0 * np.exp(-(((np.arange(len(features)) * CYCLE - 4.0) / 0.5) ** 2))
    pushed[:, 2] -= push  # Eq. 6: an external torque takes load off the motor
    motor = replace(MOTOR, derivative_gain=0.6, coulomb_friction=0.3, friction_velocity=0.1)
    error = expected_error(motor, pushed, CYCLE)
    found = external_torque(motor, error, features, CYCLE)
    np.testing.assert_allclose(found[2:-2], push[2:-2], atol=0.1)
    quiet = external_torque(MOTOR, expected_error(MOTOR, features, CYCLE), features, CYCLE)
    np.testing.assert_allclose(quiet, 0.0, atol=1e-10)


def test_short_runs() -> None:
    assert expected_error(MOTOR, np.empty((0, 3)), CYCLE, delay=1).shape == (0,)
    one = constant(1, load=1.0)
    assert expected_error(MOTOR, one, CYCLE)[0] == pytest.approx(1.0 / MOTOR.stiffness)
    assert external_torque(MOTOR, np.zeros(1), one, CYCLE)[0] == pytest.approx(1.0)
