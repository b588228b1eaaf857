"""Fitting of regression trees (CART, affine) on velocity, acceleration and load torque to recordings."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pepper_driver.config import PepperError, UnknownNameError
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.observer.fitting.samples import fit_samples
from pepper_driver.observer.models.tree import (
    LEAF,
    AffineTree,
    CartTree,
    Coefficients,
    Tree,
    TreeKind,
    Triple,
)
from pepper_driver.observer.recording import Recording

CART_MIN_SAMPLES_LEAF = 50
"""0.6 s of samples. Smaller leaves fit the estimation runs better and faster runs no better."""

AFFINE_MIN_SAMPLES_LEAF = 100

EXTRAPOLATION = 1.0
"""Range beyond the features of the fit in which an affine tree extrapolates, in widths of their range.

A posture task of four times the stiffness doubles velocities and quadruples accelerations. The range of both is
symmetric, so this margin is three times the largest value of the fit.
"""

_COARSE_THRESHOLDS = 48
_MIN_GAIN = 1e-6  # of the total sum of squares: less is rounding or noise
_SPLIT_RIDGE = 1e-9  # keeps the Gram matrix of a constant feature solvable


def fit_cart(
    features: FloatArray, target: FloatArray, *, min_samples_leaf: int = CART_MIN_SAMPLES_LEAF
) -> CartTree:
    """Fit a regression tree of scikit-learn (CART, squared error); the result is fast on a single sample.

    Args:
        features: (n, 3).
        target: (n,).
        min_samples_leaf: Smallest number of samples in a leaf.
    """
    # Imported for identification only: the import is slow.
    from sklearn.tree import DecisionTreeRegressor

    fitted = DecisionTreeRegressor(min_samples_leaf=min_samples_leaf, random_state=0)
    fitted.fit(features, target)
    tree = fitted.tree_
    is_leaf = tree.children_left < 0
    return CartTree(
        feature=tuple(np.where(is_leaf, LEAF, tree.feature).tolist()),
        threshold=tuple(np.where(is_leaf, 0.0, _for_doubles(tree.threshold)).tolist()),
        left=tuple(tree.children_left.tolist()),
        right=tuple(tree.children_right.tolist()),
        value=tuple(np.where(is_leaf, tree.value[:, 0, 0], 0.0).tolist()),
    )


def _for_doubles(threshold: FloatArray) -> FloatArray:
    """Return thresholds for features in double precision that decide as ``threshold`` for features in single.

    scikit-learn rounds features to single precision first. All doubles up to the middle between two neighbouring
    singles round to the lower one; the middle itself goes to the one with the even last bit.
    """
    below = threshold.astype(np.float32)
    below = np.where(below > threshold, np.nextafter(below, np.float32(-np.inf)), below)
    above = np.nextafter(below, np.float32(np.inf))
    middle = (below.astype(np.float64) + above.astype(np.float64)) / 2
    goes_down = middle.astype(np.float32) == below
    return np.where(goes_down, middle, np.nextafter(middle, -np.inf))


@dataclass(slots=True)
class _Node:
    """Node during the growth; ``order`` is the rank of its split among all, -1 for none."""

    moments: FloatArray
    parent: int
    feature: int = LEAF
    threshold: float = 0.0
    left: int = LEAF
    right: int = LEAF
    order: int = -1


class AffineGrowth:
    """Tree grown on one data set, from which affine trees of any size and shrinkage are cut.

    Each split gives the least squared error when both sides have an affine function of their own. Splits are made in
    the order of their gain, so a smaller tree is the beginning of a larger one.

    Args:
        features: (n, 3).
        target: (n,).
        max_leaves: Largest number of leaves.
        min_samples_leaf: Smallest number of samples in a leaf.
    """

    def __init__(
        self,
        features: FloatArray,
        target: FloatArray,
        *,
        max_leaves: int,
        min_samples_leaf: int = AFFINE_MIN_SAMPLES_LEAF,
    ) -> None:
        self._lower = features.min(axis=0)
        self._upper = features.max(axis=0)
        self._mean = features.mean(axis=0)
        spread = features.std(axis=0)
        # The spread of a constant is rounding, not a scale.
        self._scale = np.where(spread > 1e-9 * np.abs(features).max(axis=0), spread, 1.0)
        self._features = features
        self._min_samples = min_samples_leaf
        # Products of (1, x1, x2, x3, y): sums of these are all that a least-squares fit needs.
        standard = (features - self._mean) / self._scale
        row = np.column_stack((np.ones(len(features)), standard, target))
        self._upper_triangle = np.triu_indices(5)
        self._products = row[:, self._upper_triangle[0]] * row[:, self._upper_triangle[1]]
        self._nodes: list[_Node] = []
        self._grow(max_leaves, float(np.sum((target - target.mean()) ** 2)))
        del self._features, self._products

    def _grow(self, max_leaves: int, total: float) -> None:
        queue: list[tuple[float, int, int, float, IntArray, IntArray]] = []

        def add(rows: IntArray, parent: int) -> int:
            number = len(self._nodes)
            moments = self._products[rows].sum(axis=0)
            self._nodes.append(_Node(moments=moments, parent=parent))
            gain, feature, threshold = self._best_split(rows, moments)
            if gain > _MIN_GAIN * total:
                below = self._features[rows, feature] <= threshold
                entry = (-gain, number, feature, threshold, rows[below], rows[~below])
                heapq.heappush(queue, entry)
            return number

        add(np.arange(len(self._products)), LEAF)
        for order in range(max_leaves - 1):
            if not queue:
                break
            _, number, feature, threshold, below, above = heapq.heappop(queue)
            node = self._nodes[number]
            node.feature, node.threshold, node.order = feature, threshold, order
            node.left = add(below, number)
            node.right = add(above, number)

    def _best_split(self, rows: IntArray, moments: FloatArray) -> tuple[float, int, float]:
        """Return gain in squared error, feature and threshold of the best split; a gain of 0 for none."""
        best = (0.0, 0, 0.0)
        if len(rows) < 2 * self._min_samples:
            return best
        error = float(self._squared_error(moments[None])[0])
        for feature in range(self._features.shape[1]):
            values = self._features[rows, feature]
            order = np.argsort(values, kind="stable")
            values = values[order]
            # A split after position p leaves p + 1 samples on the left.
            places = np.flatnonzero(values[1:] > values[:-1])
            places = places[
                (places + 1 >= self._min_samples) & (places + 1 <= len(rows) - self._min_samples)
            ]
            if not len(places):
                continue
            sums = np.cumsum(self._products[rows[order]], axis=0)

            def gains(at: IntArray, sums: FloatArray = sums) -> FloatArray:
                left = sums[at]
                return error - self._squared_error(left) - self._squared_error(moments - left)

            # First a few thresholds over the whole range, then all near the best of them.
            count = min(_COARSE_THRESHOLDS, len(places))
            coarse = np.linspace(0, len(places) - 1, count).astype(np.int64)
            peak = int(np.argmax(gains(places[coarse])))
            first, last = coarse[max(peak - 1, 0)], coarse[min(peak + 1, count - 1)]
            near = places[first : last + 1]
            gain = gains(near)
            peak = int(np.argmax(gain))
            if gain[peak] > best[0]:
                low, high = values[near[peak]], values[near[peak] + 1]
                middle = low + (high - low) / 2
                # Rounding must not put the upper neighbour on the left.
                best = (float(gain[peak]), feature, float(middle if middle < high else low))
        return best

    def _normal_equations(self, moments: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (m, 4, 4) Gram matrices, (m, 4) right-hand sides, (m,) sums of squares of (m, 15) moments."""
        square = np.empty((len(moments), 5, 5))
        rows, columns = self._upper_triangle
        square[:, rows, columns] = moments
        square[:, columns, rows] = moments
        return square[:, :4, :4], square[:, :4, 4], square[:, 4, 4]

    def _squared_error(self, moments: FloatArray) -> FloatArray:
        """Return the (m,) squared errors of affine least squares."""
        gram, right, square = self._normal_equations(moments)
        gram = gram + _SPLIT_RIDGE * gram[:, :1, :1] * np.eye(4)
        solution = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
        # For this ridge solution, y'y - b's is the least-squares error to second order.
        error: FloatArray = square - np.einsum("ij,ij->i", right, solution)
        return error

    def cut(self, leaves: int, shrinkage: float) -> AffineTree:
        """Return the tree of at most ``leaves`` leaves.

        Args:
            leaves: Number of leaves; fewer if the data gave no more.
            shrinkage: Weight, in samples, with which each node is drawn to the function of its parent, the root to
                zero slopes. A leaf with few samples, or with little range in one feature, inherits that of its parent.
        """
        coefficients = self._shrunk(shrinkage)
        kept = [0]
        numbers: dict[int, int] = {}
        position = 0
        while position < len(kept):
            number = kept[position]
            numbers[number] = position
            node = self._nodes[number]
            if 0 <= node.order < leaves - 1:
                kept += [node.left, node.right]
            position += 1
        nodes = [self._nodes[number] for number in kept]
        split = [node.left in numbers for node in nodes]
        margin = EXTRAPOLATION * (self._upper - self._lower)
        return AffineTree(
            feature=tuple(n.feature if s else LEAF for n, s in zip(nodes, split, strict=True)),
            threshold=tuple(n.threshold if s else 0.0 for n, s in zip(nodes, split, strict=True)),
            left=tuple(numbers.get(node.left, LEAF) for node in nodes),
            right=tuple(numbers.get(node.right, LEAF) for node in nodes),
            coefficients=tuple(self._in_units(coefficients[number]) for number in kept),
            lower=_triple(self._lower - margin),
            upper=_triple(self._upper + margin),
        )

    def _shrunk(self, shrinkage: float) -> FloatArray:
        """Return (nodes, 4) coefficients on standardised features, parents before children."""
        gram, right, _ = self._normal_equations(np.array([node.moments for node in self._nodes]))
        coefficients = np.zeros((len(self._nodes), 4))
        for number, node in enumerate(self._nodes):
            samples = gram[number, 0, 0]
            mean = gram[number, 0, 1:] / samples
            around_mean = gram[number, 1:, 1:] - samples * np.outer(mean, mean)
            if node.parent == LEAF:
                start = np.array([right[number, 0] / samples, 0.0, 0.0, 0.0])
            else:
                start = coefficients[node.parent]
            # Fit of what the parent does not explain: its mean, and its slopes around the mean.
            left_over = right[number] - gram[number] @ start
            slopes = np.linalg.solve(
                around_mean + (shrinkage + _SPLIT_RIDGE * samples) * np.eye(3),
                left_over[1:] - mean * left_over[0],
            )
            level = left_over[0] / (samples + shrinkage)
            coefficients[number, 0] = start[0] + level - mean @ slopes
            coefficients[number, 1:] = start[1:] + slopes
        return coefficients

    def _in_units(self, coefficients: FloatArray) -> Coefficients:
        """Return the coefficients of features in their own units."""
        slopes = coefficients[1:] / self._scale
        constant = coefficients[0] - float(np.sum(slopes * self._mean))
        return (float(constant), *_triple(slopes))


