"""Noise of encoders and currents at rest, samples that come late, and samples that are lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.identification.measurements.response import STILL
from pepper_driver.observer import Recording

REST_TICKS = 60
"""Ticks of a command that is still, after which a joint has settled."""

WINDOW = 12
"""Samples from which one standard deviation is taken: slow drift is no noise."""

FAST_STEPS = 3.0
"""Steps of the encoder in a tick: a joint that moves so fast before and after does not stand still in between."""


def measure_noise(recording: Recording, joint: str) -> tuple[float, float] | None:
    """Measure the noise of encoder [rad] and current [A] while a joint rests; None where it never does."""
    index = recording.joint_names.index(joint)
    still = np.abs(np.diff(recording.sent_position[:, index], prepend=np.nan)) < STILL
    windows = []
    count = 0
    for k, rests in enumerate(still.tolist()):
        count = count + 1 if rests else 0
        if count > REST_TICKS and (count - REST_TICKS) % WINDOW == 0:
            windows.append(slice(k - WINDOW + 1, k + 1))
    if not windows:
        return None
    encoder, current = (
        float(np.sqrt(np.mean([values[window].var(ddof=1) for window in windows])))
        for values in (recording.position[:, index], recording.current[:, index])
    )
    return encoder, current


def late_fraction(recordings: Sequence[Recording]) -> float:
    """Return the fraction of samples that came later than usual."""
    late = [run.age > 0.5 * run.cycle for run in recordings]
    return float(np.mean(np.concatenate(late)))


def lost_fraction(
    recordings: Sequence[Recording], joints: Sequence[str], robot: RobotConfig
) -> float | None:
    """Return the fraction of samples of joints in fast motion that repeat the one before; None without such motion.

    Samples that are late as a whole do not count.
    """
    step = robot.sensors.encoder.step
    repeated = seen = 0
    for run in recordings:
        fresh = run.age < 0.5 * run.cycle
        for joint in joints:
            change = np.abs(np.diff(run.position[:, robot.joint_index(joint)]))
            # A lost sample has its motion in the next one.
            moving = np.minimum(change[:-2], change[2:]) > FAST_STEPS * step
            moving &= fresh[1:-2] & fresh[2:-1] & fresh[3:]
            seen += int(np.count_nonzero(moving))
            repeated += int(np.count_nonzero(moving & (change[1:-1] < 0.5 * step)))
    return repeated / seen if seen else None
