"""Regression trees of the expected tracking error, alone and of all joints at once.

The paper cites CART, which is constant in each leaf. Its wording and its results (a better fit on motions that are
faster than those of the identification) indicate a binary tree with affine leaves. Both are implemented.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, Protocol

import numpy as np
from pydantic import ConfigDict

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records, record_type
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

    def predict(self, features: FloatArray) -> FloatArray:
        """Predict the (n,) tracking errors [rad] of (n, 3) features: [rad/s], [rad/s2], [N m], all desired."""
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

    def predict(self, features: FloatArray) -> FloatArray:
        """See :class:`ExpectedErrorModel`."""
        x = np.clip(features, self.lower, self.upper)
        c = np.array(self.coefficients, dtype=np.float64)[self.leaf_of(x)]
        # The order of the terms of `evaluate_tree`, for the same bits.
        error: FloatArray = c[:, 0] + c[:, 1] * x[:, 0] + c[:, 2] * x[:, 1] + c[:, 3] * x[:, 2]
        return error


Tree = CartTree | AffineTree

TREE_TYPES: dict[TreeKind, type[CartTree] | type[AffineTree]] = {
    "cart": CartTree,
    "affine": AffineTree,
}


class TreeNode:
    """Node of a tree: a leaf where ``feature`` is LEAF.

    Attributes:
        feature: Number of the feature.
        threshold: A sample goes to the left child where its feature is at most this.
        left: Number of a child.
        right: The same.
        c0: Value of a leaf, c0 + c1 x1 + c2 x2 + c3 x3 in the features.
        c1: Coefficient of the first feature, and so on.
    """

    feature: int
    threshold: float
    left: int
    right: int
    c0: float
    c1: float
    c2: float
    c3: float


class TreeRoot:
    """Tree of one joint.

    Attributes:
        node: Number of its first node; LEAF for a joint without a tree.
        affine: True if its leaves are affine functions, False if constants.
        lower1: Bound to which the first feature is clamped, and so on.
        upper1: The same.
    """

    node: int
    affine: bool
    lower1: float
    lower2: float
    lower3: float
    upper1: float
    upper2: float
    upper3: float


@kernel
def clamp(value: float, lower: float, upper: float) -> float:
    """Return a value within its bounds; NaN stays NaN."""
    if value < lower:
        return lower
    if value > upper:
        return upper
    return value


@kernel
def evaluate_tree(
    roots: Records[TreeRoot], nodes: Records[TreeNode], j: int, x1: float, x2: float, x3: float
) -> float:
    """Return the value of the tree ``j`` for three features, NaN if there is none.

    If a feature is not finite, the result is any value of the tree, or NaN if the tree is affine.
    """
    root = roots[j]
    if root.node < 0:
        return np.nan
    x = (
        clamp(x1, root.lower1, root.upper1),
        clamp(x2, root.lower2, root.upper2),
        clamp(x3, root.lower3, root.upper3),
    )
    node = nodes[root.node]
    while node.feature >= 0:
        node = nodes[node.left if x[node.feature] <= node.threshold else node.right]
    if not root.affine:
        return node.c0
    return node.c0 + node.c1 * x[0] + node.c2 * x[1] + node.c3 * x[2]


@kernel
def _evaluate(
    roots: Records[TreeRoot],
    nodes: Records[TreeNode],
    x1: FloatArray,
    x2: FloatArray,
    x3: FloatArray,
    values: Out[FloatArray],
) -> None:
    for j in range(len(values)):
        values[j] = evaluate_tree(roots, nodes, j, x1[j], x2[j], x3[j])


class BatchedTrees:
    """Several trees evaluated at once.

    Args:
        trees: One per joint, None for those without.

    Attributes:
        roots: Of each joint, for :func:`evaluate_tree`.
        nodes: Of all trees.
    """

    def __init__(self, trees: Sequence[Tree | None]) -> None:
        self.roots = make_records(
            TreeRoot,
            len(trees),
            node=_first_nodes(trees),
            affine=[isinstance(tree, AffineTree) for tree in trees],
        )
        for bound, sign in (("lower", -1.0), ("upper", 1.0)):
            of_trees = [getattr(tree, bound, (sign * math.inf,) * FEATURES) for tree in trees]
            for feature, column in enumerate(np.array(of_trees).reshape(-1, FEATURES).T, 1):
                self.roots[f"{bound}{feature}"] = column
        self.nodes = _nodes([tree for tree in trees if tree is not None])
        self._evaluate = _evaluate.load()

    def predict(self, first: FloatArray, second: FloatArray, third: FloatArray) -> FloatArray:
        """Return the (n,) values of the trees for (n,) features, a new array, NaN for joints without one.

        For a feature that is not finite the result is any value of the tree, or NaN if the tree is affine.
        """
        values = np.empty(len(self.roots))
        self._evaluate(self.roots, self.nodes, first, second, third, values)
        return values


def _first_nodes(trees: Sequence[Tree | None]) -> list[int]:
    """Return the number of the first node of each tree, LEAF without one."""
    first, count = [], 0
    for tree in trees:
        first.append(LEAF if tree is None else count)
        count += 0 if tree is None else len(tree.feature)
    return first


def _nodes(trees: Sequence[Tree]) -> Records[TreeNode]:
    """Return the nodes of trees, one tree after the other."""
    rows: list[tuple[int | float, ...]] = []
    for tree in trees:
        first = len(rows)
        for node, feature in enumerate(tree.feature):
            children = (tree.left[node], tree.right[node])
            links = (child if feature == LEAF else first + child for child in children)
            rows.append((feature, tree.threshold[node], *links, *_coefficients(tree, node)))
    columns = zip(record_type(TreeNode).names or (), zip(*rows, strict=True), strict=False)
    return make_records(TreeNode, len(rows), **dict(columns))


def _coefficients(tree: Tree, node: int) -> Coefficients:
    if isinstance(tree, AffineTree):
        return tree.coefficients[node]
    return (tree.value[node], 0.0, 0.0, 0.0)
