"""Expected motion of the wheels: a known impulse response is found, and a push on the base is detected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.detection.threshold import (
    BLOCK_TICKS,
    BLOCKS_PER_RANK,
    FIRST_MOTION_TICKS,
    POST_CONTACT_TICKS,
    START_FACTOR,
)
from pepper_driver.observer.fitting.mobile_base import BASE_BOUND_FACTOR, fit_base
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel, BaseModelError
from pepper_driver.observer.recording import Recording, RecordingBuilder
from pepper_driver.observer.residuals.mobile_base import (
    POST_DRIVE_TIME,
    STANDSTILL_SPEED,
    BaseGenerator,
)
from support.observer import CYCLE, JOINTS, ROBOT, tick

WINDOW = 5
LEGS = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
MATRIX = np.asarray(ROBOT.wheels.matrix)

RESPONSE = np.zeros(TAPS)
RESPONSE[1:] = (1 - np.exp(-CYCLE / 0.04)) * np.exp(-np.arange(TAPS - 1) * CYCLE / 0.04)
RECOIL = np.zeros((TAPS, 3))  # of vx, on each joint of the legs
RECOIL[2:6] = [(0.01, -0.007, 0.0), (0.02, -0.01, 0.0), (-0.02, 0.01, 0.0), (-0.01, 0.007, 0.0)]


def filtered(values: FloatArray, response: FloatArray) -> FloatArray:
    return np.convolve(values, response)[: len(values)]


def drive(seconds: float, seed: int, *, stand: float = 0.0, size: float = 0.15) -> list[Tick]:
    """Ticks of a base with this response, that drives to random set-points and stands at the end."""
    rng = np.random.default_rng(seed)
    n, still = round(seconds / CYCLE), round(stand / CYCLE)
    sent = np.repeat(rng.uniform(-size, size, (n // 12 + 1, 3)), 12, axis=0)[:n]
    sent = np.concatenate((sent, np.zeros((still, 3))))
    load = np.repeat(rng.uniform(-0.1, 0.1, ((n + still) // 9 + 1, 3)), 9, axis=0)[: n + still]
    load += np.array([10.0, -8.0, 3.0])
    twist = np.column_stack([filtered(sent[:, axis], RESPONSE) for axis in range(3)])
    for leg in range(3):
        twist[:, 0] += filtered(load[:, leg] - load[0, leg], RECOIL[:, leg])
    twist += 3e-4 * rng.standard_normal(twist.shape)
    return ticks(sent, load, twist)


def ticks(sent: FloatArray, load: FloatArray, twist: FloatArray) -> list[Tick]:
    made = []
    for k in range(len(sent)):
        one = tick(k)
        one.sent.wheel_speed[:] = MATRIX @ sent[k]
        one.reference.load_torque[LEGS] = load[k]
        one.measurement.wheel_speed[:] = MATRIX @ twist[k]
        made.append(one)
    return made


def recorded(made: Sequence[Tick]) -> Recording:
    builder = RecordingBuilder(ROBOT)
    for one in made:
        builder.append(one)
    return builder.finish()


@pytest.fixture(scope="module")
def model() -> BaseModel:
    return fit_base(
        ROBOT, [recorded(drive(30.0, seed, stand=5.0)) for seed in (1, 2)], window=WINDOW
    )


def test_finds_the_impulse_response(model: BaseModel) -> None:
    taps = np.array(model.coefficients).reshape(TAPS, -1, 3)
    assert taps.shape == (TAPS, 3 + len(LEGS), 3)
    for axis in range(3):
        found = taps[:, axis, axis]
        np.testing.assert_allclose(found, RESPONSE, atol=0.03)
        assert found.sum() == pytest.approx(RESPONSE.sum(), abs=0.02)
        others = np.delete(taps[:, :3, axis], axis, axis=1)
        assert np.abs(others).max() < 0.02
    # The response to a load by its change since the oldest tap.
    np.testing.assert_allclose(taps[:-1, 3:, 0], RECOIL[:-1], atol=2e-3)
    assert np.abs(taps[:-1, 3:, 1:]).max() < 2e-3


def residuals(signal: BaseGenerator, made: Sequence[Tick], late: Sequence[int] = ()) -> FloatArray:
    """(n, 2) before and after the filter."""
    return np.array([signal.step(one, k in late) for k, one in enumerate(made)])


def settled(model: BaseModel, made: Sequence[Tick]) -> BaseGenerator:
    """After a first motion, driving and standing, without residuals; with the legs' load of ``made``."""
    signal, first = BaseGenerator(model, ROBOT, WINDOW, adapt=True), made[0]
    gain = np.array(model.coefficients).reshape(TAPS, -1, 3)[:, :3].sum(axis=0)
    for sent in (np.array([2.0 * STANDSTILL_SPEED, 0.0, 0.0]), np.zeros(3)):
        steady = replace(
            first,
            sent=replace(first.sent, wheel_speed=MATRIX @ sent),
            measurement=replace(first.measurement, wheel_speed=MATRIX @ (sent @ gain)),
        )
        for k in range(
            2 * TAPS + round(POST_DRIVE_TIME / CYCLE) + WINDOW + (BLOCKS_PER_RANK + 1) * BLOCK_TICKS
        ):
            signal.step(steady, False)
            if k >= TAPS + WINDOW:
                signal.learn(True, True)
    return signal


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_residual_is_that_of_the_impulse_response(axis: int) -> None:
    """Every tap, written out; for many times the memory of inputs."""
    rng = np.random.default_rng(axis)
    n, legs = 40 * TAPS, len(LEGS)
    taps = rng.normal(size=(TAPS, 3 + legs, 3))
    bound, far = 0.02, 1e12  # the other axes detect nothing
    bounds = tuple(bound if k == axis else far for k in range(3))
    made_of = BaseModel(
        coefficients=tuple((float(a), float(b), float(c)) for a, b, c in taps.reshape(-1, 3)),
        standing=(far,) * 3,
        driving=(bounds[0], bounds[1], bounds[2]),
    )
    sent, load, twist = (rng.normal(size=(n, 3)) for _ in range(3))
    seen = residuals(BaseGenerator(made_of, ROBOT, WINDOW, adapt=True), ticks(sent, load, twist))
    error = np.full(n, np.nan)
    for k in range(TAPS - 1, n):
        expected = 0.0
        for age in range(TAPS):
            change = load[k - age] - load[k - TAPS + 1]
            expected += sent[k - age] @ taps[age, :3, axis] + change @ taps[age, 3:, axis]
        error[k] = expected - twist[k, axis]
    judged = slice(TAPS + WINDOW, None)
    ratio = error / (START_FACTOR * bound)
    np.testing.assert_allclose(seen[judged, 0], ratio[judged], rtol=1e-9, atol=1e-6)
    median = [np.median(ratio[k + 1 - WINDOW : k + 1]) for k in range(TAPS + WINDOW, n)]
    np.testing.assert_allclose(seen[judged, 1], median, rtol=1e-9, atol=1e-6)


