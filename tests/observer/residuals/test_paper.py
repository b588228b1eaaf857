"""Residual of mode ``paper``, against Eq. 12 and Eq. 13 written out."""

from __future__ import annotations

import numpy as np
import pytest

from pepper_driver.observer.models.tree import Tree
from pepper_driver.observer.residuals.paper import PaperGenerator
from support.observer import AFFINE, JOINTS, ROBOT, SETTINGS, SILENT, THRESHOLD, tick

WINDOW = SETTINGS.median_window
ELBOW, HEAD = ROBOT.joint_index("LElbowRoll"), ROBOT.joint_index("HeadYaw")


def generator(tree: Tree) -> PaperGenerator:
    return PaperGenerator([tree] * JOINTS, np.full(JOINTS, THRESHOLD), WINDOW)


def test_residual_is_the_median_of_measured_minus_expected_error() -> None:
    rng = np.random.default_rng(0)
    errors = 0.01 * rng.standard_normal((40, JOINTS))
    features = rng.uniform(-1.5, 1.5, size=(40, 3))
    target, raw = generator(AFFINE), []
    for k in range(40):
        seen = target.step(tick(k, errors[k], features=tuple(features[k])))
        expected = AFFINE.predict(features[k : k + 1])[0]
        raw.append(errors[k] - expected)
        np.testing.assert_allclose(seen.expected, expected, atol=1e-15)
        np.testing.assert_allclose(seen.raw, raw[-1], atol=1e-12)
        # At the start that of fewer samples.
        median = np.median(raw[-WINDOW:], axis=0)
        np.testing.assert_allclose(seen.residual, median, atol=1e-12)
        np.testing.assert_array_equal(seen.threshold, THRESHOLD)
        assert np.isnan(seen.torque).all()
        assert np.isnan(seen.torque_std).all()
        assert not seen.blind.any()


def test_expected_error_uses_the_joint_s_own_reference() -> None:
    one = tick(0, features=(0.1, 0.0, 1.0))
    one.reference.velocity[ELBOW] = 0.2
    expected = generator(AFFINE).step(one).expected
    assert expected[ELBOW] == pytest.approx(0.1 + 0.4 + 0.5)
    assert expected[HEAD] == pytest.approx(0.1 + 0.2 + 0.5)


def test_the_error_is_taken_from_what_was_sent() -> None:
    one = tick(0)
    one.sent.position[:] = one.measurement.position + 0.02
    np.testing.assert_allclose(generator(SILENT).step(one).residual, 0.02)


def test_a_joint_without_a_tree_is_blind() -> None:
    trees: list[Tree | None] = [SILENT] * JOINTS
    trees[ELBOW] = None
    target = PaperGenerator(trees, np.full(JOINTS, THRESHOLD), WINDOW)
    for k in range(2 * WINDOW):
        seen = target.step(tick(k, 0.01))
        assert np.flatnonzero(seen.blind).tolist() == [ELBOW]
        assert np.flatnonzero(np.isnan(seen.residual)).tolist() == [ELBOW]


def test_reset_forgets_samples_and_blindness() -> None:
    target = generator(SILENT)
    for k in range(WINDOW):
        target.step(tick(k, 0.5))
    target.step(tick(WINDOW, np.nan))
    target.reset()
    seen = target.step(tick(0, 0.01))
    assert not seen.blind.any()
    np.testing.assert_allclose(seen.residual, 0.01)
