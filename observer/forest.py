"""The trees of all joints at once: a walk of each by itself costs more than everything else that an observer does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.tree import FEATURES, LEAF, AffineTree, CartTree, Tree

Box = tuple[int, list[float], list[float]]


class Forest:
    """Several trees side by side, each leaf as the box of features that lead to it.

    Args:
        trees: One a joint, None for those without; all with at most a few dozen leaves.
    """

    def __init__(self, trees: Sequence[Tree | None]) -> None:
        boxes = [[] if tree is None else _boxes(tree) for tree in trees]
        n, width = len(trees), max([1, *map(len, boxes)])
        # No sample lies in a box that is not there.
        self._lower = np.full((FEATURES, n, width), np.inf)
        self._upper = np.full((FEATURES, n, width), np.inf)
        self._least = np.full((FEATURES, n), -np.inf)
        self._most = np.full((FEATURES, n), np.inf)
        coefficients = np.full((4, n, width), np.nan)
        for row, (tree, of_tree) in enumerate(zip(trees, boxes, strict=True)):
            if isinstance(tree, AffineTree):
                self._least[:, row], self._most[:, row] = tree.lower, tree.upper
            for column, (leaf, lower, upper) in enumerate(of_tree):
                self._lower[:, row, column], self._upper[:, row, column] = lower, upper
                coefficients[:, row, column] = _coefficients(tree, leaf)
        self._coefficients = coefficients.reshape(4, -1)
        self._first = np.arange(n) * width
        self._affine = any(isinstance(tree, AffineTree) for tree in trees)

    def predict(self, features: FloatArray) -> FloatArray:
        """(n,) values of the trees for (3, n) features, NaN for joints without one.

        A feature that is not finite gives any value of its tree, and NaN if that is affine.
        """
        if self._affine:
            features = np.minimum(np.maximum(features, self._least), self._most)
        sample = features[:, :, None]
        inside = ((sample > self._lower) & (sample <= self._upper)).all(axis=0)
        leaf = inside.argmax(axis=1) + self._first
        if not self._affine:
            values: FloatArray = self._coefficients[0].take(leaf)
            return values
        c = self._coefficients.take(leaf, axis=1)
        # The order of the terms of AffineTree, for the same bits.
        values = c[0] + c[1] * features[0] + c[2] * features[1] + c[3] * features[2]
        return values


def _boxes(tree: Tree) -> list[Box]:
    """Leaves with what lies below and above them of each feature: (leaf, lower, upper]."""
    found: list[Box] = []
    ahead: list[Box] = [(0, [-np.inf] * FEATURES, [np.inf] * FEATURES)]
    while ahead:
        node, lower, upper = ahead.pop()
        feature, threshold = tree.feature[node], tree.threshold[node]
        if feature == LEAF:
            found.append((node, lower, upper))
            continue
        below, above = list(upper), list(lower)
        below[feature] = min(upper[feature], threshold)
        above[feature] = max(lower[feature], threshold)
        ahead += [(tree.left[node], lower, below), (tree.right[node], above, upper)]
    return found


def _coefficients(tree: Tree | None, leaf: int) -> tuple[float, ...]:
    if isinstance(tree, AffineTree):
        return tree.coefficients[leaf]
    assert isinstance(tree, CartTree)
    return (tree.value[leaf], 0.0, 0.0, 0.0)