def test_bounds_are_wide_until_the_first_motion_has_been_seen(model: BaseModel) -> None:
    n = TAPS + WINDOW + (BLOCKS_PER_RANK + 3) * BLOCK_TICKS
    quiet = ticks(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)))
    pushed = 1.5 * np.array([model.standing[0], 0.0, 0.0])
    [push] = ticks(np.zeros((1, 3)), np.zeros((1, 3)), pushed[None])
    signal = BaseGenerator(model, ROBOT, WINDOW, adapt=True)
    for k, one in enumerate(quiet):
        if k % (4 * BLOCK_TICKS) == TAPS + WINDOW + 1:
            known = max(k - TAPS - WINDOW, 0) / FIRST_MOTION_TICKS
            expected = 1.5 / max(START_FACTOR * (1.0 - known), 1.0)
            # One sample that the filter takes out again.
            assert abs(signal.step(push, False)[0]) == pytest.approx(expected, rel=0.15)
        signal.step(one, False)
        signal.learn(True, True)
    assert abs(signal.step(push, False)[0]) == pytest.approx(1.5, rel=1e-6)


@pytest.mark.parametrize("moving", [False, True])
def test_a_base_with_larger_residuals_today_gets_wider_bounds(
    model: BaseModel, moving: bool
) -> None:
    """It creeps to and fro by 1.5 times its bound; only motion shows that it does so without touch."""
    seconds = 20.0
    n = round(seconds / CYCLE)
    twist = np.zeros((n, 3))
    twist[:, 1] = 1.5 * model.standing[1] * np.sin(np.arange(n) * CYCLE * 2 * np.pi / 0.4)
    made = ticks(np.zeros((n, 3)), np.zeros((n, 3)), twist)
    signal = BaseGenerator(model, ROBOT, WINDOW, adapt=True)
    sizes = []
    for one in made:
        sizes.append(abs(signal.step(one, False)[1]))
        signal.learn(True, moving)
    # In no moment a contact, and of the widened bound it is 1 / ResidualEnvelope' margin.
    assert np.nanmax(sizes) < 1.0
    last = np.max(sizes[-100:])
    assert last == pytest.approx(1.0 / 3.0 if moving else 1.5 / START_FACTOR, rel=0.02)
    # The other axes are as sensitive as ever, if it is known that they are quiet.
    push = np.zeros((WINDOW, 3))
    push[:, 0] = 1.5 * model.standing[0]
    seen = residuals(signal, ticks(np.zeros((WINDOW, 3)), np.zeros((WINDOW, 3)), push))
    assert abs(seen[-1, 1]) == pytest.approx(1.5 if moving else 1.5 / START_FACTOR, rel=1e-6)


