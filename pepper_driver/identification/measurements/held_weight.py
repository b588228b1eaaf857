"""Whether a known weight was in the hand during all of its run."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.identification.measurements.friction import HeldWeight, measure_torque_scale
from pepper_driver.identification.measurements.program import FRICTION, WEIGHT, measured_joints
from pepper_driver.observer import Recording

MAX_RATIO = 2.0
"""Of the scales of torque by the first and by the second half of the run: gears differ by less."""


def falling_weight(
    recordings: Mapping[str, Recording], weight: HeldWeight, robot: RobotConfig
) -> str | None:
    """Return in words that the two halves of a run with a weight contradict each other; None where they do not.

    A weight that falls is missing in the currents from then on: the scale of torques by the second half is then much
    smaller than by the first. One that was hung in too late shows the other way round.

    Args:
        recordings: By name of the run, those with and without the weight.
        weight: That was to be in the hand.
        robot: Its description.
    """
    scales: tuple[list[float], list[float]] = ([], [])
    run = recordings[WEIGHT]
    middle = 0.5 * (run.time[0] + run.time[-1])
    for joint in measured_joints(robot):
        scale = measure_torque_scale([recordings[FRICTION]], [run], joint, weight, robot)
        if scale is not None:
            scales[int(_time_of_sweep(run, robot.joint_index(joint)) > middle)].append(scale)
    if not all(scales):
        return None
    first, second = (median(half) for half in scales)
    if max(first, second) < MAX_RATIO * min(first, second):
        return None
    what = "it fell meanwhile" if second < first else "it was hung in too late"
    return (
        f"the weight of {weight.mass:g} kg counts {first:.2f} times in the first half of its run and {second:.2f} "
        f"times in the second: {what}, or it swings"
    )


def _time_of_sweep(run: Recording, index: int) -> float:
    """Return the median time at which a joint moves [s]."""
    speed = np.abs(run.velocity[:, index])
    return float(np.median(run.time[speed > 0.5 * speed.max()]))
