"""How far the residual of a joint strays in free motion: the bound beyond which it means a contact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.prediction import JointModel, predict_recording
from pepper_driver.observer.recording import Recording

MARGIN = 1.25
"""Over the largest residual of the recordings: the next motion may be a little worse than all of them."""


def free_residual(joint: str, recording: Recording, model: JointModel, window: int) -> FloatArray:
    """The residual of free motion as the observer would see it: Eq. 13, running median of ``window`` samples [rad].

    Only windows without a sample that is stale or whose command the safety gate altered.
    """
    index = recording.joint_names.index(joint)
    residual = recording.tracking_error(index) - predict_recording(model, joint, recording)
    residual = np.where(recording.usable(index), residual, np.nan)
    if len(residual) < window:
        return np.empty(0)
    windows = np.lib.stride_tricks.sliding_window_view(residual, window)
    median: FloatArray = np.median(windows[np.isfinite(windows).all(axis=1)], axis=1)
    return median


def free_threshold(
    joint: str, recordings: Sequence[Recording], model: JointModel, window: int
) -> float:
    """MARGIN times the largest residual of a joint in recordings of free motion [rad].

    Recordings that the model was not fitted to, faster than those it was, make it an honest bound; recordings in which
    somebody touched the robot make it a useless one.

    Raises:
        ValueError: The recordings hold no whole window of usable samples.
    """
    largest = [np.abs(free_residual(joint, r, model, window)).max(initial=0.0) for r in recordings]
    if not max(largest, default=0.0) > 0.0:
        raise ValueError(f"{joint}: no recording holds {window} usable samples in a row")
    return MARGIN * float(max(largest))
