from __future__ import annotations

import numpy as np
import pytest
from sklearn.tree import DecisionTreeRegressor

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.fitting.tree import AffineGrowth, fit_affine, fit_cart
from pepper_driver.observer.models.tree import BatchedTrees
from support.observer import free_error, motion


def boxes(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """A function with jumps that is affine in each of three boxes; features of unlike size and offset."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, size=(n, 3)) * (2.0, 30.0, 0.5) + (0.0, 5.0, -3.0)
    v, a, t = x.T
    y = np.where(
        v <= 0.3,
        0.05 * v - 0.2 + t,
        np.where(a <= -4.0, 1.0 + 0.01 * a, 0.3 * v + 0.02 * a - 2 * t),
    )
    return x, y


@pytest.mark.parametrize("min_samples_leaf", [1, 50])
def test_cart_is_the_tree_of_scikit_learn(min_samples_leaf: int) -> None:
    rng = np.random.default_rng(1)
    x, y = boxes(4000, 0)
    y += 0.1 * rng.standard_normal(len(y))
    ours = fit_cart(x, y, min_samples_leaf=min_samples_leaf)
    theirs = DecisionTreeRegressor(min_samples_leaf=min_samples_leaf, random_state=0).fit(x, y)
    probe = boxes(4000, 2)[0] * 1.5
    assert ours.leaves == theirs.get_n_leaves()
    for features in (x, probe):
        np.testing.assert_allclose(
            ours.predict(features), theirs.predict(features), rtol=0, atol=1e-12
        )
        one_by_one = BatchedTrees([ours] * 300).predict(*np.ascontiguousarray(features[:300].T))
        np.testing.assert_allclose(one_by_one, theirs.predict(features[:300]), rtol=0, atol=1e-12)


def test_cart_decides_like_scikit_learn_between_neighbouring_single_floats() -> None:
    # Thresholds here are middles of neighbouring singles: rounding decides, ties to even included.
    singles = np.float32(4.1) + np.arange(8, dtype=np.float32) * np.spacing(np.float32(4.1))
    x = np.repeat(singles.astype(np.float64), 5)[:, None] * np.ones(3)
    y = np.repeat(np.arange(8.0), 5)
    ours = fit_cart(x, y, min_samples_leaf=1)
    theirs = DecisionTreeRegressor(random_state=0).fit(x, y)
    assert ours.leaves == 8
    grid = np.linspace(float(singles[0]), float(singles[-1]), 15)
    probe = np.concatenate((grid, np.nextafter(grid, 9), np.nextafter(grid, 0)))[:, None] * np.ones(
        3
    )
    np.testing.assert_array_equal(ours.predict(probe), theirs.predict(probe))


def test_affine_recovers_a_piecewise_affine_function() -> None:
    x, y = boxes(6000, 0)
    tree = fit_affine(x, y, leaves=3, shrinkage=0.0)
    assert tree.leaves == 3
    assert tree.feature[0] == 0
    assert tree.threshold[0] == pytest.approx(0.3, abs=1e-3)
    probe, expected = boxes(3000, 1)
    near_a_border = (np.abs(probe[:, 0] - 0.3) < 2e-3) | (np.abs(probe[:, 1] + 4.0) < 3e-2)
    assert near_a_border.mean() < 0.01
    error = tree.predict(probe) - expected
    assert np.abs(error[~near_a_border]).max() < 1e-6


def test_affine_does_not_split_what_is_affine() -> None:
    x = boxes(2000, 0)[0]
    tree = fit_affine(x, 0.1 + x @ np.array([0.5, -0.01, 2.0]), leaves=64, shrinkage=0.0)
    assert tree.leaves == 1
    np.testing.assert_allclose(tree.coefficients[0], (0.1, 0.5, -0.01, 2.0), atol=1e-7)


def test_one_leaf_without_shrinkage_is_least_squares() -> None:
    features = motion(4.0, 0, 30.0)
    error = free_error(features, 1)
    tree = fit_affine(features, error, leaves=1, shrinkage=0.0)
    design = np.column_stack((np.ones(len(error)), features))
    expected = np.linalg.lstsq(design, error, rcond=None)[0]
    np.testing.assert_allclose(tree.coefficients[0], expected, rtol=1e-5, atol=1e-8)


def test_affine_beats_cart_beyond_the_motions_of_the_fit() -> None:
    slow, fast = motion(3.0, 0, 40.0), motion(9.0, 1, 20.0)
    truth = 0.05 * fast[:, 0] + 0.004 * fast[:, 1] + fast[:, 2] / 60
    target = 0.05 * slow[:, 0] + 0.004 * slow[:, 1] + slow[:, 2] / 60
    assert np.abs(fast).max(axis=0)[0] > 1.3 * np.abs(slow).max(axis=0)[0]
    affine = fit_affine(slow, target, leaves=16, shrinkage=10.0).predict(fast) - truth
    cart = fit_cart(slow, target).predict(fast) - truth
    assert np.abs(affine).max() < 0.1 * np.abs(cart).max()


def test_extrapolation_ends_one_range_beyond_the_fit() -> None:
    x = np.random.default_rng(0).uniform(-1, 1, size=(2000, 3))
    tree = fit_affine(x, x[:, 0].copy(), leaves=4, shrinkage=0.0)
    assert tree.predict(np.array([[2.5, 0.0, 0.0]]))[0] == pytest.approx(2.5, abs=1e-5)
    assert tree.predict(np.array([[50.0, 0.0, 0.0]]))[0] == pytest.approx(3.0, abs=1e-2)
    assert tree.predict(np.array([[-50.0, 9.0, -9.0]]))[0] == pytest.approx(-3.0, abs=1e-2)


def test_shrinkage_draws_leaves_to_their_ancestors() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 3))
    x[:, 1] = np.where(x[:, 0] > 1.0, 0.0, x[:, 1])  # the right part says nothing about x1
    y = 2.0 * x[:, 1] + 5.0 * (x[:, 0] > 1.0)
    tree = fit_affine(x, y, leaves=2, shrinkage=1.0)
    right = tree.coefficients[tree.right[0]]
    assert right[2] == pytest.approx(2.0, rel=0.05)
    assert tree.predict(x) == pytest.approx(y, abs=0.05)

    growth = AffineGrowth(x, y, max_leaves=8)
    flat = growth.cut(8, 1e12)
    np.testing.assert_allclose(flat.predict(x), y.mean(), atol=1e-4)


def test_a_small_tree_is_the_beginning_of_a_large_one() -> None:
    features = motion(4.0, 3, 60.0)
    error = np.sin(5 * features[:, 0]) * np.cos(features[:, 2])
    growth = AffineGrowth(features, error, max_leaves=40)
    for leaves in (1, 2, 7, 16):
        cut = growth.cut(leaves, 10.0)
        assert cut.leaves == leaves
        assert cut == fit_affine(features, error, leaves=leaves, shrinkage=10.0)
    errors = [np.std(error - growth.cut(n, 0.0).predict(features)) for n in (1, 2, 7, 16, 40)]
    assert errors == sorted(errors, reverse=True)


def test_leaves_keep_their_least_number_of_samples() -> None:
    x, y = boxes(3000, 0)
    affine = fit_affine(x, y**2, leaves=64, shrinkage=0.0, min_samples_leaf=130)
    cart = fit_cart(x, y, min_samples_leaf=130)
    for tree in (affine, cart):
        counts = np.bincount(tree.leaf_of(x))
        assert 130 <= counts[counts > 0].min() < 260
        assert tree.leaves > 5


def test_same_data_same_bits() -> None:
    features = motion(5.0, 5, 30.0)
    error = free_error(features, 6)
    first = fit_affine(features, error, leaves=32, shrinkage=10.0)
    assert first == fit_affine(features.copy(), error.copy(), leaves=32, shrinkage=10.0)
    assert fit_cart(features, error) == fit_cart(features.copy(), error.copy())


def test_features_that_never_change_do_no_harm() -> None:
    features = motion(4.0, 7, 20.0)
    features[:, 2] = 3.7
    features[:, 1] = 0.0
    assert 0.0 < features[:, 2].std() < 1e-12  # rounding
    error = 0.3 + np.tanh(9 * features[:, 0])
    tree = fit_affine(features, error, leaves=16, shrinkage=0.0)
    np.testing.assert_allclose(tree.predict(features), error, atol=0.1)
    slopes = np.array(tree.coefficients)[:, 1:]
    assert np.abs(slopes[:, 1:]).max() < 1e-6
