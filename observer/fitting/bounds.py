"""Thresholds of all joints, fitted to recordings of free motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.observer.constants import MIN_SPREAD
from pepper_driver.observer.detection.threshold import (
    BREAKAWAY,
    MIN_SAMPLES,
    REST,
    SLIDING,
    SPREAD_QUANTILE,
)
from pepper_driver.observer.fitting.samples import (
    fit_samples,
    in_working_range,
)
from pepper_driver.observer.fitting.stick_slip import START_UP_TIME
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.model_file import JointModel, predict_recording
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.fusion import FusionGenerator
from pepper_driver.observer.residuals.momentum import MomentumGenerator

THRESHOLD_FACTOR = 1.25
"""Factor over the largest residual of the recordings: the next motion may have a slightly larger one."""


def free_residual(joint: str, recording: Recording, model: JointModel, window: int) -> FloatArray:
    """Compute the (n,) residual of free motion as the observer does: Eq. 13, median of ``window`` samples [rad].

    It is NaN where the window has a sample that does not count (:func:`fit_samples`), or one before the beginning.
    """
    index = recording.joint_names.index(joint)
    counts = fit_samples(recording, index)
    if isinstance(model, FusionModel):
        models = [model if name == joint else None for name in recording.joint_names]
        return np.where(counts, _play(models, recording, window)[0][:, index], np.nan)
    residual = recording.tracking_error(index) - predict_recording(model, joint, recording)
    residual = np.where(counts, residual, np.nan)
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


MOMENTUM_FACTOR = 1.5
"""Factor over the largest residual of the calibration, of the baseline ``momentum``."""

MOMENTUM_WINDOW = 11
"""Samples of the median of the baseline ``momentum``, as in the paper."""


def fit_spreads(
    models: Mapping[str, FusionModel],
    calibration: Sequence[Recording],
    *,
    window: int,
) -> dict[str, FusionModel]:
    """Add to models the spread of their residuals in calibration runs, by phase of the motion.

    The residual is computed as in use: with filter, and all joints moving at once. The runs must be free motion that no
    model was fitted to.

    Args:
        models: By joint.
        calibration: Recordings of free whole-body motion.
        window: Samples of the median.

    Returns:
        The models with their spreads, without joints hardly any of whose samples count: in the others they fall behind.
    """
    names, cycle = calibration[0].joint_names, calibration[0].cycle
    ordered = [models.get(name) for name in names]
    residuals, phases = [], []
    for recording in calibration:
        played, phase = _play(ordered, recording, window)
        residual = np.abs(played)
        residual[: round(START_UP_TIME / cycle)] = np.nan
        for joint in range(len(names)):
            residual[~in_working_range(recording, joint), joint] = np.nan
        residuals.append(residual)
        phases.append(phase)
    momentum_maxima = _momentum_maxima(ordered, calibration, cycle)
    residual, phase = np.concatenate(residuals), np.concatenate(phases)
    result = {}
    for index, name in enumerate(names):
        if name not in models:
            continue
        spread = _spread(residual[:, index], phase[:, index])
        if spread is not None:
            result[name] = replace(
                models[name],
                spread=spread,
                # A joint without samples has a largest residual of 0 and keeps its bound.
                momentum_bound=float(MOMENTUM_FACTOR * momentum_maxima[index])
                or models[name].momentum_bound,
            )
    return result


def _play(
    models: Sequence[FusionModel | None], recording: Recording, window: int
) -> tuple[FloatArray, IntArray]:
    """Return the (n, N) residuals of a run as in use [rad], and the (n, N) phases of the joints."""
    count = len(models)
    generator = FusionGenerator(
        models, recording.cycle, window=window, false_contacts=1.0, adapt=False
    )
    free, settled = np.ones(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    residuals, phases = [], []
    for tick in recording.ticks():
        made = generator.step(tick)
        residuals.append(made.residual)
        phases.append(generator.phase.copy())
        generator.learn(free, settled, True)
    return np.array(residuals), np.array(phases)


def _spread(residual: FloatArray, phase: IntArray) -> tuple[float, float, float] | None:
    """Return the spread by phase [rad]; None where hardly any sample counts."""
    seen = np.isfinite(residual)
    if np.count_nonzero(seen) < MIN_SAMPLES:
        return None
    phases = [residual[seen & (phase == number)] for number in (REST, BREAKAWAY, SLIDING)]
    shown = [sizes for sizes in phases if len(sizes) >= MIN_SAMPLES] or [residual[seen]]
    # A phase that a joint hardly shows has the largest spread of the others.
    largest = max(map(_quantile, shown))
    at_rest, breaking_away, sliding = (
        _quantile(sizes) if len(sizes) >= MIN_SAMPLES else largest for sizes in phases
    )
    return at_rest, breaking_away, sliding


def _quantile(sizes: FloatArray) -> float:
    return float(max(np.quantile(sizes, SPREAD_QUANTILE), MIN_SPREAD))


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
