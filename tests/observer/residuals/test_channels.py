"""Two channels that must agree: the smaller residual counts, and none where they contradict each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.residuals.channels import follow_hand
from pepper_driver.observer.residuals.fusion import FusionGenerator, FusionParts
from support.examples import examples
from support.fusion import (
    BOUND,
    BY_CURRENT,
    BY_MODEL,
    ELBOW,
    PER_AMPERE,
    STICK_SLIP,
    VOLTAGE,
    drive,
    fusion_generator,
    fusion_model,
    push_profile,
    standing,
    swing,
    ticks_of,
    with_target_drift,
)
from support.observer import CYCLE, JOINTS, tick


def residuals(signal: FusionGenerator, ticks: list[Tick]) -> FloatArray:
    """(n, joints), of models that nothing corrects."""
    return np.array([signal.step(one).residual for one in ticks])


PART = st.tuples(
    st.integers(1, 12),
    st.floats(-0.1, 0.1),
    st.floats(0.0, 2.0),
    st.sampled_from([0.0, 0.3, -1.0]),
    st.sampled_from([0.0, 1.0, -3.0]),
)


@examples(60)
@given(st.lists(PART, min_size=1, max_size=8))
def test_it_is_the_smaller_of_both_and_nothing_where_their_signs_differ(
    parts: list[tuple[int, float, float, float, float]],
) -> None:
    ticks: list[Tick] = []
    for count, error, current, velocity, load in parts:
        for _ in range(count):
            one = tick(len(ticks), error, features=(velocity, 0.0, load))
            one.measurement.current[:] = current * np.linspace(0.1, 1.0, JOINTS)
            ticks.append(one)
    both, model, shown = (
        residuals(fusion_generator(fusion_model(spread=(9.0, 9.0, 9.0)), parts=part), ticks)
        for part in (FusionParts(law=False), BY_MODEL, BY_CURRENT)
    )
    smaller = np.minimum(np.abs(model), np.abs(shown))
    # The product of the smallest numbers is 0.
    expected = np.where(model * shown > 0.0, smaller, 0.0)
    np.testing.assert_allclose(np.abs(both), expected, rtol=0.0, atol=1e-100)
    agree = np.abs(both) > 1e-100
    np.testing.assert_array_equal(np.sign(both[agree]), np.sign(model[agree]))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_hand_is_followed_until_half_of_a_threshold_is_left(side: float) -> None:
    hands = np.zeros(1, dtype=np.int64)

    def followed(residual: float, by_current: float) -> float:
        """In units of the threshold."""
        size = side * BOUND
        return follow_hand(hands, 0, residual * size, by_current * size, BOUND) / size

    assert followed(0.99, 1.5) == pytest.approx(0.99)
    for ends in (0.49, -0.6):
        assert followed(1.01, 1.5) == pytest.approx(1.5)
        assert followed(0.0, 0.51) == pytest.approx(0.51)
        assert followed(0.0, ends) == 0.0
        # The next one begins beyond the threshold.
        assert followed(0.2, 0.9) == pytest.approx(0.2)


def test_while_a_hand_holds_the_current_alone_shows_it() -> None:
    """A board that sums errors up takes the joint nearer to its goal under the hand; then the hand lets go."""
    error, ticks = 3.0 * BOUND, []
    for k in range(120):
        one = tick(k, 0.0 if k < 20 else error * max(1.0 - (k - 20) / 40, 0.3))
        one.measurement.current[:] = error / PER_AMPERE if 20 <= k < 90 else 0.0
        ticks.append(one)
    seen = np.abs(residuals(fusion_generator(), ticks)[:, ELBOW])
    assert (seen[25:88] > 1.5 * BOUND).all()
    assert (seen[:20] < 0.1 * BOUND).all()
    assert (seen[95:] < 0.1 * BOUND).all()


def test_the_model_alone_counts_where_the_current_shows_nothing() -> None:
    motion = swing(4.0)
    made = ticks_of(motion, drive(motion, torque=push_profile(len(motion), 1.0, 1.0, 5.0)))
    voltage = fusion_model(momentum=VOLTAGE)
    alone = residuals(fusion_generator(parts=BY_MODEL), made)
    np.testing.assert_array_equal(residuals(fusion_generator(voltage), made), alone)
    for one in made:
        one.measurement.current[:] = 1.7
    np.testing.assert_array_equal(residuals(fusion_generator(voltage), made), alone)
    assert np.abs(alone[:, ELBOW]).max() > BOUND


@pytest.mark.parametrize("torque", [5.0, -5.0])
def test_both_channels_show_what_a_hand_does(torque: float) -> None:
    motion = standing(3.0, load=1.0)
    made = ticks_of(
        motion, drive(motion, torque=push_profile(len(motion), 1.0, 1.5, torque), start=-0.01)
    )
    held = slice(round(1.5 / CYCLE), round(2.3 / CYCLE))
    # Friction holds a part of it; the rest moves the joint against its stiffness.
    max_error = abs(torque) * STICK_SLIP.load_gain
    min_error = max_error - 2.0 * STICK_SLIP.breakaway * STICK_SLIP.friction
    for part in (FusionParts(), BY_MODEL, BY_CURRENT):
        seen = residuals(fusion_generator(parts=part), made)[held, ELBOW]
        assert (np.sign(seen) == -math.copysign(1.0, torque)).all()
        assert min_error < np.abs(seen).min() <= np.abs(seen).max() < 1.05 * max_error


@pytest.mark.parametrize("offset", [0.05, -0.05])
def test_a_target_of_the_board_that_is_not_the_command_is_no_touch(offset: float) -> None:
    """The position shows it alone: the motor needs no more torque for it."""
    motion = swing(8.0, rest=1.0)
    time = np.arange(len(motion)) * CYCLE
    made = with_target_drift(motion, np.where((time > 2.0) & (time < 6.0), offset, 0.0))
    off = (time > 2.5) & (time < 5.9)
    model = residuals(fusion_generator(parts=BY_MODEL), made)[:, ELBOW]
    assert np.abs(model[off]).min() > 0.6 * abs(offset)
    seen = residuals(fusion_generator(), made)[:, ELBOW]
    assert np.abs(seen[off]).max() < 0.3 * abs(offset)


def test_a_current_that_nothing_moves_by_is_no_touch() -> None:
    """A board may give some without effect, as warm ones do: the position does not show it."""
    motion = standing(3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[80:160]:
        one.measurement.current[ELBOW] = 0.05 / PER_AMPERE
    assert np.abs(residuals(fusion_generator(parts=BY_CURRENT), made)[:, ELBOW]).max() > 0.03
    assert np.abs(residuals(fusion_generator(), made)[:, ELBOW]).max() < 0.1 * BOUND
