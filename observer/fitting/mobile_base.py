"""Fitting of the response of the base to its wheel commands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel, Triple
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.mobile_base import STANDSTILL_SPEED, leg_indices

RIDGE_RATIO = 1e-3
"""Relative to the mean square of the inputs."""

BASE_BOUND_FACTOR = 2.6
"""Factor over the largest residual of the calibration."""


def fit_base(robot: RobotConfig, recordings: Sequence[Recording], *, window: int) -> BaseModel:
    """Identify the response on every second recording, and the bounds on all of them.

    Args:
        robot: Its description.
        recordings: Two or more of free whole-body motion with a moving base.
        window: Samples of the median.
    """
    fitted = [_regression(robot, recording) for recording in recordings[::2]]
    rows, targets = zip(*fitted, strict=True)
    x, y = np.concatenate(rows), np.concatenate(targets)
    gram = x.T @ x
    gram += RIDGE_RATIO * np.mean(np.diag(gram)) * np.eye(len(gram))
    coefficients = np.linalg.solve(gram, x.T @ y)
    # Above 0 in any case: a bound of 0 is invalid.
    largest = {True: np.full(3, 1e-6), False: np.full(3, 1e-6)}
    for recording in recordings:
        known, twist = _regression(robot, recording)
        error = known @ coefficients - twist
        median = np.median(np.lib.stride_tricks.sliding_window_view(error, window, axis=0), axis=-1)
        sent = np.abs(known.reshape(len(known), TAPS, -1)[:, :, :3]).max(axis=(1, 2))
        stands = sent[window - 1 :] < STANDSTILL_SPEED
        for case in (True, False):
            seen = np.abs(median[stands == case])
            if len(seen):
                largest[case] = np.maximum(largest[case], seen.max(axis=0))
    # The bound for driving also applies shortly afterwards, when the base stands.
    driving = np.maximum(largest[False], largest[True])
    return BaseModel(
        coefficients=tuple((float(a), float(b), float(c)) for a, b, c in coefficients),
        standing=_triple(BASE_BOUND_FACTOR * largest[True]),
        driving=_triple(BASE_BOUND_FACTOR * driving),
    )


def _regression(robot: RobotConfig, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return the (n, inputs) inputs of each tick and the TAPS - 1 before it; (n, 3) measured twist."""
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


def _triple(values: FloatArray) -> Triple:
    a, b, c = map(float, values)
    return a, b, c
