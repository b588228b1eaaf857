"""The way of the base over a log."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.log.reader import RunLog


def base_path(log: RunLog) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3) pose of the base and (n, 2) its tilt over the ticks of a log.

    They are the truth of a simulation where the log has it; else the pose comes from the speeds of the wheels.
    """
    ticks = log["time"]
    if log.truth is not None:
        rows = np.clip(np.searchsorted(log.truth["time"], ticks), 0, len(log.truth["time"]) - 1)
        return log.truth["base"][rows], log.truth["tilt"][rows]
    wheels = load_robot().wheels
    twist = np.nan_to_num(log["wheel_speed"]) @ np.asarray(wheels.inverse).T
    step = np.diff(ticks, prepend=ticks[:1])
    yaw = np.cumsum(twist[:, 2] * step)
    forward, left = twist[:, 0] * step, twist[:, 1] * step
    x = np.cumsum(np.cos(yaw) * forward - np.sin(yaw) * left)
    y = np.cumsum(np.sin(yaw) * forward + np.cos(yaw) * left)
    return np.stack([x, y, yaw], axis=1), np.zeros((len(ticks), 2))
