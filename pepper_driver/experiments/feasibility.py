"""Postures that a robot can take in time, within limits that depend on another joint, with room between its links."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from pepper_driver.config import RobotConfig, load_self_collision
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.robot import POSTURE_TOLERANCE
from pepper_driver.controller import RobotModel
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.experiments.segments import Segment


class PostureCheck:
    """Finds out whether a robot can take a posture; joints that are NaN are not known."""

    def __init__(self, robot: RobotConfig) -> None:
        self._robot, self._settings = robot, load_self_collision(robot)
        self._known: dict[bytes, str] = {}

    @cached_property
    def _capsules(self) -> tuple[RobotModel, CapsuleDistances]:
        model = RobotModel(self._robot)
        return model, CapsuleDistances(model, self._settings)

    def problem(self, posture: FloatArray) -> str:
        """Describe why the robot cannot take a posture (17,) [rad]; empty where it can."""
        key = posture.tobytes()
        if key not in self._known:
            self._known[key] = self._beyond_coupled(posture) or self._collision(posture)
        return self._known[key]

    def _beyond_coupled(self, posture: FloatArray) -> str:
        """Describe the limit a posture breaks that depends on another joint."""
        robot = self._robot
        for limit in robot.limits.coupled:
            driver = float(posture[robot.joint_index(limit.driver)])
            driven = float(posture[robot.joint_index(limit.driven)])
            rows = np.array(limit.table)
            lower, upper = (float(np.interp(driver, rows[:, 0], rows[:, k])) for k in (1, 2))
            # NaN is not.
            if driven < lower - POSTURE_TOLERANCE or driven > upper + POSTURE_TOLERANCE:
                return (
                    f"{limit.driven} at {driven:.3g} rad lies outside {lower:.3g} to {upper:.3g} rad, which are its"
                    f" limits while {limit.driver} is at {driver:.3g} rad"
                )
        return ""

    def _collision(self, posture: FloatArray) -> str:
        """Describe the nearest pair of links, where it is too near; empty where a joint is not known."""
        if not np.isfinite(posture).all():
            return ""
        (model, capsules), least = self._capsules, self._settings.security_distance
        capsules.place(model.configuration(posture))
        distances = capsules.distances()
        nearest = int(distances.argmin())
        if (distance := distances[nearest]) >= least:
            return ""
        first, _, second = capsules.names[nearest].partition("-")
        near = f"come within {1e3 * distance:.0f} mm of one another"
        how = near if distance > 0 else "run into one another"
        return f"{first} and {second} would {how}; they must stay {1e3 * least:.0f} mm apart"


def too_fast(segment: Segment, before: Segment, led: BoolArray, robot: RobotConfig) -> str:
    """Describe the joint that cannot get to the posture of a segment within its ``duration``; empty where all can.

    Joints that tasks have moved (``led``, (17,)), and those that were still moving to a step as fast as stiffness
    allows, may be anywhere.
    """
    duration = segment.step.duration
    if duration is None or (before.step.duration is None and not before.at_rest(segment.start)):
        return ""
    distance = np.abs(segment.posture - before.posture)
    speeds = np.where(led | np.isnan(distance), 0.0, distance) / duration
    over = speeds / [joint.velocity for joint in robot.joints]
    if over.max() <= 1.0:
        return ""
    joint = robot.joints[int(over.argmax())]
    unit = "" if joint.name in robot.hands.joints else " rad"
    least = math.ceil(100.0 * duration * float(over.max())) / 100.0
    return (
        f"{joint.name} would go {speeds[int(over.argmax())] * duration:.3g}{unit} in {duration:g} s, and makes"
        f" {joint.velocity:.3g}{unit}/s at most; give {least:g} s or more"
    )
