"""Check that a known weight was in the hand during all of its run."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.identification.measurements.friction import HeldWeight, slow_samples
from pepper_driver.observer import Recording
from pepper_driver.observer.models.measured_robot import MeasuredJoint

MIN_HELD_RATIO = 0.35
"""Of what a weight should count, below which it hangs at no joint: arms that weigh twice as much halve it."""

MIN_HALVES_RATIO = 0.5
"""Of what the weight counts at one joint and at those of the other half: masses of arms are known better than that."""


def falling_weight(
    joints: Mapping[str, MeasuredJoint],
    loaded: Recording,
    weight: HeldWeight,
    robot: RobotConfig,
) -> str | None:
    """Return in words that a weight was not in the hand during all of its run; None where it was.

    Each joint sweeps at a time of its own. A weight that falls is missing in the currents of those that sweep after
    it, one that was hung in too late in those before. What it counts is compared with what the arm itself counts at
    the same joint, since gears differ.

    Args:
        joints: Scales of load and torque of the joints that were measured.
        loaded: Run with the weight.
        weight: That was to be in the hand.
        robot: Its description.
    """
    middle = 0.5 * (loaded.time[0] + loaded.time[-1])
    first: dict[str, float] = {}
    second: dict[str, float] = {}
    for joint, one in joints.items():
        if one.torque_scale is None or one.load_scale is None:
            continue
        half = second if _time_of_sweep(loaded, robot.joint_index(joint)) > middle else first
        half[joint] = one.torque_scale / one.load_scale
    if not (first and second):
        return None
    most = max(*first.values(), *second.values())
    if most < MIN_HELD_RATIO:
        return f"the weight of {weight.mass:g} kg counts {most:.2f} times at most: it was not in the hand"
    for half, other, what in (
        (second, first, "it fell meanwhile"),
        (first, second, "it was hung in too late"),
    ):
        joint = min(half, key=lambda name: half[name])
        usual = median(other.values())
        if half[joint] < MIN_HALVES_RATIO * usual:
            return (
                f"the weight of {weight.mass:g} kg counts {half[joint]:.2f} times at {joint} and {usual:.2f} times in "
                f"the other half of its run: {what}, or it swings"
            )
    return None


def _time_of_sweep(run: Recording, index: int) -> float:
    """Return the median time at which a joint sweeps slowly [s]."""
    return float(np.median(run.time[slow_samples(run, index)]))