def _triple(values: FloatArray) -> Triple:
    return (float(values[0]), float(values[1]), float(values[2]))


def fit_affine(
    features: FloatArray,
    target: FloatArray,
    *,
    leaves: int,
    shrinkage: float,
    min_samples_leaf: int = AFFINE_MIN_SAMPLES_LEAF,
) -> AffineTree:
    """Fit a tree with affine leaves; see :class:`AffineGrowth` for the method and the arguments."""
    growth = AffineGrowth(features, target, max_leaves=leaves, min_samples_leaf=min_samples_leaf)
    return growth.cut(leaves, shrinkage)


MIN_SAMPLES = 500
"""Six seconds: fewer samples do not contain a joint in motion and at rest."""

LEAVES = (16, 32, 64)
SHRINKAGES = (1000.0, 100.0, 10.0)


class FittingError(PepperError, ValueError):
    """Data that do not determine the model."""


F = TypeVar("F", bound=float | None)


@dataclass(frozen=True, kw_only=True)
class FitScore(Generic[F]):
    """Quality with which a model predicts the tracking error of a joint, by :func:`nrmse_fit` [%].

    Attributes:
        estimation: Mean over the runs that the model was estimated from.
        test: Value of the test runs.
    """

    estimation: F
    test: F


def nrmse_fit(measured: FloatArray, predicted: FloatArray) -> float:
    """Return the NRMSE fit of a prediction [%]: 100 (1 - |y - y_pred| / |y - mean(y)|), as in Sec. IV.

    100 is perfect, 0 is as good as the mean, and a bad prediction is negative. It is not the fraction of explained
    variance: at 81 %, 19 % of the standard deviation remain.

    Args:
        measured: (n,) y.
        predicted: (n,) in the same unit.

    Raises:
        FittingError: Other shapes, or a ``measured`` that is constant.
    """
    if measured.ndim != 1 or measured.shape != predicted.shape or not len(measured):
        raise FittingError(
            f"a fit compares two equally long signals, got shapes {measured.shape} and {predicted.shape}"
        )
    spread = float(np.linalg.norm(measured - measured.mean()))
    if spread == 0.0:
        raise FittingError("the measured signal is constant: a fit has no meaning")
    return 100.0 * (1.0 - float(np.linalg.norm(measured - predicted)) / spread)


