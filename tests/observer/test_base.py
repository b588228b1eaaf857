"""What the wheels should do: a known impulse response is found, and a push on the base is felt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from observer_cases import CYCLE, JOINTS, ROBOT, FloatArray, tick

from pepper_driver.config import PepperError
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.base import (
    HOLD,
    MARGIN,
    TAPS,
    BaseModel,
    BaseModelError,
    BaseSignal,
    fit_base,
)
from pepper_driver.observer.recording import Recording, RecordingBuilder

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


def residuals(signal: BaseSignal, made: Sequence[Tick], late: Sequence[int] = ()) -> FloatArray:
    """(n, 2) before and after the filter."""
    return np.array([signal.step(one, k in late) for k, one in enumerate(made)])


def test_bounds_hold_on_motion_like_that_of_the_calibration(model: BaseModel) -> None:
    assert min(*model.standing, *model.driving) > 0
    assert (np.array(model.driving) >= np.array(model.standing)).all()
    for seed in (1, 2):
        seen = residuals(BaseSignal(model, ROBOT, WINDOW), drive(30.0, seed, stand=5.0))
        assert np.nanmax(np.abs(seen[:, 1])) <= 1.0 / MARGIN + 1e-6
    seen = residuals(BaseSignal(model, ROBOT, WINDOW), drive(20.0, 77, stand=5.0))
    assert np.nanmax(np.abs(seen[:, 1])) < 1.0
    assert np.isfinite(seen[TAPS + WINDOW :]).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_feels_a_push_on_a_base_that_stands(model: BaseModel, axis: int, side: float) -> None:
    n = 200
    twist = np.zeros((n, 3))
    pushed = range(100, 130)
    twist[pushed, axis] = side * 2.0 * model.standing[axis]
    seen = residuals(
        BaseSignal(model, ROBOT, WINDOW), ticks(np.zeros((n, 3)), np.zeros((n, 3)), twist)
    )
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
    seen = residuals(BaseSignal(model, ROBOT, WINDOW), made)[110:, 1]
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
    seen = residuals(BaseSignal(wide, ROBOT, WINDOW), ticks(sent, np.zeros((n, 3)), twist))
    after = stop + TAPS + round(HOLD / CYCLE)
    assert seen[after - 3, 0] == pytest.approx(0.5)
    assert seen[after + 2, 0] == pytest.approx(5.0)


def test_late_samples_and_the_start_are_not_judged(model: BaseModel) -> None:
    made = drive(3.0, 5)
    seen = residuals(BaseSignal(model, ROBOT, WINDOW), made, late=(100,))
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
        seen = residuals(BaseSignal(model, ROBOT, WINDOW), made)
    expected = residuals(BaseSignal(model, ROBOT, WINDOW), clean)
    after = slice(100 + TAPS + round(HOLD / CYCLE), None)
    np.testing.assert_allclose(seen[after], expected[after])
    # What is said meanwhile is no push.
    assert np.nanmax(np.abs(seen[90:, 1])) < 1.0


def test_reset_forgets(model: BaseModel) -> None:
    made = drive(2.0, 6)
    signal = BaseSignal(model, ROBOT, WINDOW)
    first = residuals(signal, made)
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
        residuals(BaseSignal(model, ROBOT, WINDOW), made),
        residuals(BaseSignal(model, ROBOT, WINDOW), other),
    )
