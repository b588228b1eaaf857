"""Adaptation against ridge regression over all samples at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.residuals.adaptation import (
    NOISE_FACTOR,
    OFFSET_UNIT,
    PRIOR_STD,
    PROCESS_NOISE,
    WEAR_RATIO,
    Adaptation,
)
from support.examples import examples
from support.fusion import STICK_SLIP
from support.observer import CYCLE

SPREAD = 1e-3
STILL = np.zeros(4)


def adapt(count: int = 2, process_noise: FloatArray = PROCESS_NOISE) -> Adaptation:
    spread = np.full(count, SPREAD)
    return Adaptation([STICK_SLIP] * count, spread, CYCLE, process_noise=process_noise)


def samples(n: int, seed: int, joints: int = 2) -> FloatArray:
    """(n, joints, 4) effects as they come about."""
    rng = np.random.default_rng(seed)
    friction = 0.008 * rng.choice([-1.0, 0.3, 1.0], size=(n, joints))
    velocity = rng.uniform(-1.5, 1.5, size=(n, joints))
    load = 0.03 * rng.uniform(-1.0, 1.0, size=(n, joints))
    target = adapt(joints)
    rows = zip(friction, velocity, load, strict=True)
    return np.array([target.effects(*row) for row in rows])


def ridge(effects: FloatArray, residual: FloatArray, prior: FloatArray) -> FloatArray:
    """(4,) least squares of one joint with the prior as penalty."""
    noise = (NOISE_FACTOR * SPREAD) ** 2
    precision = effects.T @ effects / noise + np.diag(prior**-2)
    return np.asarray(np.linalg.solve(precision, effects.T @ residual / noise), dtype=np.float64)


def test_effects_are_those_of_the_terms_of_the_model() -> None:
    effects = adapt().effects(np.array([0.008, -0.008]), np.array([0.5, 0.0]), np.array([0.1, 0.2]))
    expected = [[0.008, STICK_SLIP.lag * 0.5, 0.1, OFFSET_UNIT], [-0.008, 0.0, 0.2, OFFSET_UNIT]]
    np.testing.assert_allclose(effects, expected)


def test_without_wandering_it_is_ridge_regression() -> None:
    target = adapt(process_noise=STILL)
    effects = samples(80, 0)
    true = np.array([[0.2, -0.1, 0.3, 0.5], [-0.15, 0.2, -0.2, -0.4]])
    residual = np.einsum("nji,ji->nj", effects, true)
    residual += SPREAD * np.random.default_rng(1).standard_normal(residual.shape)
    for k in range(80):
        # The models follow: the rest is what they do not contain yet.
        left = residual[k] - (effects[k] * target.deviation).sum(axis=1)
        target.update(left, effects[k], np.zeros(2), np.ones(2, dtype=np.bool_))
        for joint in range(2):
            batch = ridge(effects[: k + 1, joint], residual[: k + 1, joint], PRIOR_STD)
            np.testing.assert_allclose(target.deviation[joint], batch, rtol=1e-6, atol=1e-9)
    # And that of many samples is the truth.
    np.testing.assert_allclose(target.deviation, true, atol=0.15)


def test_variance_is_that_of_ridge_regression() -> None:
    target = adapt(process_noise=STILL)
    effects = samples(30, 2)
    for row in effects:
        target.update(np.zeros(2), row, np.zeros(len(row)), np.ones(2, dtype=np.bool_))
    asked = samples(1, 3)[0]
    for joint in range(2):
        precision = effects[:, joint].T @ effects[:, joint] / (NOISE_FACTOR * SPREAD) ** 2
        covariance = np.linalg.inv(precision + np.diag(PRIOR_STD**-2.0))
        expected = asked[joint] @ covariance @ asked[joint]
        assert target.variance(asked)[joint] == pytest.approx(expected, rel=1e-6)


def test_what_else_is_not_known_counts_as_noise() -> None:
    """Samples that differ in noise, against least squares with their weights."""
    target = adapt(process_noise=STILL)
    effects = samples(60, 13)
    rng = np.random.default_rng(14)
    other = rng.uniform(0.0, 4e-5, size=(60, 2))
    residual = 0.005 * rng.standard_normal((60, 2))
    for k in range(60):
        left = residual[k] - (effects[k] * target.deviation).sum(axis=1)
        target.update(left, effects[k], other[k], np.ones(2, dtype=np.bool_))
    asked = samples(1, 15)[0]
    for joint in range(2):
        rows = effects[:, joint] / ((NOISE_FACTOR * SPREAD) ** 2 + other[:, joint])[:, None]
        covariance = np.linalg.inv(rows.T @ effects[:, joint] + np.diag(PRIOR_STD**-2.0))
        batch = covariance @ rows.T @ residual[:, joint]
        np.testing.assert_allclose(target.deviation[joint], batch, rtol=1e-6, atol=1e-9)
        expected = asked[joint] @ covariance @ asked[joint]
        assert target.variance(asked)[joint] == pytest.approx(expected, rel=1e-6)


def test_before_anything_is_seen_it_is_that_of_the_prior() -> None:
    asked = samples(1, 4)[0]
    expected = ((asked * PRIOR_STD) ** 2).sum(axis=1)
    np.testing.assert_allclose(adapt().variance(asked), expected)


def test_touched_joints_learn_nothing() -> None:
    target = adapt()
    effects = samples(50, 5)
    for row in effects:
        target.update(np.full(2, 0.05), row, np.zeros(len(row)), np.array([True, False]))
    assert np.abs(target.deviation[0]).max() > 0.1
    assert (target.deviation[1] == 0).all()
    asked = samples(1, 6)[0]
    # They do not become less certain than at the start either.
    assert target.variance(asked)[1] == pytest.approx(adapt().variance(asked)[1])


def test_knowledge_of_a_touched_joint_grows_old() -> None:
    target = adapt(1)
    free, touched = np.array([True]), np.array([False])
    effects = samples(100, 7, joints=1)
    for row in effects:
        target.update(np.zeros(1), row, np.zeros(len(row)), free)
    asked = samples(1, 8, joints=1)[0]
    before = target.variance(asked)[0]
    for row in effects:
        target.update(np.zeros(1), row, np.zeros(len(row)), touched)
    assert before < target.variance(asked)[0] < adapt(1).variance(asked)[0]


@examples(30)
@given(st.integers(0, 1000), st.integers(1, 120), st.floats(0.0, 0.1))
def test_variance_never_exceeds_the_prior(seed: int, n: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    target, prior = adapt(), adapt()
    units = np.eye(4)[:, None, :].repeat(2, axis=1)
    for row in samples(n, seed):
        target.update(
            size * rng.standard_normal(2), row, np.zeros(len(row)), rng.uniform(size=2) < 0.7
        )
        for unit in units:
            assert (target.variance(unit) <= prior.variance(unit) * (1 + 1e-9)).all()
    assert np.isfinite(target.deviation).all()
    assert (np.abs(target.deviation) <= 3 * PRIOR_STD + 1e-12).all()


def test_follows_what_changes_slowly() -> None:
    target = adapt(1)
    effects = samples(3000, 9, joints=1)
    # Six minutes in which friction first stays, then grows by a tenth.
    friction = np.concatenate((np.zeros(1500), np.linspace(0.0, 0.1, 1500)))
    for ratio, row in zip(friction, effects, strict=True):
        target.update(
            ratio * row[:, 0] - row @ target.deviation[0], row, np.zeros(len(row)), np.array([True])
        )
    assert target.deviation[0, 0] == pytest.approx(0.1, abs=0.04)


def test_worn_is_surely_more_friction_or_lag_than_identified() -> None:
    """By two standard deviations of what is known: at first those of PRIOR_STD."""
    target = adapt(4)
    assert not target.worn.any()
    target.deviation[:2, :2] = WEAR_RATIO + 2.0 * PRIOR_STD[:2] - 0.01
    assert not target.worn.any()
    target.deviation[:2] = 0.0
    target.deviation[0, 0] = WEAR_RATIO + 2.0 * PRIOR_STD[0] + 0.01
    target.deviation[1, 1] = WEAR_RATIO + 2.0 * PRIOR_STD[1] + 0.01
    target.deviation[2, 2:] = 10.0
    target.deviation[3, :2] = -1.0
    np.testing.assert_array_equal(target.worn, [True, True, False, False])


def test_joints_without_a_model_disturb_no_other() -> None:
    target = Adaptation([STICK_SLIP, None], np.array([SPREAD, np.nan]), CYCLE)
    alone = adapt(1)
    for row in samples(40, 10, joints=1):
        both = np.nan_to_num(np.vstack((row, np.full((1, 4), np.nan))))
        target.update(np.array([0.01, 0.0]), both, np.zeros(2), np.array([True, False]))
        alone.update(np.array([0.01]), row, np.zeros(len(row)), np.array([True]))
    np.testing.assert_allclose(target.deviation[0], alone.deviation[0])
    assert (target.deviation[1] == 0).all()


def test_reset_forgets() -> None:
    target = adapt()
    for row in samples(40, 11):
        target.update(np.full(2, 0.02), row, np.zeros(len(row)), np.ones(2, dtype=np.bool_))
    target.reset()
    assert (target.deviation == 0).all()
    asked = samples(1, 12)[0]
    np.testing.assert_array_equal(target.variance(asked), adapt().variance(asked))


def test_a_stronger_lag_is_relative_to_the_models_lag() -> None:
    slow = Adaptation([replace(STICK_SLIP, lag=0.06)], np.array([SPREAD]), CYCLE)
    assert slow.effects(np.zeros(1), np.ones(1), np.zeros(1))[0, 1] == pytest.approx(0.06)