def fit_joint(joint: str, recordings: Sequence[Recording], kind: TreeKind) -> Tree:
    """Identify the expected tracking error of one joint.

    Samples whose command the safety gate altered, stale ones, and those of a joint that falls behind are left out. The
    size and the shrinkage of an affine tree are chosen by cross validation: each recording in turn is predicted by
    trees fitted on the others.

    Args:
        joint: Name of the joint.
        recordings: Runs of free motion, of different speed.
        kind: ``cart`` for constant leaves, ``affine`` for affine ones.

    Raises:
        FittingError: Too few samples, or a joint that does not move.
        UnknownNameError: No such joint in a recording.
    """
    runs = [_usable_samples(joint, recording) for recording in recordings]
    runs = [run for run in runs if len(run[1])]
    features, target = _joined(runs)
    if len(target) < MIN_SAMPLES:
        raise FittingError(
            f"{joint}: {len(target)} usable samples in {len(recordings)} recordings, "
            f"at least {MIN_SAMPLES} are needed"
        )
    if np.ptp(features[:, 0]) == 0.0:
        raise FittingError(f"{joint}: the joint does not move in these recordings")
    if kind == "cart":
        return fit_cart(features, target)
    leaves, shrinkage = _choose(runs)
    return AffineGrowth(features, target, max_leaves=leaves).cut(leaves, shrinkage)


