"""Thresholds of all joints, fitted to recordings of free motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.detection.threshold import SPEED_MEMORY
from pepper_driver.observer.fitting.samples import (
    FALLING_TIME,
    extended,
    fit_samples,
    in_working_range,
)
from pepper_driver.observer.fitting.stick_slip import START_UP_TIME
from pepper_driver.observer.fitting.tree import fit_cart
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.model_file import JointModel, predict_recording
from pepper_driver.observer.models.tree import LEAF, CartTree
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.adaptation import HandLoads
from pepper_driver.observer.residuals.fusion import FusionGenerator
from pepper_driver.observer.residuals.momentum import MomentumGenerator
from pepper_driver.observer.running_filters import RunningMaximum

THRESHOLD_FACTOR = 1.25
"""Factor over the largest residual of the recordings: the next motion may have a slightly larger one."""


def free_residual(joint: str, recording: Recording, model: JointModel, window: int) -> FloatArray:
    """Compute the (n,) residual of free motion as the observer does: Eq. 13, median of ``window`` samples [rad].

    It is NaN where the window has a sample that does not count (:func:`fit_samples`), or one before the beginning.
    """
    index = recording.joint_names.index(joint)
    residual = recording.tracking_error(index) - predict_recording(model, joint, recording)
    residual = np.where(fit_samples(recording, index), residual, np.nan)
    filtered = np.full(len(residual), np.nan)
    if len(residual) >= window:
        windows = np.lib.stride_tricks.sliding_window_view(residual, window)
        filtered[window - 1 :] = np.median(windows, axis=1)  # NaN where one of them is
    return filtered


def free_threshold(
    joint: str, recordings: Sequence[Recording], model: JointModel, window: int
) -> float:
    """Return THRESHOLD_FACTOR times the largest residual of a joint in recordings of free motion [rad].

    The recordings must be free of touch. They should be others, and faster ones, than those of the fit.

    Raises:
        ValueError: The recordings have no whole window of usable samples.
    """
    largest = [
        np.fmax.reduce(np.abs(free_residual(joint, r, model, window)), initial=0.0)
        for r in recordings
    ]
    if not max(largest, default=0.0) > 0.0:
        raise ValueError(f"{joint}: no recording holds {window} usable samples in a row")
    return THRESHOLD_FACTOR * float(max(largest))


BOUND_FACTOR = 1.5
"""Factor over the largest residual of the calibration."""

MIN_BOUND = np.radians(0.6)
"""[rad] Smallest threshold: seven steps of the encoder."""

MIN_LEAF_RATIO = 0.75
"""Fraction of the highest leaf that is the least of every leaf: the largest of few samples is no bound."""

LEARNING_TIME = 12.0
"""[s] After which the envelope of a robot is known; until then thresholds are higher in use."""

MOMENTUM_WINDOW = 11
"""Samples of the median of the baseline ``momentum``, as in the paper."""

BOUND_LEAVES = 5
"""Largest number of leaves: each must contain many motions."""


def fit_bounds(
    models: Mapping[str, FusionModel],
    calibration: Sequence[Recording],
    cycle: float,
    *,
    window: int,
    hands: HandLoads | None = None,
) -> dict[str, FusionModel]:
    """Add thresholds to models: BOUND_FACTOR times the largest residual of calibration runs, by phase of the motion.

    The residual is computed as in use: with adaptation, filter, and all joints moving at once. The runs must be free
    motion that no model was fitted to.

    Args:
        models: By joint.
        calibration: Recordings of free whole-body motion.
        cycle: Period of the ticks [s].
        window: Samples of the median.
        hands: Estimate of the loads of the hands, as in use.

    Returns:
        The models with their thresholds, without joints none of whose samples counts: in all of them they fall behind,
        or are in doubt.
    """
    names = calibration[0].joint_names
    ordered = [models.get(name) for name in names]
    residuals, phases = [], []
    for recording in calibration:
        generator = FusionGenerator(ordered, cycle, window=window, adapt=True, hands=hands)
        free, settled = np.ones(len(names), dtype=bool), np.zeros(len(names), dtype=bool)
        rows, doubts = [], []
        for tick in recording.ticks():
            made = generator.step(tick)
            rows.append(made.residual)
            doubts.append(made.doubtful)
            generator.learn(made, free, settled, True)
        residual, doubtful = np.abs(np.array(rows)), np.array(doubts)
        # In use, thresholds are higher until then: the start must not determine the bound.
        residual[: min(round(LEARNING_TIME / cycle), len(residual) // 2)] = np.nan
        for joint in range(len(names)):
            residual[~in_working_range(recording, joint), joint] = np.nan
            residual[extended(doubtful[:, joint], cycle, FALLING_TIME, 0.0), joint] = np.nan
        residuals.append(residual)
        phases.append(motion_phase(recording, cycle))
    momentum_maxima = _momentum_maxima(ordered, calibration, cycle)
    residual, phase = np.concatenate(residuals), np.concatenate(phases)
    result = {}
    for index, name in enumerate(names):
        if name in models:
            seen = np.isfinite(residual[:, index])
            if not seen.any():
                continue
            sizes, phases_seen = residual[seen, index], phase[seen, index]
            result[name] = replace(
                models[name],
                bound=_bound(phases_seen, sizes),
                # A joint without samples has a largest residual of 0 and keeps its bound.
                momentum_bound=float(BOUND_FACTOR * momentum_maxima[index])
                or models[name].momentum_bound,
            )
    return result


def motion_phase(recording: Recording, cycle: float) -> FloatArray:
    """Return what thresholds depend on, (n, N, 3), as :class:`FusionModel` has it.

    It is the desired speed [rad/s], the size of the desired acceleration [rad/s2], and the largest desired speed of the
    last half-second [rad/s].
    """
    speed = np.abs(recording.velocity)
    largest = RunningMaximum(SPEED_MEMORY, cycle, speed.shape[1])
    fastest = np.array([largest.push(row) for row in speed])
    return np.stack((speed, np.abs(recording.acceleration), fastest), axis=2)


def _bound(phase: FloatArray, residual: FloatArray) -> CartTree:
    samples = max(len(residual) // BOUND_LEAVES, 1)
    tree = fit_cart(phase, residual, min_samples_leaf=samples)
    leaf = tree.leaf_of(phase)
    highest = residual.max()
    value = [
        max(MIN_BOUND, BOUND_FACTOR * max(residual[leaf == node].max(), MIN_LEAF_RATIO * highest))
        if feature == LEAF
        else 0.0
        for node, feature in enumerate(tree.feature)
    ]
    return CartTree(
        feature=tree.feature,
        threshold=tree.threshold,
        left=tree.left,
        right=tree.right,
        value=tuple(map(float, value)),
    )


def _momentum_maxima(
    models: list[FusionModel | None], calibration: Sequence[Recording], cycle: float
) -> FloatArray:
    """Return the (n,) largest residual of the baseline ``momentum`` in free motion [rad]."""
    # No threshold: only the residual is used here.
    unbounded = np.full(len(models), np.inf)
    largest = np.zeros(len(models))
    for recording in calibration:
        generator = MomentumGenerator(models, cycle, unbounded, MOMENTUM_WINDOW)
        rows = np.abs([generator.step(tick).residual for tick in recording.ticks()])
        for joint in range(len(models)):
            rows[~in_working_range(recording, joint), joint] = 0.0
        largest = np.fmax(largest, np.fmax.reduce(rows[round(START_UP_TIME / cycle) :]))
    return largest
