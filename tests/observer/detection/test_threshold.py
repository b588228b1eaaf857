"""Thresholds of mode ``fusion``: spreads that follow free motion, by its phase, and never a touch."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import make_records
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    EXCURSIONS,
    FRICTION_RATIO,
    HELD_FACTOR,
    MIN_SPREAD,
    MIN_TORQUE,
    PUSH_TICKS,
    REST_SPEED,
    SETTLING_TICKS,
    TAIL,
    UNSURE_FACTOR,
)
from pepper_driver.observer.detection.threshold import (
    BREAKAWAY,
    REST,
    SLIDING,
    SPREAD_QUANTILE,
    SpreadState,
    SpreadThreshold,
    identified_thresholds,
    learn_spread,
    step_threshold,
    threshold_factor,
)
from support.fusion import STICK_SLIP, fusion_model
from support.observer import CYCLE, NORMAL_QUANTILE

FALSE_CONTACTS = 0.1
FACTOR = 1.0 + 0.37 * math.log(50_000.0)
SLIDING_FACTOR = 1.0 + 0.15 * math.log(50_000.0)
MEMORY = PUSH_TICKS
RESTED = round(CORRECTION_TIME / CYCLE)
LN_100 = math.log(100.0)


def made(
    *spreads: tuple[float, float, float],
    load_gain: float = 1e-9,
    friction: float = 0.0,
    settling_time: float = 0.0,
    false_contacts: float = FALSE_CONTACTS,
    trunk: bool = False,
) -> SpreadThreshold:
    """Thresholds of joints with these spreads at rest, just after they broke away, and sliding, as identified."""
    return SpreadThreshold(
        np.array(spreads),
        np.full(len(spreads), load_gain),
        np.full(len(spreads), friction),
        np.full(len(spreads), settling_time),
        CYCLE,
        false_contacts=false_contacts,
        trunk=np.full(len(spreads), trunk),
    )


def step_each(
    target: SpreadThreshold, speed: FloatArray, desired: FloatArray, limited: BoolArray
) -> FloatArray:
    """Thresholds of a tick with these speeds of the models, and desired ones."""
    return np.array(
        [
            step_threshold(
                target.spreads,
                target.states,
                target.factors,
                target.min_thresholds,
                j,
                float(speed[j]),
                float(desired[j]),
                bool(limited[j]),
                target.rest_ticks,
            )
            for j in range(len(speed))
        ]
    )


def step(target: SpreadThreshold, speed: float = 0.0, *, limited: bool = False) -> FloatArray:
    """Thresholds of a tick in which all joints are to move at this speed."""
    n = len(target.states)
    return step_each(target, np.full(n, speed), np.full(n, speed), np.full(n, limited))


def learn(target: SpreadThreshold, *residuals: float | None) -> None:
    """Take in residuals of joints; None for one that cannot be judged."""
    n = len(target.states)
    for j, residual in enumerate(residuals):
        if residual is not None:
            phase = int(target.states["phase"][j])
            learn_spread(target.spreads, phase * n + j, residual, MIN_SPREAD)


def slide(target: SpreadThreshold) -> FloatArray:
    """Thresholds of joints that have moved for longer than they settle."""
    for _ in range(SETTLING_TICKS + 1):
        threshold = step(target, 1.0)
    return threshold


def spread_at_rest(target: SpreadThreshold) -> FloatArray:
    spread: FloatArray = step(target) / FACTOR
    return spread


# -- factor -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("false_contacts", "factor"), [(0.1, 5.003), (1.0, 4.151), (5000.0, 1.0), (1e6, 1.0)]
)
def test_factor_by_hand(false_contacts: float, factor: float) -> None:
    assert threshold_factor(false_contacts, TAIL) == pytest.approx(factor, abs=1e-3)


@given(st.floats(1e-4, 4999.0), st.floats(1.001, 100.0))
def test_fewer_false_contacts_need_a_larger_factor(false_contacts: float, fewer: float) -> None:
    factor = threshold_factor(false_contacts, TAIL)
    assert threshold_factor(false_contacts / fewer, TAIL) > factor >= 1.0
    # The tail is exponential: of all excursions in an hour, so many go beyond it.
    assert EXCURSIONS * math.exp(-(factor - 1.0) / TAIL) == pytest.approx(false_contacts)


# -- learning ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [0.5, 1.0, 2.0])
def test_spread_converges_to_the_quantile_of_the_residual(start: float) -> None:
    scale, n = 0.004, 120_000  # 24 minutes
    rng = np.random.default_rng(3)
    residual = scale * np.column_stack(
        (
            rng.exponential(size=n) * rng.choice((-1.0, 1.0), size=n),
            rng.standard_normal(n),
            rng.uniform(-1.0, 1.0, n),
        )
    )
    quantile = scale * np.array([LN_100, NORMAL_QUANTILE, 0.99])
    np.testing.assert_allclose(
        np.quantile(np.abs(residual), SPREAD_QUANTILE, axis=0), quantile, rtol=0.03
    )
    target = made(*((start * q,) * 3 for q in quantile.tolist()))
    for row in residual:
        learn(target, *row.tolist())
    np.testing.assert_allclose(spread_at_rest(target), quantile, rtol=0.2)


@pytest.mark.parametrize("ticks", [12, 84, 840])
def test_an_excursion_that_nothing_reports_hardly_widens_it(ticks: int) -> None:
    target = made((0.01, 0.01, 0.01))
    for _ in range(ticks):
        learn(target, 0.03)
    assert 1.01 < spread_at_rest(target)[0] / 0.01 <= 1.03
    # The next one, after a moment within the spread, as much again.
    learn(target, 0.0)
    for _ in range(ticks):
        learn(target, -0.03)
    assert spread_at_rest(target)[0] / 0.01 == pytest.approx(1.024**2, rel=2e-3)


def test_touches_that_nothing_reports_do_not_make_it_deaf() -> None:
    """One of a second every twenty seconds, in noise with its quantile."""
    n, scale = 50_000, 0.004
    rng = np.random.default_rng(5)
    residual = scale * rng.exponential(size=n)
    period, touch = round(20.0 / CYCLE), round(1.0 / CYCLE)
    touched = np.arange(n) % period < touch
    residual[touched] = 3.0 * LN_100 * scale
    target = made((LN_100 * scale,) * 3)
    for value in residual:
        learn(target, value)
    assert 1.0 < spread_at_rest(target)[0] / (LN_100 * scale) < 1.5


@pytest.mark.parametrize(("size", "change"), [(99.0, UNSURE_FACTOR), (0.0, 1.0 / UNSURE_FACTOR)])
def test_spread_of_today_stays_near_the_identified_one(size: float, change: float) -> None:
    target = made((0.02, 0.05, 0.03))
    for k in range(70_000):
        learn(target, size if k % 10 else 0.0)
    np.testing.assert_allclose(spread_at_rest(target), 0.02 * change, rtol=1e-9)
    assert target.change[0] == 1.0  # it has not moved
    np.testing.assert_allclose(slide(target), SLIDING_FACTOR * 0.03, rtol=1e-9)


def test_spread_falls_to_the_smallest_one_that_its_sensor_can_show() -> None:
    spreads = make_records(SpreadState, 2, identified=[0.02, 0.004], today=[0.02, 0.004])
    for _ in range(70_000):
        learn_spread(spreads, 0, 0.0, 0.015)
        learn_spread(spreads, 1, 0.0, 0.015)  # was identified below it
    np.testing.assert_allclose(spreads["today"], [0.015, 0.004], rtol=1e-12)


# -- thresholds -------------------------------------------------------------------------------------------------------


def test_threshold_is_that_of_the_phase_of_the_motion() -> None:
    target = made((0.01, 0.03, 0.02), (0.02, 0.05, 0.04))
    np.testing.assert_allclose(step(target), FACTOR * np.array([0.01, 0.02]), rtol=1e-4)
    # Friction holds the second one.
    speeds, desired = REST_SPEED * np.array([1.01, -0.99]), REST_SPEED * np.array([1.01, -1.01])
    no = np.zeros(2, dtype=np.bool_)
    for k in range(SETTLING_TICKS + 10):
        threshold = step_each(target, speeds, desired, no)
        slides = k >= SETTLING_TICKS
        expected = SLIDING_FACTOR * 0.02 if slides else HELD_FACTOR * FACTOR * 0.03
        held = HELD_FACTOR * FACTOR * 0.02
        np.testing.assert_allclose(threshold, [expected, held], rtol=1e-4)
        np.testing.assert_array_equal(target.states["moving"], [True, False])
        np.testing.assert_array_equal(
            target.states["phase"], [SLIDING if slides else BREAKAWAY, REST]
        )
    # A joint that stops, as one that turns back does, will break away; after a while it rests.
    for k in range(RESTED + 10):
        moving = k < MEMORY - 1
        factor = FACTOR if k >= RESTED else HELD_FACTOR * FACTOR
        assert step(target)[0] == pytest.approx(factor * (0.03 if moving else 0.01), rel=1e-4)
        assert target.states["moving"][0] == moving
    np.testing.assert_allclose(target.bounds, FACTOR * np.array([0.03, 0.05]), rtol=1e-4)


def test_a_joint_that_turns_back_breaks_away_again() -> None:
    target = made((0.01, 0.03, 0.02))
    slide(target)
    for k in range(SETTLING_TICKS + 2):
        step(target, -1.0 if k else 0.0)
        assert target.states["phase"][0] == (SLIDING if k > SETTLING_TICKS else BREAKAWAY)


def identified(
    *spread: float, load_gain: float = 1e-9, friction: float = 0.0, trunk: bool = False
) -> FloatArray:
    """Thresholds by phase of a model with these spreads."""
    twin = replace(STICK_SLIP, load_gain=load_gain, friction=friction)
    model = fusion_model(twin, spread=spread)
    return identified_thresholds(model, FALSE_CONTACTS, trunk=trunk)


def test_thresholds_of_all_phases_by_hand() -> None:
    by_hand = np.array([FACTOR * 0.01, FACTOR * 0.03, SLIDING_FACTOR * 0.02])
    np.testing.assert_allclose(identified(0.01, 0.03, 0.02), by_hand, rtol=1e-4)
    np.testing.assert_allclose(identified(1e-5, 1e-5, 1e-5, load_gain=0.25), 0.02)
    # No spread is below 0.1 degrees, about a step of the encoder.
    step_of_encoder = math.radians(0.1) * np.array([FACTOR, FACTOR, SLIDING_FACTOR])
    np.testing.assert_allclose(identified(1e-5, 1e-5, 1e-5), step_of_encoder, rtol=1e-4)
    # Weight on a joint of the trunk sways: its tail is long while it slides, too.
    found = identified(0.01, 0.03, 0.02, trunk=True)
    np.testing.assert_allclose(found, FACTOR * np.array([0.01, 0.03, 0.02]), rtol=1e-4)
    # Friction can let go of a joint that slides, and hold it again.
    np.testing.assert_allclose(
        identified(0.01, 0.03, 0.02, friction=0.1), [*by_hand[:2], 0.07], rtol=1e-4
    )


@pytest.mark.parametrize("trunk", [False, True])
def test_a_joint_that_slides_may_be_off_by_its_friction(trunk: bool) -> None:
    target = made((0.01,) * 3, friction=0.2, trunk=trunk)
    held = HELD_FACTOR * FACTOR * 0.01
    for _ in range(SETTLING_TICKS):
        assert step(target, 1.0)[0] == pytest.approx(held, rel=1e-4)
    for _ in range(10):
        assert step(target, 1.0)[0] == pytest.approx(FRICTION_RATIO * 0.2)
    assert target.bounds[0] == pytest.approx(FRICTION_RATIO * 0.2)


@pytest.mark.parametrize(
    ("settling_time", "ticks"),
    [
        (0.0, SETTLING_TICKS),
        (SETTLING_TICKS * CYCLE, SETTLING_TICKS),
        (50 * CYCLE, 50),
        (math.inf, RESTED),
    ],
)
def test_a_joint_that_swings_settles_later(settling_time: float, ticks: int) -> None:
    target = made((0.01, 0.03, 0.02), settling_time=settling_time)
    for _ in range(ticks):
        step(target, 1.0)
        assert target.states["phase"][0] == BREAKAWAY
    step(target, 1.0)
    assert target.states["phase"][0] == SLIDING


def test_joints_of_the_trunk_keep_the_long_tail_while_they_slide() -> None:
    np.testing.assert_allclose(slide(made((0.02,) * 3, trunk=True)), FACTOR * 0.02, rtol=1e-3)
    assert made((0.02,) * 3, trunk=True).bounds == pytest.approx(FACTOR * 0.02)
    mixed = SpreadThreshold(
        np.full((2, 3), 0.02),
        np.full(2, 1e-9),
        np.zeros(2),
        np.zeros(2),
        CYCLE,
        false_contacts=FALSE_CONTACTS,
        trunk=np.array([True, False]),
    )
    np.testing.assert_allclose(slide(mixed), [FACTOR * 0.02, SLIDING_FACTOR * 0.02], rtol=1e-3)


@pytest.mark.parametrize("phase", [REST, BREAKAWAY, SLIDING])
def test_each_phase_learns_on_its_own_and_each_joint_that_is_seen(phase: int) -> None:
    target, fresh = made((0.01,) * 3, (0.01,) * 3), made((0.01,) * 3)
    at_rest, breaking_away, sliding = step(fresh)[0], step(fresh, 1.0)[0], slide(fresh)[0]
    if phase == SLIDING:
        slide(target)
    else:
        step(target, 1.0 if phase == BREAKAWAY else 0.0)
    for k in range(1000):
        learn(target, 0.05 if k % 10 else 0.0, None)
    assert target.change[0] == pytest.approx(UNSURE_FACTOR if phase == SLIDING else 1.0)
    assert target.change[1] == 1.0
    for _ in range(RESTED + 1):
        threshold = step(target)
    found = [threshold, step(target, 1.0), slide(target)]
    for number, before in enumerate((at_rest, breaking_away, sliding)):
        grown = UNSURE_FACTOR if number == phase else 1.0
        np.testing.assert_allclose(found[number], [grown * before, before], rtol=1e-9)


def test_no_threshold_is_below_the_smallest_torque_or_a_step_of_the_encoder() -> None:
    # A soft joint, 4 N m/rad, of which nearly nothing is seen in free motion.
    soft = made((1e-5,) * 3, load_gain=0.25)
    np.testing.assert_allclose(step(soft), MIN_TORQUE * 0.25)
    np.testing.assert_allclose(soft.bounds, MIN_TORQUE * 0.25)
    stiff = made((1e-5,) * 3)
    np.testing.assert_allclose(step(stiff), FACTOR * MIN_SPREAD, rtol=1e-4)
    np.testing.assert_allclose(slide(made((1e-5,) * 3)), SLIDING_FACTOR * MIN_SPREAD, rtol=1e-4)
    # Nor does learning lead below it.
    for _ in range(60_000):
        learn(stiff, 0.0)
    np.testing.assert_allclose(step(stiff), FACTOR * MIN_SPREAD, rtol=1e-4)


def test_a_command_that_the_gate_alters_doubles_the_threshold_as_long_as_it_does() -> None:
    target = made((0.01,) * 3, (1e-5,) * 3, load_gain=0.25)
    plain = step(target)
    np.testing.assert_allclose(
        step_each(target, np.zeros(2), np.zeros(2), np.array([True, False])),
        plain * [UNSURE_FACTOR, 1.0],
    )
    np.testing.assert_allclose(step(target, limited=True), plain * UNSURE_FACTOR)
    np.testing.assert_array_equal(step(target), plain)


def test_a_joint_without_a_model_has_no_threshold() -> None:
    target = made((math.nan,) * 3, (0.01,) * 3)
    for speed in (0.0, 1.0):
        np.testing.assert_array_equal(np.isnan(step(target, speed)), [True, False])
    np.testing.assert_array_equal(np.isnan(target.bounds), [True, False])


def test_reset_forgets_the_session() -> None:
    target = made((0.01, 0.01, 0.01))
    slide(target)
    for k in range(1000):
        learn(target, 0.05 if k % 10 else 0.0)
    assert target.change[0] > 1.5
    target.reset()
    assert target.change[0] == 1.0
    assert not target.states["moving"].any()
    assert step(target)[0] == pytest.approx(FACTOR * 0.01, rel=1e-4)


def test_a_touch_keeps_its_threshold_while_the_joint_turns_and_stops() -> None:
    target = made((0.05, 0.03, 0.01), (0.05, 0.03, 0.01))
    low = slide(target)[0]
    target.states["touched"] = [True, False]
    for k in range(2 * SETTLING_TICKS):
        held, other = step(target, -1.0 if 1 <= k < 5 else 0.0)
        assert held == pytest.approx(low)
        assert other > 2.0 * low
    # A command that the gate alters doubles it all the same.
    assert step(target, limited=True)[0] == pytest.approx(UNSURE_FACTOR * low)
    target.states["touched"] = False
    assert step(target)[0] == pytest.approx(HELD_FACTOR * FACTOR * 0.05, rel=1e-4)


def test_a_touch_that_nothing_reports_does_not_widen_the_threshold_of_a_joint_that_swings() -> None:
    """Friction changes its side with the motion; a hand does not."""
    grown = []
    for alternates in (False, True):
        target = made((0.01,) * 3)
        for k in range(60):
            side = -1.0 if k % 2 else 1.0
            step(target, 0.0)
            for _ in range(SETTLING_TICKS + 20):
                step(target, side)
                learn(target, 0.025 * (side if alternates else 1.0))
        grown.append(float(target.change[0]))
    assert grown[0] < 1.1
    assert grown[1] == pytest.approx(UNSURE_FACTOR)
