"""Expected motion of the base by wheels and inertial unit: a known response is found, and pushes are detected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    HELD_FACTOR,
    REPORT_DELAY,
    REST_SPEED,
    ROCKING_SPEED,
    SETTLING_TICKS,
    SHAKING_ACCELERATION,
    TAIL,
    UNSURE_FACTOR,
)
from pepper_driver.observer.detection.threshold import threshold_factor
from pepper_driver.observer.fitting.mobile_base import fit_base
from pepper_driver.observer.models.fusion_model import (
    OUTPUTS,
    TAPS,
    UNSEEN_SPREAD,
    BaseModel,
    BaseModelError,
)
from pepper_driver.observer.recording import Recording, RecordingBuilder
from pepper_driver.observer.residuals.mobile_base import (
    DRIVING,
    MIN_SPREADS,
    MOVING,
    SHAKING,
    STILL,
    BaseGenerator,
)
from support.fusion import MATRIX, six, still_base
from support.observer import CYCLE, JOINTS, MEDIAN_STD, NORMAL_QUANTILE, ROBOT, imu, tick

WINDOW = 5
FALSE_CONTACTS = 0.1
FACTOR = threshold_factor(FALSE_CONTACTS, TAIL)
LEGS = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
STARTED = TAPS + WINDOW  # ticks after which residuals are judged

SETTLING = np.exp(-np.arange(TAPS - 1) * CYCLE / 0.04)
RESPONSE = np.zeros(TAPS)  # of each axis of the twist, and of the yaw rate, to its command
RESPONSE[1:] = (1 - np.exp(-CYCLE / 0.04)) * SETTLING
SHAKE = np.zeros(TAPS)  # of the acceleration to its command
SHAKE[1:4] = (4.0, 1.0, -5.0)
RECOIL = np.zeros((TAPS, 3))  # of vx, on each joint of the legs; ten times as large of ax
RECOIL[2:6] = [(0.01, -0.007, 0.0), (0.02, -0.01, 0.0), (-0.02, 0.01, 0.0), (-0.01, 0.007, 0.0)]
NOISE = np.array([3e-4, 3e-4, 3e-4, 1e-3, 0.02, 0.02])
LEAN = np.array([0.02, 0.3, -0.2])


def filtered(values: FloatArray, response: FloatArray) -> FloatArray:
    return np.convolve(values, response)[: len(values)]


def ticks(sent: FloatArray, load: FloatArray, outputs: FloatArray) -> list[Tick]:
    """Ticks with these (n, 3) commands, (n, 3) loads of the legs and (n, 6) measured outputs."""
    made = []
    for k in range(len(sent)):
        one = tick(k)
        one.sent.wheel_speed[:] = MATRIX @ sent[k]
        one.reference.load_torque[LEGS] = load[k]
        one.measurement.wheel_speed[:] = MATRIX @ outputs[k, :3]
        one.measurement.imu.angular_velocity[2] = outputs[k, 3]
        one.measurement.imu.acceleration[:2] = outputs[k, 4:]
        made.append(one)
    return made


def drive(
    seconds: float, seed: int, *, stand: float = 0.0, hold: int = 12, size: float = 0.15
) -> list[Tick]:
    """Ticks of a base with this response, that drives to random set-points, held so long, and stands at the end."""
    rng = np.random.default_rng(seed)
    n, still = round(seconds / CYCLE), round(stand / CYCLE)
    sent = np.repeat(rng.uniform(-size, size, (n // hold + 1, 3)), hold, axis=0)[:n]
    sent = np.concatenate((sent, np.zeros((still, 3))))
    load = np.repeat(rng.uniform(-0.1, 0.1, ((n + still) // 9 + 1, 3)), 9, axis=0)[: n + still]
    load += np.array([10.0, -8.0, 3.0])
    twist = np.column_stack([filtered(sent[:, axis], RESPONSE) for axis in range(3)])
    inertial = np.column_stack(
        (twist[:, 2], filtered(sent[:, 0], SHAKE), filtered(sent[:, 1], SHAKE))
    )
    for leg in range(3):
        recoil = filtered(load[:, leg] - load[0, leg], RECOIL[:, leg])
        twist[:, 0] += recoil
        inertial[:, 1] += 10.0 * recoil
    outputs = np.hstack((twist, inertial + LEAN))
    return ticks(sent, load, outputs + NOISE * rng.standard_normal(outputs.shape))


def standing(n: int, outputs: FloatArray | float = 0.0, seed: int | None = 9) -> list[Tick]:
    """Ticks of a base that stands, with (n, 6) outputs; with a trace of noise, as no sensor repeats itself."""
    noise = 0.0 if seed is None else 1e-6 * np.random.default_rng(seed).standard_normal((n, 6))
    nothing = np.zeros((n, 3))
    return ticks(nothing, nothing, np.broadcast_to(outputs, (n, 6)) + noise)


def recorded(made: Sequence[Tick]) -> Recording:
    builder = RecordingBuilder(ROBOT)
    for one in made:
        builder.append(one)
    return builder.finish()


def still_model(
    still: object, moving: object = 1e9, shaking: object = 1e9, driving: object = 1e9
) -> BaseModel:
    """A model that expects a base that does not move, with these spreads; other phases are not judged."""
    return still_base(still, moving, shaking, driving)


def generator(model: BaseModel, *, adapt: bool = False) -> BaseGenerator:
    return BaseGenerator(model, ROBOT, WINDOW, false_contacts=FALSE_CONTACTS, adapt=adapt)


def residuals(signal: BaseGenerator, made: Sequence[Tick], late: Sequence[int] = ()) -> FloatArray:
    """(n, 2) before and after the filter."""
    return np.array([signal.step(one, k in late) for k, one in enumerate(made)])


@pytest.fixture(scope="module")
def model() -> BaseModel:
    return fit_base(
        ROBOT, [recorded(drive(14.0, seed, stand=5.0)) for seed in (1, 2)], window=WINDOW
    )


# -- identification ---------------------------------------------------------------------------------------------------


def test_finds_the_impulse_response_of_all_outputs(model: BaseModel) -> None:
    taps = np.array(model.coefficients).reshape(TAPS, -1, len(OUTPUTS))
    assert taps.shape == (TAPS, 3 + len(LEGS), 6)
    truth = np.zeros((TAPS, 3, 6))
    for axis in range(3):
        truth[:, axis, axis] = RESPONSE
    truth[:, 2, 3], truth[:, 0, 4], truth[:, 1, 5] = RESPONSE, SHAKE, SHAKE
    # Of the noise of its sensor there is more in the acceleration.
    for output, error in enumerate((0.03, 0.03, 0.03, 0.03, 0.6, 0.6)):
        np.testing.assert_allclose(taps[:, :3, output], truth[:, :, output], atol=error)
    for axis, output in ((0, 0), (1, 1), (2, 2), (2, 3)):
        assert taps[:, axis, output].sum() == pytest.approx(RESPONSE.sum(), abs=0.02)
    # The response to a load by its change since the oldest tap.
    np.testing.assert_allclose(taps[:-1, 3:, 0], RECOIL[:-1], atol=2e-3)
    np.testing.assert_allclose(taps[:-1, 3:, 4], 10.0 * RECOIL[:-1], atol=0.1)
    assert np.abs(taps[:-1, 3:, 1:3]).max() < 2e-3


def test_the_response_to_long_drives_is_found_as_well() -> None:
    """Longer than the level of the inertial unit takes to follow."""
    runs = [recorded(drive(60.0, seed, hold=round(3.0 / CYCLE))) for seed in (5, 6)]
    taps = np.array(fit_base(ROBOT, runs, window=WINDOW).coefficients).reshape(TAPS, -1, 6)
    for output in (2, 3):
        assert taps[:, 2, output].sum() == pytest.approx(RESPONSE.sum(), abs=0.04)


def test_spreads_are_quantiles_of_what_is_not_expected(model: BaseModel) -> None:
    """A median of five has 0.536 of the noise of a sample."""
    expected = np.maximum(MEDIAN_STD * NORMAL_QUANTILE * NOISE, MIN_SPREADS)
    for spread in (model.still, model.driving):
        assert (np.array(spread) >= MIN_SPREADS).all()
        np.testing.assert_allclose(spread[3:], expected[3:], rtol=0.25)
        np.testing.assert_allclose(spread[:3], expected[:3], rtol=0.6)
    phases = np.array([model.still, model.moving, model.shaking, model.driving])
    assert (np.diff(phases, axis=0) >= 0.0).all()


def test_a_phase_that_no_run_shows_is_as_rough_as_the_next() -> None:
    rng = np.random.default_rng(0)
    n = 1200
    outputs = 0.1 * rng.standard_normal((n, 6))
    moving = standing(n, outputs)
    for one in moving:
        one.reference.velocity[:] = 2.0 * ROCKING_SPEED
        one.reference.load_torque[LEGS] = rng.uniform(-0.1, 0.1, 3)
    found = fit_base(ROBOT, [recorded(moving)] * 2, window=WINDOW)
    np.testing.assert_allclose(found.moving, MEDIAN_STD * NORMAL_QUANTILE * 0.1, rtol=0.25)
    assert found.still == found.moving == found.shaking == found.driving


def test_an_inertial_unit_that_shows_nothing_is_not_judged() -> None:
    runs = []
    for seed in (1, 2):
        made = drive(15.0, seed)
        for one in made:
            one.measurement.imu.angular_velocity[:] = 0.3
            one.measurement.imu.acceleration[:] = 0.3
        runs.append(recorded(made))
    found = fit_base(ROBOT, runs, window=WINDOW)
    taps = np.array(found.coefficients)
    assert (taps[:, 3:] == 0.0).all()
    for spread in (found.still, found.moving, found.shaking, found.driving):
        assert spread[3:] == (UNSEEN_SPREAD,) * 3
        assert max(spread[:3]) < 0.01
    # Nor is it when it works in use.
    seen = residuals(generator(found), drive(10.0, 3))
    assert np.nanmax(np.abs(seen[:, 1])) < 1.0


# -- residual ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("output", range(6))
def test_residual_is_that_of_the_impulse_response(output: int) -> None:
    """Every tap, written out; for many times the memory of inputs."""
    rng = np.random.default_rng(output)
    n, legs = 20 * TAPS, len(LEGS)
    taps = rng.normal(size=(TAPS, 3 + legs, 6))
    spread, far = 0.02, 1e12  # the other outputs detect nothing
    spreads = six([spread if k == output else far for k in range(6)])
    made_of = BaseModel(
        coefficients=tuple(six(row) for row in taps.reshape(-1, 6)),
        still=(far,) * 6,
        moving=(far,) * 6,
        shaking=(far,) * 6,
        driving=spreads,
    )
    sent, load, outputs = (rng.normal(size=(n, width)) for width in (3, 3, 6))
    seen = residuals(generator(made_of), ticks(sent, load, outputs))
    expected = np.zeros(n)
    for k in range(n):
        for age in range(min(TAPS, k + 1)):
            # Before the first tick the load was the same.
            change = load[k - age] - load[max(k - TAPS + 1, 0)]
            expected[k] += sent[k - age] @ taps[age, :3, output] + change @ taps[age, 3:, output]
    error = expected - outputs[:, output]
    if output >= 3:
        level = error[0]
        for k in range(n):
            error[k] -= level
            level += CYCLE / CORRECTION_TIME * np.median(error[max(k + 1 - WINDOW, 0) : k + 1])
    ratio = error / (FACTOR * spread)
    judged = slice(STARTED, None)
    np.testing.assert_allclose(seen[judged, 0], ratio[judged], rtol=1e-9, atol=1e-6)
    median = [np.median(ratio[k + 1 - WINDOW : k + 1]) for k in range(STARTED, n)]
    np.testing.assert_allclose(seen[judged, 1], median, rtol=1e-9, atol=1e-6)


def test_nothing_is_detected_in_motion_like_that_of_the_calibration(model: BaseModel) -> None:
    for seed in (1, 77):
        seen = residuals(generator(model), drive(20.0, seed, stand=5.0))
        assert np.nanmax(np.abs(seen[:, 1])) < 1.0
        assert np.isfinite(seen[STARTED:]).all()


@pytest.mark.parametrize("output", range(6))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_detects_a_push_that_one_output_shows(output: int, side: float) -> None:
    """Wheels alone, and the inertial unit alone."""
    n = 200
    spread = np.array([0.001, 0.001, 0.003, 0.002, 0.02, 0.02])
    outputs = np.zeros((n, 6))
    outputs[100:130, output] = side * 2.0 * FACTOR * spread[output]
    seen = residuals(generator(still_model(spread)), standing(n, outputs))
    # Expected minus measured: a base that is moved on has a negative residual. The level follows a little.
    np.testing.assert_allclose(seen[103:130, 0], -2.0 * side, rtol=0.2)
    over = np.flatnonzero(np.abs(seen[:, 1]) > 1.0)
    assert (over[0], over[-1]) == (100 + WINDOW // 2, 129 + WINDOW // 2)


def test_outputs_find_together_what_none_finds_alone() -> None:
    spread = np.array([0.001, 0.001, 0.003, 0.002, 0.02, 0.02])
    outputs = np.zeros((100, 6))
    for count, detected in ((1, False), (2, True)):
        outputs[60:, :count] = 0.8 * FACTOR * spread[:count]
        seen = residuals(generator(still_model(spread)), standing(100, outputs))
        assert abs(seen[-1, 1]) == pytest.approx(0.8 * np.sqrt(count), rel=1e-3)
        assert (np.abs(seen[70:, 1]) > 1.0).all() == detected


def test_a_push_that_moves_two_axes_keeps_its_sign() -> None:
    n, spread = 200, 2.0 * MIN_SPREADS
    size = 2.0 + 0.5 * np.random.default_rng(0).standard_normal((n, 2))
    outputs = np.zeros((n, 6))
    outputs[100:, [0, 2]] = size[100:] * FACTOR * spread[[0, 2]] * (1.0, -1.0)
    signal, largest, signs = generator(still_model(spread)), [], []
    for k, one in enumerate(standing(n, outputs)):
        _, seen = signal.step(one)
        if k >= 110:
            assert abs(seen) > 1.0
            largest.append(int(np.argmax(np.abs(signal.filtered) / spread)))
            signs.append(np.sign(seen))
    # The largest output changes all the time.
    assert np.count_nonzero(np.diff(largest)) > 10
    assert len(set(signs)) == 1


def test_a_push_that_turns_to_another_axis_has_the_sign_of_that_one() -> None:
    """Once the axis that was reported before shows less than half as much."""
    n, spread = 200, 2.0 * MIN_SPREADS
    outputs = np.zeros((n, 6))
    outputs[100:, 0], outputs[100:, 2] = 2.0, -1.9
    outputs[130:, 0] = 1.0  # of 1.9: more than half
    outputs[160:, 0] = 0.9
    seen = residuals(generator(still_model(spread)), standing(n, FACTOR * spread * outputs))[:, 1]
    np.testing.assert_array_equal(np.sign(seen[[110, 140, 170]]), [-1.0, -1.0, 1.0])


# -- phases -----------------------------------------------------------------------------------------------------------


def test_the_spread_of_a_base_that_drives_stays_until_it_stands() -> None:
    n, stop = 400, 150
    sent, outputs = np.zeros((n, 3)), np.zeros((n, 6))
    sent[:stop, 0] = 0.05
    outputs[:, 1] = -FACTOR * 0.005
    outputs[:, 3] = 1e-9 * np.arange(n)
    made = ticks(sent, np.zeros((n, 3)), outputs)
    signal = generator(still_model(0.001, 0.001, 0.001, 0.01))
    seen = residuals(signal, made)
    after = stop + TAPS + SETTLING_TICKS
    assert seen[after - 3, 0] == pytest.approx(0.5)
    assert seen[after + 2, 0] == pytest.approx(5.0)
    assert signal.phase == STILL


@pytest.mark.parametrize(
    ("velocity", "acceleration", "spreads", "before", "settling"),
    [
        (ROCKING_SPEED, 0.0, (0.01, 1e9), 5.0, 0),
        # Joints that start are as fast before a contact is reported.
        (0.0, ROCKING_SPEED / REPORT_DELAY, (0.01, 1e9), 5.0, 0),
        # Wheels that were shaken creep on for a while.
        (0.0, SHAKING_ACCELERATION, (0.001, 0.01), 5.0 / HELD_FACTOR, SETTLING_TICKS),
    ],
)
def test_the_spread_of_joints_that_move_or_shake_stays_until_the_base_has_settled(
    velocity: float,
    acceleration: float,
    spreads: tuple[float, float],
    before: float,
    settling: int,
) -> None:
    n, begin, stop = 300, 60, 150
    outputs = np.zeros((n, 6))
    outputs[:, 1] = -FACTOR * 0.005
    made = standing(n, outputs)
    for k, one in enumerate(made):
        size = -1.01 if begin <= k < stop else 0.99
        one.reference.velocity[3], one.reference.acceleration[3] = (
            size * velocity,
            size * acceleration,
        )
    ratio = residuals(generator(still_model(0.001, *spreads)), made)[:, 0]
    after = stop + TAPS + settling
    np.testing.assert_allclose(ratio[begin : after - 1], 0.5 / HELD_FACTOR, rtol=1e-2)
    np.testing.assert_allclose(ratio[STARTED:begin], before, rtol=1e-2)
    np.testing.assert_allclose(ratio[after:], before, rtol=1e-2)


@pytest.mark.parametrize("phase", [STILL, MOVING, SHAKING, DRIVING])
def test_spreads_of_today_are_learned_in_their_phase(phase: int) -> None:
    """With a residual that is mostly beyond the spread."""
    spread, n = 0.01, 2000
    outputs = np.zeros((n, 6))
    outputs[:, 0] = np.where(np.arange(n) % 20 < 14, 0.04, 0.0)
    made = standing(n, outputs)
    for one in made:
        one.reference.velocity[:] = 2.0 * ROCKING_SPEED if phase == MOVING else 0.0
        one.reference.acceleration[:] = SHAKING_ACCELERATION if phase == SHAKING else 0.0
        one.sent.wheel_speed[1] = REST_SPEED if phase == DRIVING else 0.0
    for adapt in (True, False):
        signal = generator(still_model(spread, spread, spread, spread), adapt=adapt)
        for one in made:
            signal.step(one, False)
            signal.learn()
        assert signal.phase == phase
        [push] = standing(1, np.array([[0.05, 0.0, 0.0, 0.0, 0.0, 0.0]]))
        push.reference.velocity[:] = made[0].reference.velocity
        push.reference.acceleration[:] = made[0].reference.acceleration
        push.sent.wheel_speed[:] = made[0].sent.wheel_speed
        here = abs(signal.step(push, False)[0])
        # Joints that break away push the base.
        factor = FACTOR * (HELD_FACTOR if phase in (MOVING, SHAKING) else 1.0)
        assert here == pytest.approx(5.0 / factor / (UNSURE_FACTOR if adapt else 1.0), rel=0.01)
        # Another phase has not changed.
        moves = {"velocity": np.full(JOINTS, 1.0), "acceleration": np.zeros(JOINTS)}
        other = replace(push, reference=replace(push.reference, **moves))
        if phase != MOVING:
            other.sent.wheel_speed[:] = 0.0
            for _ in range(100):
                away = abs(signal.step(other, False)[0])
            assert away == pytest.approx(5.0 / FACTOR / HELD_FACTOR, rel=0.01)


def test_a_push_of_a_second_hardly_widens_a_spread() -> None:
    signal = generator(still_model(0.01), adapt=True)
    push = np.zeros((STARTED + 84, 6))
    push[STARTED:, 0] = 0.03
    for one in standing(len(push), push):
        signal.step(one, False)
        signal.learn()
    [probe] = standing(1, np.array([[0.03, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    assert 1.0 < 3.0 / FACTOR / abs(signal.step(probe, False)[0]) <= 1.03


def test_a_base_without_residuals_is_judged_by_no_less_than_the_steps_of_its_sensors() -> None:
    signal = generator(still_model(2.0 * MIN_SPREADS), adapt=True)
    residuals(signal, standing(STARTED + 1))
    for _ in range(round(700.0 / CYCLE)):
        signal.learn()
    probe = np.zeros((1, 6))
    probe[0, 0] = 3.0 * MIN_SPREADS[0]
    [one] = standing(1, probe)
    assert abs(signal.step(one, False)[0]) == pytest.approx(3.0 / FACTOR, rel=0.01)


# -- inertial unit ----------------------------------------------------------------------------------------------------


def with_unit(made: Sequence[Tick], first: int, last: int, value: float | None) -> list[Tick]:
    """Ticks whose inertial unit has one value in all of a stretch, or stays at its last one (None)."""
    found = list(made)
    for k in range(first, last):
        shown = found[first - 1].measurement.imu if value is None else imu(value)
        found[k] = replace(made[k], measurement=replace(made[k].measurement, imu=shown))
    return found


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, None])
def test_a_unit_without_values_or_with_frozen_ones_neither_alarms_nor_hides(
    model: BaseModel, value: float | None
) -> None:
    """In the middle of a fast drive, and in a push that the wheels show."""
    made = drive(12.0, 8, size=0.4)
    wide = replace(model, driving=six(1.5 * np.array(model.driving)))
    first, last = 300, 700
    assert np.nanmax(np.abs(residuals(generator(wide), made)[:, 1])) < 1.0
    lost = with_unit(made, first, last, value)
    with np.errstate(invalid="ignore"):
        assert np.nanmax(np.abs(residuals(generator(wide), lost)[:, 1])) < 1.0
    for k in range(500, 560):
        lost[k].measurement.wheel_speed[:] += MATRIX @ np.array(
            [1.5 * FACTOR * wide.driving[0], 0.0, 0.0]
        )
    pushed = residuals(generator(wide), lost)[:, 1]
    assert (np.abs(pushed[503:560]) > 1.0).all()
    assert np.nanmax(np.abs(pushed[:500])) < 1.0
    assert np.nanmax(np.abs(pushed[565:])) < 1.0


def test_a_unit_that_comes_back_finds_its_level_again() -> None:
    """The robot leans in another way by then."""
    n, back = 600, 400
    lean = np.zeros((n, 6))
    lean[back:, 3:] = (0.1, 0.8, -0.6)
    made = with_unit(standing(n, lean), 100, back, np.nan)
    signal = generator(still_model(0.01))
    assert np.nanmax(np.abs(residuals(signal, made)[:, 1])) < 0.01
    # A moment without values changes no level.
    made = with_unit(standing(n, lean), 100, 120, np.nan)
    seen = residuals(generator(still_model(0.01)), made)
    assert abs(seen[back, 0]) > 10.0


def test_the_level_of_a_robot_that_leans_is_followed() -> None:
    n, begin = 900, 100
    lean = np.zeros((n, 6))
    lean[begin:, 4] = 0.5
    seen = residuals(generator(still_model(0.05)), standing(n, lean))[:, 0]
    after = np.arange(n - begin) * CYCLE
    largest = 0.5 / (FACTOR * 0.05)
    expected = -largest * np.exp(-after / CORRECTION_TIME)
    np.testing.assert_allclose(seen[begin:], expected, atol=0.02 * largest)
    # Slowly enough it is no push at all.
    slow = np.zeros((n, 6))
    slow[:, 4] = 0.5 * np.arange(n) / n
    seen = residuals(generator(still_model(0.05)), standing(n, slow))
    assert np.nanmax(np.abs(seen[:, 1])) < 1.0


def test_nothing_is_learned_of_values_that_are_missing() -> None:
    """Else the unit would be judged by a third of its spread when it comes back."""
    signal = generator(still_model(0.01), adapt=True)
    residuals(signal, with_unit(standing(STARTED + 300), 1, STARTED + 300, np.nan))
    for _ in range(20_000):
        signal.learn()
    probe = np.zeros((2, 6))
    probe[1, 3] = 0.05
    for one in standing(2, probe):
        ratio = abs(signal.step(one, False)[0])
    assert ratio == pytest.approx(5.0 / FACTOR, rel=1e-3)
    # Those of the wheels were learned.
    probe[:, 3], probe[1, 0] = 0.0, 0.05
    for one in standing(2, probe):
        ratio = abs(signal.step(one, False)[0])
    assert ratio > 6.0 / FACTOR


def test_a_unit_that_repeats_itself_for_a_moment_is_still_there() -> None:
    """Real ones may be read twice."""
    n = 300
    outputs = np.zeros((n, 6))
    outputs[100:, 3] = 0.1
    made = standing(n, outputs)
    twice = [
        replace(
            made[k], measurement=replace(made[k].measurement, imu=made[k // 2 * 2].measurement.imu)
        )
        for k in range(n)
    ]
    seen = residuals(generator(still_model(0.01)), twice)
    assert abs(seen[105, 1]) > 1.0


# -- bad input --------------------------------------------------------------------------------------------------------


def test_the_start_and_lost_samples_are_not_judged(model: BaseModel) -> None:
    made = drive(3.0, 5)
    signal = generator(model)
    seen = np.array([signal.step(one, lost=k == 100) for k, one in enumerate(made)])
    judged = np.asarray(np.isfinite(seen).all(axis=1))
    np.testing.assert_array_equal(np.isfinite(seen).any(axis=1), judged)
    assert not judged[: TAPS - 1].any()
    assert judged[STARTED:100].all()
    assert not judged[100 : 101 + WINDOW].any()
    assert judged[101 + WINDOW :].all()


def test_a_base_whose_robot_does_not_follow_its_commands_is_not_judged(model: BaseModel) -> None:
    """The response to its load lasts for TAPS ticks."""
    made = drive(3.0, 5)
    signal = generator(model)
    seen = np.array([signal.step(one, wrong_load=100 <= k < 103) for k, one in enumerate(made)])
    judged = np.asarray(np.isfinite(seen).all(axis=1))
    assert judged[STARTED:100].all()
    assert not judged[100 : 102 + TAPS + WINDOW].any()
    assert judged[103 + TAPS + WINDOW :].all()


def test_a_late_sample_leaves_the_residual_as_it_was(model: BaseModel) -> None:
    """A push that lasts must not end with every sample that comes a tick later."""
    made = drive(3.0, 5)
    expected = residuals(generator(model), made)
    for k in (100, 101, 150):
        made[k].measurement.wheel_speed[:] += 9.0
        made[k].measurement.imu.acceleration[:] = 99.0
    seen = residuals(generator(model), made, late=(100, 101, 150))
    np.testing.assert_array_equal(seen[100:102], seen[[99, 99]])
    np.testing.assert_array_equal(seen[150], seen[149])
    # The response goes on meanwhile.
    after = [k for k in range(100 + WINDOW + 2, len(made)) if not 150 <= k < 151 + WINDOW]
    np.testing.assert_allclose(np.abs(seen[after]), np.abs(expected[after]), atol=0.02)


def test_nothing_is_learned_of_late_samples() -> None:
    signal = generator(still_model(0.01), adapt=True)
    residuals(signal, standing(STARTED + 10))
    probe = standing(2, 0.02)
    before = signal.step(probe[0])
    for _ in range(10_000):
        assert signal.step(probe[1], late=True) == before
        signal.learn()
    assert signal.step(probe[0])[0] == pytest.approx(before[0], rel=0.01)


@pytest.mark.parametrize("part", ["sent", "measurement"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9, -1e300])
def test_values_that_are_not_valid_do_no_lasting_harm(
    model: BaseModel, part: str, value: float
) -> None:
    clean = drive(3.0, 5)
    made = list(clean)
    spoilt = getattr(made[100], part)
    changes: dict[str, Any] = {part: replace(spoilt, wheel_speed=np.full(3, value))}
    made[100] = replace(made[100], **changes)
    with np.errstate(invalid="ignore"):
        seen = residuals(generator(model), made)
    expected = residuals(generator(model), clean)
    after = slice(100 + TAPS + WINDOW, None)
    # The level of the inertial unit has taken in a trace of it.
    np.testing.assert_allclose(seen[after, 1], expected[after, 1], atol=0.1)
    # A residual in between is no push.
    assert np.nanmax(np.abs(seen[90:, 1])) < 1.0


@pytest.mark.parametrize("value", [19.6, -19.6, 1e9, 1e300])
@pytest.mark.parametrize("samples", [1, 2])
def test_a_sample_of_the_inertial_unit_that_is_wrong_is_no_push(value: float, samples: int) -> None:
    """The largest that an accelerometer shows, or what none does; thresholds are 0.1 m/s2 at rest."""
    made = standing(600)
    for k in range(100, 100 + samples):
        made[k].measurement.imu.acceleration[:] = value
    seen = residuals(generator(still_model(0.03)), made)[STARTED:, 1]
    assert np.abs(seen).max() < 0.05
    # In the load of the legs, it would stay in the response.
    made = standing(600)
    made[100].reference.load_torque[LEGS[0]] = 1e9
    loaded = replace(still_model(0.03), coefficients=((0.01,) * 6,) * (TAPS * 6))
    assert np.abs(residuals(generator(loaded), made)[STARTED:, 1]).max() < 0.05


def test_reset_forgets(model: BaseModel) -> None:
    made = drive(2.0, 6)
    signal = generator(model, adapt=True)
    first = residuals(signal, made)
    for _ in range(100):
        signal.learn()
    signal.reset()
    np.testing.assert_array_equal(residuals(signal, made), first)


def test_values_that_make_no_model_are_refused(model: BaseModel) -> None:
    for changes, message in (
        ({"coefficients": model.coefficients[:-1]}, "multiple of 25"),
        ({"still": (0.1, 0.0, 0.1, 0.1, 0.1, 0.1)}, "above 0"),
        ({"driving": (0.1, 0.1, 0.1, 0.1, 0.1, np.nan)}, "not finite"),
        ({"coefficients": ((np.inf,) * 6,) * TAPS}, "not finite"),
    ):
        with pytest.raises(BaseModelError, match=message):
            replace(model, **changes)
    assert issubclass(BaseModelError, PepperError)


def test_other_joints_are_nothing_to_the_base(model: BaseModel) -> None:
    made, other = drive(1.0, 7), drive(1.0, 7)
    for one in other:
        one.reference.load_torque[[j for j in range(JOINTS) if j not in LEGS]] = 50.0
    np.testing.assert_array_equal(
        residuals(generator(model), made), residuals(generator(model), other)
    )