def _usable_samples(joint: str, recording: Recording) -> tuple[FloatArray, FloatArray]:
    if joint not in recording.joint_names:
        raise UnknownNameError("joint", joint, recording.joint_names)
    index = recording.joint_names.index(joint)
    usable = fit_samples(recording, index)
    return recording.features(index)[usable], recording.tracking_error(index)[usable]


def _joined(runs: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    if not runs:
        return np.empty((0, 3)), np.empty(0)
    return np.concatenate([run[0] for run in runs]), np.concatenate([run[1] for run in runs])


def _choose(runs: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[int, float]:
    """Choose leaves and shrinkage of the simplest affine tree as good as the best (Breiman et al. 1984, 1 SE rule).

    Simpler means fewer leaves, then stronger shrinkage: of equally good trees the simplest extrapolates best.
    """
    choices = [(leaves, shrinkage) for leaves in LEAVES for shrinkage in SHRINKAGES]
    if len(runs) < 3:
        return choices[0]
    errors = np.empty((len(runs), len(choices)))
    for number, (features, target) in enumerate(runs):
        others = _joined([*runs[:number], *runs[number + 1 :]])
        growth = AffineGrowth(*others, max_leaves=LEAVES[-1])
        spread = float(np.std(target)) or 1.0
        for column, (leaves, shrinkage) in enumerate(choices):
            residual = target - growth.cut(leaves, shrinkage).predict(features)
            errors[number, column] = np.sqrt(np.mean(residual**2)) / spread
    mean = errors.mean(axis=0)
    best = int(np.argmin(mean))
    # Runs differ in difficulty, so the spread of the difference to the best choice counts.
    excess = errors - errors[:, best : best + 1]
    tolerance = excess.std(axis=0, ddof=1) / np.sqrt(len(runs))
    return choices[int(np.argmax(mean - mean[best] <= tolerance))]
