"""Regression trees of the expected tracking error, alone and of all joints at once.

The paper cites CART, which is constant in each leaf. Its wording and its results (a better fit on motions that are
faster than those of the identification) indicate a binary tree with affine leaves. Both are implemented.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, Protocol

import numpy as np
from pydantic import ConfigDict

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.loading import STRICT

Triple = tuple[float, float, float]
Coefficients = tuple[float, float, float, float]

TreeKind = Literal["cart", "affine"]

FEATURES = 3

LEAF = -1
"""Feature and children of a leaf, which has none."""


class TreeError(PepperError, ValueError):
    """Arrays that form no valid tree."""


class ExpectedErrorModel(Protocol):
    """Model of the tracking error of one joint in free motion."""

    def predict_one(self, velocity: float, acceleration: float, load_torque: float) -> float:
        """Predict the tracking error [rad] of one sample: [rad/s], [rad/s2], [N m], all desired.

        For use inside a tick: it takes about a microsecond and never raises. If an input is not finite, the result is
        any value.
        """
        ...

    def predict(self, features: FloatArray) -> FloatArray:
        """Predict the (n,) tracking errors [rad] of (n, 3) features, columns as in ``predict_one``."""
        ...


@dataclass(frozen=True, kw_only=True)
class _Partition:
    """Binary tree in flat arrays, one entry per node, the root first and children after their parent.

    A sample goes to the left child where its feature is at most the threshold.

    Attributes:
        feature: 0 velocity, 1 acceleration, 2 load torque; LEAF in a leaf.
        threshold: In the unit of the feature; 0 in a leaf.
        left: Number of a child; LEAF in a leaf.
        right: The same.
    """

    # For reading from files: strict types, no unknown key.
    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    feature: tuple[int, ...]
    threshold: tuple[float, ...]
    left: tuple[int, ...]
    right: tuple[int, ...]

    def __post_init__(self) -> None:
        nodes = len(self.feature)
        if nodes == 0:
            raise TreeError("a tree needs a node")
        self._check_length(nodes, threshold=self.threshold, left=self.left, right=self.right)
        if not np.isfinite(self.threshold).all():
            raise TreeError("a threshold is not finite")
        parents = [0] * nodes
        parents[0] = 1
        for node, feature in enumerate(self.feature):
            children = (self.left[node], self.right[node])
            if feature == LEAF:
                if children != (LEAF, LEAF):
                    raise TreeError(f"leaf {node} has children {children}")
                continue
            if not 0 <= feature < FEATURES:
                raise TreeError(f"node {node} splits on feature {feature}")
            for child in children:
                # Children after their parent: a descent cannot run in a circle.
                if not node < child < nodes:
                    raise TreeError(f"node {node} of {nodes} has child {child}")
                parents[child] += 1
        if parents != [1] * nodes:
            raise TreeError("a node has no parent, or two")

    @staticmethod
    def _check_length(nodes: int, **arrays: tuple[object, ...]) -> None:
        for name, array in arrays.items():
            if len(array) != nodes:
                raise TreeError(f"'{name}' has {len(array)} entries for {nodes} nodes")

    @property
    def leaves(self) -> int:
        """Number of leaves."""
        return self.feature.count(LEAF)

    @cached_property
    def _arrays(self) -> tuple[IntArray, FloatArray, IntArray, IntArray]:
        return (
            np.array(self.feature, dtype=np.int64),
            np.array(self.threshold, dtype=np.float64),
            np.array(self.left, dtype=np.int64),
            np.array(self.right, dtype=np.int64),
        )

    def _leaf(self, sample: Triple) -> int:
        # For one sample, tuples are faster than any NumPy call.
        feature, threshold, left, right = self.feature, self.threshold, self.left, self.right
        node = 0
        while (column := feature[node]) >= 0:
            node = left[node] if sample[column] <= threshold[node] else right[node]
        return node

    def leaf_of(self, features: FloatArray) -> IntArray:
        """Return the (n,) number of the leaf of each row of (n, 3) features."""
        feature, threshold, left, right = self._arrays
        node = np.zeros(len(features), dtype=np.int64)
        inner = np.flatnonzero(feature[node] >= 0)
        while inner.size:
            at = node[inner]
            below = features[inner, feature[at]] <= threshold[at]
            node[inner] = np.where(below, left[at], right[at])
            inner = inner[feature[node[inner]] >= 0]
        return node


@dataclass(frozen=True, kw_only=True)
class CartTree(_Partition):
    """Tree with a constant in each leaf (Breiman et al. 1984).

    Attributes:
        value: One expected tracking error per node [rad]; only those of leaves count.
    """

    value: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_length(len(self.feature), value=self.value)
        if not np.isfinite(self.value).all():
            raise TreeError("a value is not finite")

    def predict_one(self, velocity: float, acceleration: float, load_torque: float) -> float:
        """See :class:`ExpectedErrorModel`."""
        return self.value[self._leaf((velocity, acceleration, load_torque))]

    def predict(self, features: FloatArray) -> FloatArray:
        """See :class:`ExpectedErrorModel`."""
        values: FloatArray = np.array(self.value, dtype=np.float64)[self.leaf_of(features)]
        return values


@dataclass(frozen=True, kw_only=True)
class AffineTree(_Partition):
    """Tree with an affine function in each leaf: eps_exp = c0 + c1 velocity + c2 acceleration + c3 load torque.

    Features are clamped to ``lower`` and ``upper`` first. These lie well outside the motions of the identification:
    affine leaves extrapolate, but only so far.

    Attributes:
        coefficients: (c0, c1, c2, c3) per node: [rad], [s], [s2], [rad/(N m)]; only those of leaves count.
        lower: Smallest features [rad/s], [rad/s2], [N m].
        upper: Largest features.
    """

    coefficients: tuple[Coefficients, ...]
    lower: Triple
    upper: Triple

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_length(len(self.feature), coefficients=self.coefficients)
        if not np.isfinite(self.coefficients).all():
            raise TreeError("a coefficient is not finite")
        if not (np.isfinite(self.lower).all() and np.isfinite(self.upper).all()):
            raise TreeError("a bound is not finite")
        if any(lower > upper for lower, upper in zip(self.lower, self.upper, strict=True)):
            raise TreeError(f"lower bounds {self.lower} above upper bounds {self.upper}")

    def predict_one(self, velocity: float, acceleration: float, load_torque: float) -> float:
        """See :class:`ExpectedErrorModel`."""
        lower, upper = self.lower, self.upper
        # Written out: min and max would cost more than the rest of this function.
        if velocity < lower[0]:
            velocity = lower[0]
        elif velocity > upper[0]:
            velocity = upper[0]
        if acceleration < lower[1]:
            acceleration = lower[1]
        elif acceleration > upper[1]:
            acceleration = upper[1]
        if load_torque < lower[2]:
            load_torque = lower[2]
        elif load_torque > upper[2]:
            load_torque = upper[2]
        c = self.coefficients[self._leaf((velocity, acceleration, load_torque))]
        return c[0] + c[1] * velocity + c[2] * acceleration + c[3] * load_torque

    def predict(self, features: FloatArray) -> FloatArray:
        """See :class:`ExpectedErrorModel`."""
        x = np.clip(features, self.lower, self.upper)
        c = np.array(self.coefficients, dtype=np.float64)[self.leaf_of(x)]
        # The order of the terms of predict_one, for the same bits.
        error: FloatArray = c[:, 0] + c[:, 1] * x[:, 0] + c[:, 2] * x[:, 1] + c[:, 3] * x[:, 2]
        return error


Tree = CartTree | AffineTree

TREE_TYPES: dict[TreeKind, type[CartTree] | type[AffineTree]] = {
    "cart": CartTree,
    "affine": AffineTree,
}


Box = tuple[int, list[float], list[float]]


class BatchedTrees:
    """Several trees evaluated at once, each leaf as the box of features that lead to it.

    Args:
        trees: One per joint, None for those without; all with at most a few dozen leaves.
    """

    def __init__(self, trees: Sequence[Tree | None]) -> None:
        boxes = [[] if tree is None else _boxes(tree) for tree in trees]
        n, width = len(trees), max([1, *map(len, boxes)])
        # No sample lies in the boxes that pad shorter rows: their bounds are infinite.
        self._lower = np.full((FEATURES, n, width), np.inf)
        self._upper = np.full((FEATURES, n, width), np.inf)
        self._lower_clamp = np.full((FEATURES, n), -np.inf)
        self._upper_clamp = np.full((FEATURES, n), np.inf)
        coefficients = np.full((4, n, width), np.nan)
        for row, (tree, of_tree) in enumerate(zip(trees, boxes, strict=True)):
            if isinstance(tree, AffineTree):
                self._lower_clamp[:, row], self._upper_clamp[:, row] = tree.lower, tree.upper
            for column, (leaf, lower, upper) in enumerate(of_tree):
                self._lower[:, row, column], self._upper[:, row, column] = lower, upper
                coefficients[:, row, column] = _coefficients(tree, leaf)
        self._coefficients = coefficients.reshape(4, -1)
        self._first = np.arange(n) * width
        self._affine = any(isinstance(tree, AffineTree) for tree in trees)

    def predict(self, features: FloatArray) -> FloatArray:
        """Return the (n,) values of the trees for (3, n) features, NaN for joints without one.

        For a feature that is not finite the result is any value of the tree, or NaN if the tree is affine.
        """
        if self._affine:
            features = np.minimum(np.maximum(features, self._lower_clamp), self._upper_clamp)
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
    """Return the leaves with their bounds of each feature: (leaf, lower, upper]."""
    found: list[Box] = []
    pending: list[Box] = [(0, [-np.inf] * FEATURES, [np.inf] * FEATURES)]
    while pending:
        node, lower, upper = pending.pop()
        feature, threshold = tree.feature[node], tree.threshold[node]
        if feature == LEAF:
            found.append((node, lower, upper))
            continue
        below, above = list(upper), list(lower)
        below[feature] = min(upper[feature], threshold)
        above[feature] = max(lower[feature], threshold)
        pending += [(tree.left[node], lower, below), (tree.right[node], above, upper)]
    return found


def _coefficients(tree: Tree | None, leaf: int) -> tuple[float, ...]:
    if isinstance(tree, AffineTree):
        return tree.coefficients[leaf]
    assert isinstance(tree, CartTree)
    return (tree.value[leaf], 0.0, 0.0, 0.0)