def test_a_touch_widens_no_bound(model: BaseModel) -> None:
    """Neither itself nor its beginning, before it is detected."""
    still, pushed = np.zeros((1, 3)), 3.0 * np.array([model.standing])
    [quiet], [push] = (ticks(still, still, twist) for twist in (still, pushed))
    signal = settled(model, [quiet])
    for k in range(4 * BLOCK_TICKS):
        signal.step(push, False)
        signal.learn(k < 2 * BLOCK_TICKS + BLOCK_TICKS // 2, True)
    for _ in range(POST_CONTACT_TICKS + 4 * BLOCK_TICKS):
        signal.step(quiet, False)
        signal.learn(True, True)
    assert abs(signal.step(push, False)[0]) == pytest.approx(3.0, rel=1e-6)


def test_bounds_hold_on_motion_like_that_of_the_calibration(model: BaseModel) -> None:
    assert min(*model.standing, *model.driving) > 0
    assert (np.array(model.driving) >= np.array(model.standing)).all()
    for seed in (1, 2):
        made = drive(30.0, seed, stand=5.0)
        seen = residuals(settled(model, made), made)
        assert np.nanmax(np.abs(seen[:, 1])) <= 1.0 / BASE_BOUND_FACTOR + 1e-6
    made = drive(20.0, 77, stand=5.0)
    seen = residuals(settled(model, made), made)
    assert np.nanmax(np.abs(seen[:, 1])) < 1.0
    assert np.isfinite(seen[TAPS + WINDOW :]).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_detects_a_push_on_a_base_that_stands(model: BaseModel, axis: int, side: float) -> None:
    n = 200
    twist = np.zeros((n, 3))
    pushed = range(100, 130)
    twist[pushed, axis] = side * 2.0 * model.standing[axis]
    made = ticks(np.zeros((n, 3)), np.zeros((n, 3)), twist)
    seen = residuals(settled(model, made), made)
    # Expected minus measured: a base that is moved on has a negative residual.
    late = pushed[WINDOW // 2 :]  # before, the filter shows another axis
    np.testing.assert_allclose(seen[late, 0], -2.0 * side, rtol=1e-6)
    over = np.flatnonzero(np.abs(seen[:, 1]) > 1.0)
    assert (over[0], over[-1]) == (100 + WINDOW // 2, 129 + WINDOW // 2)


def test_a_push_that_moves_two_axes_keeps_its_sign(model: BaseModel) -> None:
    n = 200
    noise = np.random.default_rng(0)
    twist = np.zeros((n, 3))
    twist[100:, 0] = model.standing[0] * (2.0 + 0.5 * noise.standard_normal(100))
    twist[100:, 2] = -model.standing[2] * (2.0 + 0.5 * noise.standard_normal(100))
    made = ticks(np.zeros((n, 3)), np.zeros((n, 3)), twist)
    seen = residuals(settled(model, made), made)[110:, 1]
    assert np.abs(seen).min() > 1.0
    assert (np.sign(seen) == np.sign(seen[0])).all()


def test_the_bound_of_a_base_that_drives_stays_until_it_stands(model: BaseModel) -> None:
    n, stop = 400, 150
    wide = replace(
        model, standing=(0.001,) * 3, driving=(0.01,) * 3, coefficients=((0.0,) * 3,) * 150
    )
    sent, twist = np.zeros((n, 3)), np.zeros((n, 3))
    sent[:stop, 0] = 0.05
    twist[:, 1] = -0.005
    made = ticks(sent, np.zeros((n, 3)), twist)
    seen = residuals(settled(wide, made), made)
    after = stop + TAPS + round(POST_DRIVE_TIME / CYCLE)
    assert seen[after - 3, 0] == pytest.approx(0.5)
    assert seen[after + 2, 0] == pytest.approx(5.0)


def test_late_samples_and_the_start_are_not_judged(model: BaseModel) -> None:
    made = drive(3.0, 5)
    seen = residuals(BaseGenerator(model, ROBOT, WINDOW, adapt=True), made, late=(100,))
    judged = np.asarray(np.isfinite(seen).all(axis=1))
    np.testing.assert_array_equal(np.isfinite(seen).any(axis=1), judged)
    assert not judged[: TAPS - 1].any()
    assert judged[TAPS + WINDOW : 100].all()
    assert not judged[100 : 100 + WINDOW].any()
    assert judged[100 + WINDOW :].all()


@pytest.mark.parametrize("part", ["sent", "measurement"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_do_no_lasting_harm(
    model: BaseModel, part: str, value: float
) -> None:
    clean = drive(3.0, 5)
    made = list(clean)
    spoilt = getattr(made[100], part)
    changes: dict[str, Any] = {part: replace(spoilt, wheel_speed=np.full(3, value))}
    made[100] = replace(made[100], **changes)
    with np.errstate(invalid="ignore"):
        seen = residuals(settled(model, clean), made)
    expected = residuals(settled(model, clean), clean)
    after = slice(100 + TAPS + round(POST_DRIVE_TIME / CYCLE), None)
    np.testing.assert_allclose(seen[after], expected[after])
    # A residual in between is no push.
    assert np.nanmax(np.abs(seen[90:, 1])) < 1.0


def test_reset_forgets(model: BaseModel) -> None:
    made = drive(2.0, 6)
    signal = settled(model, made)
    signal.reset()
    first = residuals(signal, made)
    np.testing.assert_array_equal(
        residuals(BaseGenerator(model, ROBOT, WINDOW, adapt=True), made), first
    )
    signal.reset()
    np.testing.assert_array_equal(residuals(signal, made), first)


def test_values_that_make_no_model_are_refused(model: BaseModel) -> None:
    for changes, message in (
        ({"coefficients": model.coefficients[:-1]}, "multiple of 25"),
        ({"standing": (0.1, 0.0, 0.1)}, "above 0"),
        ({"driving": (0.1, np.nan, 0.1)}, "not finite"),
        ({"coefficients": ((np.inf, 0.0, 0.0),) * TAPS}, "not finite"),
    ):
        with pytest.raises(BaseModelError, match=message):
            replace(model, **changes)
    assert issubclass(BaseModelError, PepperError)


def test_other_joints_are_nothing_to_the_base(model: BaseModel) -> None:
    made = drive(1.0, 7)
    other = drive(1.0, 7)
    for one in other:
        one.reference.load_torque[[j for j in range(JOINTS) if j not in LEGS]] = 50.0
    np.testing.assert_array_equal(
        residuals(BaseGenerator(model, ROBOT, WINDOW, adapt=True), made),
        residuals(BaseGenerator(model, ROBOT, WINDOW, adapt=True), other),
    )
