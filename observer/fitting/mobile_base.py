"""Fitting of the response of the base to its wheel commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.observer.constants import CORRECTION_TIME
from pepper_driver.observer.detection.threshold import MIN_SAMPLES, SPREAD_QUANTILE
from pepper_driver.observer.models.fusion_model import (
    OUTPUTS,
    TAPS,
    UNSEEN_SPREAD,
    BaseModel,
    Six,
)
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.mobile_base import (
    MIN_SPREADS,
    BaseGenerator,
    leg_indices,
)

RIDGE_RATIO = 1e-3
"""Relative to the mean square of the inputs."""


def fit_base(robot: RobotConfig, recordings: Sequence[Recording], *, window: int) -> BaseModel:
    """Identify the response on every second recording, and the spread of the residuals on all of them.

    Args:
        robot: Its description.
        recordings: Two or more of free whole-body motion with a moving base.
        window: Samples of the median.
    """
    fitted = recordings[::2]
    wheels = _solve([_regression(robot, recording) for recording in fitted])
    inertial = np.zeros((len(wheels), 3))
    if shown := [recording for recording in fitted if _shows_inertia(recording)]:
        inertial = _solve([_inertial_regression(robot, recording) for recording in shown])
    model = BaseModel(
        coefficients=tuple(_six(row) for row in np.hstack((wheels, inertial))),
        still=_six(MIN_SPREADS),
        moving=_six(MIN_SPREADS),
        shaking=_six(MIN_SPREADS),
        driving=_six(MIN_SPREADS),
    )
    residuals: list[FloatArray] = []
    phases: list[int] = []
    for recording in recordings:
        generator = BaseGenerator(model, robot, window, false_contacts=1.0, adapt=False)
        for tick in recording.ticks():
            if math.isfinite(generator.step(tick, late=False)[1]):
                residuals.append(np.where(generator.seen, generator.filtered, np.nan))
                phases.append(generator.phase)
    spreads = _spreads(np.abs(residuals), np.array(phases))
    still, moving, shaking, driving = map(_six, spreads)
    return replace(model, still=still, moving=moving, shaking=shaking, driving=driving)


def _spreads(sizes: FloatArray, phase: IntArray) -> FloatArray:
    """Return the (4, 6) spreads by phase of (n, 6) sizes of residuals, NaN where an output was not measured."""
    table = np.full((4, len(OUTPUTS)), np.nan)
    for output in range(len(OUTPUTS)):
        seen = np.isfinite(sizes[:, output])
        for number in range(4):
            found = sizes[seen & (phase == number), output]
            if len(found) >= MIN_SAMPLES:
                table[number, output] = np.quantile(found, SPREAD_QUANTILE)
        if np.isnan(table[:, output]).all():
            table[:, output] = (
                np.quantile(sizes[seen, output], SPREAD_QUANTILE) if seen.any() else UNSEEN_SPREAD
            )
    # A phase that was not seen is as rough as the one before; before the first one that was seen, as that one.
    spreads = np.fmax.accumulate(table)
    for number in (2, 1, 0):
        spreads[number] = np.where(np.isnan(spreads[number]), spreads[number + 1], spreads[number])
    floored: FloatArray = np.maximum(spreads, MIN_SPREADS)
    return floored


def _solve(parts: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Return the coefficients (inputs, outputs) of a ridge regression of runs: inputs and outputs of their ticks."""
    rows, targets = zip(*parts, strict=True)
    x, y = np.concatenate(rows), np.concatenate(targets)
    gram = x.T @ x
    gram += RIDGE_RATIO * np.mean(np.diag(gram)) * np.eye(len(gram))
    coefficients: FloatArray = np.linalg.solve(gram, x.T @ y)
    return coefficients


def _regression(robot: RobotConfig, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return the (n, inputs) inputs of each tick and the TAPS - 1 before it; (n, 3) twist by the wheels."""
    inverse = np.asarray(robot.wheels.inverse)
    sent = recording.sent_wheel_speed @ inverse.T
    load = recording.load_torque[:, leg_indices(robot)]
    inputs = np.hstack((sent, load))
    windows = np.lib.stride_tricks.sliding_window_view(inputs, TAPS, axis=0)[:, :, ::-1]
    known = windows.transpose(0, 2, 1).copy()
    # Change of the load over the response: accelerations of the limbs move the base, their weight does not.
    known[:, :, 3:] -= known[:, -1:, 3:]
    twist = recording.wheel_speed[TAPS - 1 :] @ inverse.T
    return known.reshape(len(known), -1), twist


def _inertial(recording: Recording) -> FloatArray:
    """Return the (n, 3) yaw rate and horizontal acceleration of a recording."""
    return np.column_stack((recording.angular_velocity[:, 2], recording.linear_acceleration[:, :2]))


def _shows_inertia(recording: Recording) -> bool:
    """Return True for a recording with an inertial unit that works."""
    return bool(np.ptp(_inertial(recording), axis=0).any())


def _inertial_regression(robot: RobotConfig, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return inputs as :func:`_regression`, and the (n, 3) outputs of the inertial unit; both without their level."""
    known, _ = _regression(robot, recording)
    cycle = robot.cycle
    return _without_level(known, cycle), _without_level(_inertial(recording)[TAPS - 1 :], cycle)


def _without_level(values: FloatArray, cycle: float) -> FloatArray:
    """Return (n, m) signals without their slow part, as in use."""
    from scipy.signal import lfilter  # slow to import, and needed here alone

    changes: FloatArray = lfilter(
        [1.0, -1.0], [1.0, cycle / CORRECTION_TIME - 1.0], values - values[0], axis=0
    )
    return changes


def _six(values: FloatArray) -> Six:
    a, b, c, d, e, f = map(float, values)
    return a, b, c, d, e, f
