"""The momentum channel against Eq. 10 written out, and the derivatives against those of known signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.models.fusion_model import MomentumError, MomentumParameters
from pepper_driver.observer.residuals.momentum import (
    SMOOTHING_TIME,
    ErrorDerivatives,
    momentum_channels,
    momentum_residual,
)
from support.observer import CYCLE

CURRENT = MomentumParameters(
    source="current", torque_per_ampere=0.05, inertia=5e-4, lag=0.01, offset=0.002
)
VOLTAGE = replace(CURRENT, source="voltage", torque_per_ampere=0.0, lag=0.03)

NUMBERS = st.floats(-1.0, 1.0)


def residual(
    parameters: MomentumParameters,
    *,
    current: float,
    drive: float,
    velocity: float = 0.0,
    acceleration: float = 0.0,
    resistance: float,
    model_residual: float,
    integrates: bool = False,
) -> tuple[float, float]:
    channels = momentum_channels([parameters], np.array([integrates]))
    return momentum_residual(
        channels, 0, current, drive, velocity, acceleration, resistance, model_residual
    )


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.floats(-0.999, 0.999))
def test_residual_is_minus_the_external_torque_over_the_stiffness(
    velocity: float, acceleration: float, resistance: float, external: float, mistake: float
) -> None:
    p = CURRENT
    # J a = motor - d v - resistance - offset + external, all over K.
    motor = p.inertia * acceleration + p.lag * velocity + resistance + p.offset - external
    found, given_motor = residual(
        p,
        current=abs(motor) / p.torque_per_ampere,
        drive=9.0,
        velocity=velocity,
        acceleration=acceleration,
        resistance=resistance,
        # A model with an error smaller than the motor torque still gives its sign.
        model_residual=-external + mistake * abs(motor),
    )
    assert found == pytest.approx(-external, abs=1e-12)
    assert given_motor == pytest.approx(motor, abs=1e-12)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_a_wrong_sign_errs_by_no_more_than_the_model_did(
    resistance: float, external: float, mistake: float
) -> None:
    p = CURRENT
    motor = resistance + p.offset - external
    assume(abs(mistake) > 1e-9)
    found, _ = residual(
        p,
        current=abs(motor) / p.torque_per_ampere,
        drive=0.0,
        resistance=resistance,
        model_residual=-external + mistake,
    )
    assert abs(found + external) <= 2 * abs(mistake) + 1e-12


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_of_a_voltage_the_motor_is_what_the_board_makes_of_the_error(
    velocity: float, acceleration: float, resistance: float, external: float
) -> None:
    p = VOLTAGE
    # J a = drive - d v - resistance - offset + external, with d of back-EMF and viscous friction.
    drive = p.inertia * acceleration + p.lag * velocity + resistance + p.offset - external
    found, motor = residual(
        p,
        current=123.0,
        drive=drive,
        velocity=velocity,
        acceleration=acceleration,
        resistance=resistance,
        model_residual=0.0,
    )
    assert found == pytest.approx(-external, abs=1e-12)
    assert motor == drive


def test_joints_keep_to_their_own_source() -> None:
    channels = momentum_channels([CURRENT, None, VOLTAGE], np.zeros(3, dtype=bool))
    found = [momentum_residual(channels, j, 2.0, 0.3, 0.0, 0.0, 0.05, 0.0)[0] for j in range(3)]
    np.testing.assert_allclose(found, [0.1 - 0.052, np.nan, 0.3 - 0.052])


def derivatives(error: FloatArray) -> tuple[FloatArray, FloatArray]:
    filters = ErrorDerivatives(1, CYCLE)
    rows = [filters.step(np.array([value])) for value in error]
    velocity, acceleration = np.array(rows)[:, :, 0].T
    # Those of a whole run have the same bits.
    np.testing.assert_array_equal(filters.play(error), (velocity, acceleration))
    return velocity, acceleration


TIME: FloatArray = np.arange(100.0) * CYCLE


def test_derivative_of_a_ramp_is_its_slope() -> None:
    velocity, acceleration = derivatives(0.1 + 0.5 * TIME)
    assert velocity[-1] == pytest.approx(0.5, rel=1e-6)
    assert acceleration[-1] == pytest.approx(0.0, abs=1e-6)


def test_second_derivative_of_a_parabola() -> None:
    _, acceleration = derivatives(0.5 * 3.0 * TIME**2)
    assert acceleration[-1] == pytest.approx(3.0, rel=1e-6)


def test_a_constant_has_no_derivative_from_the_first_sample_on() -> None:
    velocity, acceleration = derivatives(np.full(20, 0.3))
    assert (velocity == 0).all()
    assert (acceleration == 0).all()


def test_a_step_is_forgotten_with_the_time_of_the_filter() -> None:
    velocity, _ = derivatives(np.where(np.arange(60) < 5, 0.0, 0.01))
    after = velocity[5:]
    assert after[0] == velocity.max() > 0
    k = round(3 * SMOOTHING_TIME / CYCLE)
    assert after[k] / after[0] == pytest.approx(np.exp(-k * CYCLE / SMOOTHING_TIME), rel=0.01)


def test_reset_forgets() -> None:
    filters = ErrorDerivatives(1, CYCLE)
    for k in range(10):
        filters.step(np.array([0.1 * k]))
    filters.reset()
    velocity, acceleration = filters.step(np.array([5.0]))
    assert velocity[0] == acceleration[0] == 0.0


@pytest.mark.parametrize("name", ["torque_per_ampere", "inertia", "lag", "offset"])
def test_parameters_that_are_not_finite_are_refused(name: str) -> None:
    with pytest.raises(MomentumError, match="not finite"):
        replace(CURRENT, **{name: float("inf")})  # type: ignore[arg-type]


def test_a_current_without_torque_is_refused() -> None:
    with pytest.raises(MomentumError, match="torque_per_ampere"):
        replace(CURRENT, torque_per_ampere=0.0)
    assert issubclass(MomentumError, PepperError)


@pytest.mark.parametrize(
    ("motor", "drive", "resistance", "model"),
    [
        # The estimated integral has an error of a degree just as the joint starts.
        (0.023, -0.007, 0.023, 0.0),
        # A push against the load: the board acts against what motion alone would require.
        (-0.030, -0.026, 0.023, -0.048),
        # After a long touch the model, which does not contain it, is wrong by the integral of the board.
        (0.040, 0.038, 0.023, -0.035),
    ],
)
def test_boards_that_integrate_give_the_sign_together_with_model_and_load(
    motor: float, drive: float, resistance: float, model: float
) -> None:
    p = replace(CURRENT, offset=0.0)
    found, given_motor = residual(
        p,
        current=abs(motor) / p.torque_per_ampere,
        drive=drive,
        resistance=resistance,
        model_residual=model,
        integrates=True,
    )
    assert given_motor == pytest.approx(motor)
    assert found == pytest.approx(motor - resistance)
