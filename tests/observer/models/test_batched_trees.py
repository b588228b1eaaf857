"""All trees at once, against each by itself: the same bits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.fitting.tree import fit_affine, fit_cart
from pepper_driver.observer.models.tree import (
    FEATURES,
    LEAF,
    AffineTree,
    BatchedTrees,
    CartTree,
    Tree,
)
from support.observer import AFFINE, SILENT

Random = np.random.Generator

GRID = np.linspace(-1.0, 1.0, 5)
"""Thresholds and samples come from few values: they often meet, and splits often repeat or contradict each other."""


def structure(rng: Random, leaves: int) -> tuple[list[int], list[float], list[int], list[int]]:
    """Feature, threshold, left, right of a tree that grew at random leaves."""
    feature, threshold, left, right = [LEAF], [0.0], [LEAF], [LEAF]
    for _ in range(leaves - 1):
        node = int(rng.choice([k for k, f in enumerate(feature) if f == LEAF]))
        feature[node], threshold[node] = int(rng.integers(FEATURES)), float(rng.choice(GRID))
        left[node], right[node] = len(feature), len(feature) + 1
        for column, nothing in ((feature, LEAF), (left, LEAF), (right, LEAF)):
            column += [nothing] * 2
        threshold += [0.0] * 2
    return feature, threshold, left, right


def random_cart(rng: Random) -> CartTree:
    feature, threshold, left, right = structure(rng, int(rng.integers(1, 12)))
    return CartTree(
        feature=tuple(feature),
        threshold=tuple(threshold),
        left=tuple(left),
        right=tuple(right),
        value=tuple(rng.normal(size=len(feature)).tolist()),
    )


def random_affine(rng: Random) -> AffineTree:
    feature, threshold, left, right = structure(rng, int(rng.integers(1, 12)))
    a, b, c = rng.uniform(-1.2, 0.5, 3).tolist()
    return AffineTree(
        feature=tuple(feature),
        threshold=tuple(threshold),
        left=tuple(left),
        right=tuple(right),
        coefficients=tuple(tuple(row) for row in rng.normal(size=(len(feature), 4)).tolist()),
        lower=(a, b, c),
        upper=(a + 0.7, b + 0.7, c + 0.7),
    )


def random_samples(rng: Random, n: int, joints: int) -> FloatArray:
    """(n, 3, joints): on thresholds, next to them, between and far beyond."""
    on = rng.choice(GRID, size=(n, FEATURES, joints))
    near = np.nextafter(on, rng.choice([-2.0, 2.0], size=on.shape))
    anywhere = rng.choice([1.0, 100.0], size=on.shape) * rng.normal(size=on.shape)
    kind = rng.integers(3, size=on.shape)
    chosen: FloatArray = np.choose(kind, [on, near, anywhere])
    return chosen


def check(trees: Sequence[Tree | None], samples: FloatArray) -> None:
    forest = BatchedTrees(trees)
    together = np.array([forest.predict(*features) for features in samples])
    for joint, tree in enumerate(trees):
        alone = np.nan if tree is None else tree.predict(samples[:, :, joint])
        np.testing.assert_array_equal(together[:, joint], alone)


MAKERS: list[Callable[[Random], Tree | None]] = [random_cart, random_affine, lambda _: None]


@given(st.lists(st.sampled_from([0, 1, 2]), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_equals_each_tree_by_itself(kinds: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    trees = [MAKERS[kind](rng) for kind in kinds]
    check(trees, random_samples(rng, 30, len(trees)))


@pytest.mark.parametrize("kind", ["cart", "affine"])
def test_equals_fitted_trees(kind: str) -> None:
    rng = np.random.default_rng(0)
    trees: list[Tree] = []
    for leaves in (40, 5, 1):
        features = rng.normal(size=(2000, FEATURES))
        target = np.sin(3 * features).prod(axis=1)
        if kind == "cart":
            trees.append(fit_cart(features, target, min_samples_leaf=2000 // leaves))
        else:
            trees.append(fit_affine(features, target, leaves=leaves, shrinkage=1.0))
    assert max(tree.leaves for tree in trees) > 10
    samples = 1.5 * rng.normal(size=(2000, FEATURES, len(trees)))
    # Thresholds lie on samples here and there.
    for joint, tree in enumerate(trees):
        for node, feature in enumerate(tree.feature):
            if feature != LEAF:
                samples[node, feature, joint] = tree.threshold[node]
    check(trees, samples)


def test_a_sample_on_a_threshold_goes_left() -> None:
    tree = CartTree(
        feature=(1, -1, -1), threshold=(0.5, 0.0, 0.0), left=(1, -1, -1), right=(2, -1, -1),
        value=(0.0, 3.0, 4.0),
    )  # fmt: skip
    above = float(np.nextafter(0.5, 1.0))
    features = np.array([[9.0] * 2, [0.5, above], [9.0] * 2])
    np.testing.assert_array_equal(BatchedTrees([tree] * 2).predict(*features), [3.0, 4.0])


def test_features_are_clamped_to_the_bounds_of_their_own_tree() -> None:
    wide = replace(AFFINE, lower=(-20.0,) * 3, upper=(20.0,) * 3)
    features = np.array([[9.0] * 2, [-99.0] * 2, [9.0] * 2])
    # Clamped to (2, -10, 5) and (9, -20, 9), in the leaf 0.2 - acceleration + 3 load.
    np.testing.assert_allclose(
        BatchedTrees([AFFINE, wide]).predict(*features), [0.2 + 10 + 15, 0.2 + 20 + 27]
    )


def test_a_joint_without_a_tree_gets_nan() -> None:
    np.testing.assert_array_equal(
        BatchedTrees([None, SILENT]).predict(*np.zeros((3, 2))), [np.nan, 0.0]
    )
    np.testing.assert_array_equal(
        BatchedTrees([None, None]).predict(*np.zeros((3, 2))), [np.nan] * 2
    )


@pytest.mark.parametrize("tree", [AFFINE, random_cart(np.random.default_rng(3))])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(FEATURES))
def test_values_that_are_not_finite_harm_no_other_joint(
    tree: Tree, value: float, place: int
) -> None:
    features = np.full((FEATURES, 3), 0.1)
    features[place, 1] = value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        values = BatchedTrees([tree] * 3).predict(*features)
    [expected] = tree.predict(np.full((1, FEATURES), 0.1))
    np.testing.assert_array_equal(values[[0, 2]], [expected] * 2)
    if isinstance(tree, AffineTree):
        # Infinite features are clamped, and others spoil the value.
        exact = math.nan if math.isnan(value) else tree.predict(features[None, :, 1])[0]
        np.testing.assert_array_equal(values[1], exact)
    else:
        assert values[1] in tree.value


def test_what_goes_in_is_only_read() -> None:
    features = np.full((FEATURES, 2), 50.0)
    BatchedTrees([AFFINE, None]).predict(*features)
    assert (features == 50.0).all()
