"""The residual by the current against Eq. 10 written out, and the derivatives against those of known signals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Records
from pepper_driver.observer.constants import (
    MIN_DRIVE,
    MIN_SPREAD,
    REVERSAL_RATIO,
    SETTLING_TICKS,
    SMOOTHING_TIME,
    UNSURE_FACTOR,
)
from pepper_driver.observer.models.fusion_model import MomentumError, MomentumParameters
from pepper_driver.observer.residuals.momentum import (
    CurrentChannel,
    ErrorDerivatives,
    current_channels,
    current_residual,
)
from support.fusion import STICK_SLIP, fusion_model
from support.observer import CYCLE

CURRENT = MomentumParameters(
    source="current", torque_per_ampere=0.05, inertia=5e-4, lag=0.01, offset=0.002
)
VOLTAGE = replace(CURRENT, source="voltage", torque_per_ampere=0.0, lag=0.03)
BACK_EMF = 0.03

NUMBERS = st.floats(-1.0, 1.0)


def channel(parameters: MomentumParameters = CURRENT) -> Records[CurrentChannel]:
    return current_channels(
        [fusion_model(replace(STICK_SLIP, lag=BACK_EMF), momentum=parameters)],
    )


def residual(
    channels: Records[CurrentChannel],
    motor: float,
    *,
    drive: float,
    velocity: float = 0.0,
    acceleration: float = 0.0,
    resistance: float,
    ticks: int = 1,
    pushed: bool = False,
) -> tuple[float, float]:
    """Residual and torque in the last of some ticks, of a motor of whose torque only the size is seen."""
    current = abs(motor) / CURRENT.torque_per_ampere
    for _ in range(ticks):
        found = current_residual(
            channels, 0, current, drive, velocity, acceleration, resistance, pushed
        )
    return found[:2]


def needed(velocity: float, acceleration: float, resistance: float) -> float:
    p = CURRENT
    return p.inertia * acceleration + p.lag * velocity + resistance + p.offset


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_residual_is_minus_the_external_torque_over_the_stiffness(
    velocity: float, acceleration: float, resistance: float, external: float
) -> None:
    free = needed(velocity, acceleration, resistance)
    # J a = motor - d v - resistance - offset + external, all over K.
    motor = free - external
    found, given_motor = residual(
        channel(),
        motor,
        drive=motor + BACK_EMF * velocity,  # the law of the board
        velocity=velocity,
        acceleration=acceleration,
        resistance=resistance,
    )
    # A sign is not known of a motor that gives hardly anything.
    if abs(motor) > 1.001 * MIN_DRIVE or motor * free > 0.0:
        assert found == pytest.approx(-external, abs=1e-12)
        assert given_motor == pytest.approx(motor, abs=1e-12)
    assert abs(found) <= abs(external) + 1e-12


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS, st.floats(-0.999, 0.999))
def test_without_the_law_of_the_board_the_smaller_of_two_residuals_counts(
    velocity: float, acceleration: float, resistance: float, motor: float, part: float
) -> None:
    free = needed(velocity, acceleration, resistance)
    assume(free != 0.0)
    found, given_motor = residual(
        channel(),
        motor,
        drive=BACK_EMF * velocity + part * MIN_DRIVE,
        velocity=velocity,
        acceleration=acceleration,
        resistance=resistance,
    )
    assert abs(found) == pytest.approx(abs(abs(motor) - abs(free)), abs=1e-12)
    assert given_motor == pytest.approx(np.copysign(motor, free), abs=1e-12)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_as_the_needed_torque_passes_zero_the_residual_stays_small(side: float) -> None:
    """The noise of the current is all that is left of it; its sign does not matter then."""
    channels, noise = channel(), 0.003
    for resistance in (side * np.linspace(-0.02, 0.02, 81) - CURRENT.offset).tolist():
        # The motor gives what is needed, and the law of the board says so with an error of half a degree.
        free = needed(0.0, 0.0, resistance)
        found, _ = residual(
            channels, abs(free) + noise, drive=free + 0.009 * side, resistance=resistance
        )
        assert abs(found) < 1.01 * noise or abs(free + 0.009 * side) > MIN_DRIVE
        assert abs(found) < 2.0 * 0.009


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_touch_that_reverses_the_motor_is_found_where_the_current_answers(side: float) -> None:
    resistance, motor = side * 0.02 - CURRENT.offset, -side * 0.05
    channels = channel()
    found, given_motor = residual(channels, motor, drive=motor, resistance=resistance)
    assert found == pytest.approx(-side * 0.07)
    assert given_motor == pytest.approx(motor)
    # Too small a current does not answer.
    small = 0.99 / UNSURE_FACTOR * motor
    found, _ = residual(channels, small, drive=motor, resistance=resistance)
    assert found == pytest.approx(side * (abs(small) - 0.02))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("ticks", "reverses"), [(0, True), (SETTLING_TICKS - 1, True), (SETTLING_TICKS, False)]
)
def test_a_current_that_has_not_passed_zero_has_not_reversed(
    side: float, ticks: int, reverses: bool
) -> None:
    """It carries a load; then the target of the board drifts to the other side by as much as the current is large."""
    resistance, motor = side * 0.02 - CURRENT.offset, side * 0.025
    channels = channel()
    residual(channels, motor, drive=motor, resistance=resistance)
    residual(channels, 0.9 * REVERSAL_RATIO * motor, drive=0.0, resistance=resistance)
    if ticks:
        residual(channels, motor, drive=motor, resistance=resistance, ticks=ticks)
    found, given_motor = residual(channels, motor, drive=-motor, resistance=resistance)
    assert given_motor == pytest.approx(-motor if reverses else motor)
    assert found == pytest.approx(given_motor - side * 0.02)


@pytest.mark.parametrize(("lowest", "reverses"), [(0.99, True), (1.01, False)])
def test_a_small_current_has_not_passed_zero_either(lowest: float, reverses: bool) -> None:
    """Down to what a step of the encoder makes: it need not be large before the board follows another target."""
    resistance, motor, low = 0.02 - CURRENT.offset, 0.025, lowest * MIN_SPREAD
    assert low < 0.5 * MIN_DRIVE
    channels = channel()
    residual(channels, low, drive=0.0, resistance=resistance, ticks=100)
    _, given_motor = residual(channels, motor, drive=-motor, resistance=resistance)
    assert given_motor == pytest.approx(-motor if reverses else motor)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_push_that_moves_the_base_reverses_a_current_between_two_samples(side: float) -> None:
    resistance, motor = side * 0.02 - CURRENT.offset, side * 0.025
    channels = channel()
    residual(channels, motor, drive=motor, resistance=resistance, ticks=100)
    found, given_motor = residual(channels, motor, drive=-motor, resistance=resistance, pushed=True)
    assert given_motor == pytest.approx(-motor)
    # Half the output is enough then.
    small = 0.51 * side * MIN_DRIVE
    for pushed in (True, False):
        _, given_motor = residual(
            channel(), small, drive=-small, resistance=resistance, pushed=pushed
        )
        assert given_motor == pytest.approx(-small if pushed else small)
    # Once reversed, it stays so while it shows the output.
    found, _ = residual(channels, motor, drive=-motor, resistance=resistance)
    assert found == pytest.approx(-motor - side * 0.02)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("later", "reverses"), [(0, True), (1, False)])
def test_a_current_that_has_become_small_may_have_reversed_until_that_is_the_usual_size(
    side: float, later: int, reverses: bool
) -> None:
    """A fifth of it is below 0.3 of the recent size, which falls by a factor of e in SETTLING_TICKS."""
    resistance, small = side * 0.02 - CURRENT.offset, side * 0.04
    channels = channel()
    residual(channels, 5.0 * small, drive=5.0 * small, resistance=resistance)
    usual = math.ceil(math.log(0.2 / 0.3) / math.log(1.0 - 1.0 / SETTLING_TICKS))
    ticks = usual - 1 + SETTLING_TICKS - 1 + later
    residual(channels, small, drive=small, resistance=resistance, ticks=ticks)
    _, given_motor = residual(channels, small, drive=-small, resistance=resistance)
    assert given_motor == pytest.approx(-small if reverses else small)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("size", "at_limit"), [(0.038, False), (0.042, True)])
def test_a_board_at_its_limit_gives_twice_what_is_needed_without_touch(
    side: float, size: float, at_limit: bool
) -> None:
    """It asks for 0.2 rad to the other side, of which its current can show a fifth."""
    resistance = side * 0.02 - CURRENT.offset
    channels = channel()
    _, motor = residual(channels, size, drive=-side * 0.2, resistance=resistance, ticks=50)
    assert motor == pytest.approx(side * (-size if at_limit else size))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("degrees", "at_limit"), [(3.5, False), (4.5, True)])
def test_a_board_whose_target_drifts_by_less_than_four_degrees_is_not_at_its_limit(
    side: float, degrees: float, at_limit: bool
) -> None:
    """Targets of recorded boards drift by as much, and give more current than needed for other reasons."""
    resistance, size = side * 0.01 - CURRENT.offset, 0.025
    channels, drive = channel(), -side * math.radians(degrees)
    _, motor = residual(channels, size, drive=drive, resistance=resistance, ticks=50)
    assert motor == pytest.approx(side * (-size if at_limit else size))


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("answer", [0.0, 0.3, 0.49])
def test_a_board_that_follows_another_target_makes_a_small_residual(
    side: float, answer: float
) -> None:
    """It is two degrees off, against the load; its current is that of the load and a part of the answer at most."""
    resistance, drive = side * 0.01 - CURRENT.offset, -side * np.radians(2.0)
    motor = answer * drive
    found, _ = residual(channel(), motor, drive=drive, resistance=resistance, ticks=50)
    assert found == pytest.approx(side * (abs(motor) - 0.01))
    assert abs(found) < 0.6 * abs(drive)
    beyond = 1.02 / UNSURE_FACTOR * drive
    found, _ = residual(channel(), beyond, drive=drive, resistance=resistance, ticks=50)
    assert found == pytest.approx(beyond - side * 0.01)


def test_back_emf_is_no_output_that_a_current_could_answer() -> None:
    """A fast joint has a large error, of which its motor needs little."""
    velocity, motor = 2.0, -0.04
    fast = BACK_EMF * velocity  # the error that balances the back-EMF
    resistance = 0.02 - CURRENT.offset - CURRENT.lag * velocity
    found, _ = residual(
        channel(), motor, drive=fast + motor, velocity=velocity, resistance=resistance, ticks=50
    )
    assert found == pytest.approx(motor - 0.02)


def test_joints_keep_to_their_own_constants_and_state() -> None:
    models = [fusion_model(momentum=CURRENT), None, fusion_model(momentum=VOLTAGE)]
    channels = current_channels(models)
    np.testing.assert_array_equal(channels["by_current"], [True, False, False])
    for j in range(3):
        found, _, _ = current_residual(
            channels, j, 2.0, -0.1 if j == 0 else 0.0, 0.0, 0.0, 0.05, False
        )
        if j == 1:
            assert np.isnan(found)
    np.testing.assert_array_equal(channels["answered"], [-1, 0, 0])
    found, _, _ = current_residual(channels, 0, 2.0, -0.1, 0.0, 0.0, 0.05, False)
    assert found == pytest.approx(-0.152)


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
