"""Identification of the expected tracking error of one joint from recordings of free motion: Sec. IV of the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config import PepperError, UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.tree import Tree, TreeKind
from pepper_driver.observer.tree_fitting import AffineGrowth, fit_cart

MIN_SAMPLES = 500
"""Six seconds: fewer samples cannot show a joint in motion and at rest."""

LEAVES = (16, 32, 64)
SHRINKAGES = (1000.0, 100.0, 10.0)


class FittingError(PepperError, ValueError):
    """The data do not determine what was asked for."""


def nrmse_fit(measured: FloatArray, predicted: FloatArray) -> float:
    """Fit of a prediction [%]: 100 (1 - |y - y_pred| / |y - mean(y)|), the accuracy figure of Sec. IV.

    100 is perfect, 0 is as good as the mean, and a bad prediction is negative. Not the share of variance explained:
    81 % leaves 19 % of the standard deviation.

    Args:
        measured: (n,) y.
        predicted: (n,) in the same unit.

    Raises:
        FittingError: Other shapes, or nothing to explain because ``measured`` is constant.
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

    Samples whose command the safety gate altered, and stale ones, are left out. The size and the shrinkage of an
    affine tree are chosen by cross validation: each recording in turn is predicted by trees fitted on the others.

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
    usable = recording.usable(index)
    return recording.features(index)[usable], recording.tracking_error(index)[usable]


def _joined(runs: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    if not runs:
        return np.empty((0, 3)), np.empty(0)
    return np.concatenate([run[0] for run in runs]), np.concatenate([run[1] for run in runs])


def _choose(runs: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[int, float]:
    """Leaves and shrinkage of the simplest affine tree that is as good as the best (Breiman et al. 1984, 1 SE rule).

    Simpler is fewer leaves first, then stronger shrinkage: what the runs cannot tell apart shall extrapolate safely.
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
    # Runs differ in difficulty: what counts is the spread of the difference to the best choice.
    excess = errors - errors[:, best : best + 1]
    tolerance = excess.std(axis=0, ddof=1) / np.sqrt(len(runs))
    return choices[int(np.argmax(mean - mean[best] <= tolerance))]
