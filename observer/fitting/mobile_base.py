"""Fitting of the response of the base to its wheel commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.detection.threshold import MIN_SAMPLES, SPREAD_QUANTILE
from pepper_driver.observer.models.fusion_model import OUTPUTS, TAPS, BaseModel, Six
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.mobile_base import (
    LEVEL_TIME,
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
    fitted = [_regression(robot, recording) for recording in recordings[::2]]
    rows, targets = zip(*fitted, strict=True)
    x, y = np.concatenate(rows), np.concatenate(targets)
    gram = x.T @ x
    gram += RIDGE_RATIO * np.mean(np.diag(gram)) * np.eye(len(gram))
    coefficients = np.linalg.solve(gram, x.T @ y)
    model = BaseModel(
        coefficients=tuple(_six(row) for row in coefficients),
        still=_six(MIN_SPREADS),
        moving=_six(MIN_SPREADS),
        driving=_six(MIN_SPREADS),
    )
    residuals: list[FloatArray] = []
    phases: list[int] = []
    for recording in recordings:
        generator = BaseGenerator(model, robot, window, false_contacts=1.0, adapt=False)
        for tick in recording.ticks():
            if math.isfinite(generator.step(tick, late=False)[1]):
                residuals.append(generator.filtered)
                phases.append(generator.phase)
    sizes, phase = np.abs(residuals), np.array(phases)
    spreads = [
        np.quantile(sizes[phase == number], SPREAD_QUANTILE, axis=0)
        if np.count_nonzero(phase == number) >= MIN_SAMPLES
        else np.zeros(len(OUTPUTS))
        for number in range(3)
    ]
    # What was not seen is at least as rough as what is quieter.
    still, moving, driving = np.maximum.accumulate(spreads)
    return replace(
        model,
        still=_six(np.maximum(still, MIN_SPREADS)),
        moving=_six(np.maximum(moving, MIN_SPREADS)),
        driving=_six(np.maximum(driving, MIN_SPREADS)),
    )


def _regression(robot: RobotConfig, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Return the (n, inputs) inputs of each tick and the TAPS - 1 before it; (n, 6) measured outputs."""
    inverse = np.asarray(robot.wheels.inverse)
    sent = recording.sent_wheel_speed @ inverse.T
    load = recording.load_torque[:, leg_indices(robot)]
    inputs = np.hstack((sent, load))
    windows = np.lib.stride_tricks.sliding_window_view(inputs, TAPS, axis=0)[:, :, ::-1]
    known = windows.transpose(0, 2, 1).copy()
    # Change of the load over the response: accelerations of the limbs move the base, their weight does not.
    known[:, :, 3:] -= known[:, -1:, 3:]
    inertial = np.column_stack(
        (recording.angular_velocity[:, 2], recording.linear_acceleration[:, :2])
    )
    inertial = np.where(np.isfinite(inertial), inertial, 0.0)
    outputs = np.hstack((recording.wheel_speed @ inverse.T, _without_level(inertial, robot.cycle)))
    return known.reshape(len(known), -1), outputs[TAPS - 1 :]


def _without_level(inertial: FloatArray, cycle: float) -> FloatArray:
    """Return (n, 3) measurements of the inertial unit without their slow part, as in use."""
    level, pace, changes = inertial[0].copy(), cycle / LEVEL_TIME, np.empty_like(inertial)
    for k, row in enumerate(inertial):
        changes[k] = row - level
        level += pace * changes[k]
    return changes


def _six(values: FloatArray) -> Six:
    a, b, c, d, e, f = map(float, values)
    return a, b, c, d, e, f
