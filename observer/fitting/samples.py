"""Samples of free motion that models are fitted to, judged by and get their thresholds from.

A joint at a limit of its speed or its current does what the limit says, and no model of free motion describes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.recording import Recording

WORKING_ERROR = 0.2
"""[rad] No lag at the speeds of an identification is as large: recorded joints fall behind at 0.3 rad and more."""

FALLING_TIME = 0.3
"""[s] in which a joint falls behind: its target was limited before."""

SETTLING_TIME = 0.6
"""[s] in which it settles once it has caught up."""

FLAT_TIME = 0.36
"""[s] A current at its maximum for so long is held there."""

MIN_MOVING_SPEED = 0.1
"""[rad/s] Slower, the weight of an arm may well take the most current of a run, for long."""

FLAT_TOP = (0.02, 0.02)
"""Fraction of the maximum, and [A]: both still count as at the maximum."""

MIN_DRIFT = np.radians(0.3)
"""[rad] by which the tracking error grows, beyond what the speed explains, while a current is clipped."""

FLAT_WINDOW = 5
"""Samples of the running median that takes the noise off a current first."""

MIN_LEVELS = 30
"""Different values a current must show before its shape says anything: small motors show a few steps of the sensor."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClippedCurrent:
    """Current of a joint that its board limits.

    Attributes:
        limit: [A]
        seconds: Longest time for which it stays there [s].
        samples: (n,) samples in which it is there.
    """

    limit: float
    seconds: float
    samples: BoolArray


def fit_samples(recording: Recording, index: int) -> BoolArray:
    """Return the (n,) samples of the joint ``index`` that count: usable, and within its working range."""
    return recording.usable(index) & in_working_range(recording, index)


def in_working_range(recording: Recording, index: int) -> BoolArray:
    """Return (n,) False where a joint is at a limit, and until it has settled again.

    It has fallen behind by more than WORKING_ERROR, or its current is clipped.
    """
    beyond = np.abs(recording.tracking_error(index)) > WORKING_ERROR
    beyond &= recording.usable(index)  # the others are no evidence
    within = ~extended(beyond, recording.cycle, FALLING_TIME, SETTLING_TIME)
    clipped = clipped_current(recording, index)
    if clipped is not None:
        within &= ~extended(clipped.samples, recording.cycle, 0.0, SETTLING_TIME)
    return within


def extended(samples: BoolArray, cycle: float, before: float, after: float) -> BoolArray:
    """Return (n,) samples with those ``before`` and ``after`` each of their stretches [s]."""
    wider = np.zeros(len(samples), dtype=np.bool_)
    early, late = round(before / cycle), round(after / cycle)
    for begin, end in stretches(samples):
        wider[max(0, begin - early) : end + late] = True
    return wider


def stretches(flags: BoolArray) -> list[tuple[int, int]]:
    """Return begin and end of each stretch of True among (n,) flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def clipped_current(recording: Recording, index: int) -> ClippedCurrent | None:
    """Return the current of a joint that stays at its maximum while the joint shall move; None if it does not.

    Load and friction may well keep a current constant. But a board below its limit relates error, current and speed,
    whatever the friction: then the error follows the speed, and an integral part makes it smaller. At its limit it
    grows beyond that.
    """
    raw = recording.current[:, index]
    if len(np.unique(raw)) < MIN_LEVELS or len(recording) < FLAT_WINDOW:
        return None
    current, error = _smooth(raw), _smooth(recording.tracking_error(index))
    half = FLAT_WINDOW // 2
    velocity = recording.velocity[half : half + len(current), index]
    moving = np.abs(velocity) > MIN_MOVING_SPEED
    top = float(current.max())
    high = current >= top - max(FLAT_TOP[0] * top, FLAT_TOP[1])
    begin, end = max(stretches(moving & high), key=lambda one: one[1] - one[0], default=(0, 0))
    seconds = (end - begin) * float(np.median(np.diff(recording.time)))
    if seconds < FLAT_TIME:
        return None
    law = np.stack((current, velocity * np.sign(error), np.ones(len(current))), axis=1)
    below = moving & ~high
    coefficients = np.linalg.lstsq(law[below], np.abs(error[below]), rcond=None)[0]
    beyond = (np.abs(error) - law @ coefficients)[begin:end]
    if np.max(beyond - np.minimum.accumulate(beyond)) < MIN_DRIFT:
        return None
    samples = np.zeros(len(recording), dtype=np.bool_)
    samples[half : half + len(current)] = moving & high
    return ClippedCurrent(limit=top, seconds=seconds, samples=samples)


def _smooth(values: FloatArray) -> FloatArray:
    """Return the running median of FLAT_WINDOW samples, without those at both ends."""
    windows = np.lib.stride_tricks.sliding_window_view(values, FLAT_WINDOW)
    smoothed: FloatArray = np.median(windows, axis=1)
    return smoothed
