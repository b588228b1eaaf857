"""Scale of torque estimates: stiffness of each joint in [N m/rad], and how far it is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.measured_robot import MeasuredRobot

GEAR_EFFICIENCY = 0.8
"""Fraction of the torque of a motor, by its documented constant, that reaches the joint; assumed without a weight."""

WEIGHED_STD = 0.07
"""Relative standard deviation of a scale by a known weight: mostly that of the current's factor in the model."""

ASSUMED_STD = 0.15
"""That of a scale by documented constants and masses."""

LOAD_STD = 0.3
"""That of a joint whose current does not show its torque: by documented masses alone, of a wrist by its motor."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueScale:
    """Scale of the torques of all joints, (n,) each.

    Attributes:
        stiffness: K [N m/rad], NaN for a joint without a model.
        std: Relative standard deviation of K, NaN for a joint without a model.
        known: Joints whose scale was measured with a known weight.
        by_current: Joints whose current shows their torque.
    """

    stiffness: FloatArray
    std: FloatArray
    known: BoolArray
    by_current: BoolArray

    @classmethod
    def from_models(
        cls,
        models: Sequence[FusionModel | None],
        robot: RobotConfig,
        measured: MeasuredRobot | None,
    ) -> TorqueScale:
        """Derive the scale from models.

        A model has torques over K. Their scale follows from the torque per ampere, in the order of preference

        - as a known weight has shown it;
        - as the geometric mean of two assumptions, where there was no weight: the documented torque constant with gears
          of GEAR_EFFICIENCY, and the documented masses, whose load the model fits. Half of what these differ by is the
          least uncertainty;
        - as the model has it, where the current does not show the torque: by the documented masses alone, or, of a
          wrist, by current and voltage of its documented motor while it slides.
        """
        n = len(models)
        stiffness, std = np.full(n, np.nan), np.full(n, np.nan)
        known, by_current = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
        for j, (name, model) in enumerate(zip(robot.joint_names, models, strict=True)):
            if model is None:
                continue
            by_load = 1.0 / model.twin.load_gain
            if model.momentum.source != "current":
                stiffness[j], std[j] = by_load, LOAD_STD
                continue
            by_current[j] = True
            by_constant = (
                robot.motors.joint_torque_constant(name) / model.momentum.torque_per_ampere
            )
            joint = None if measured is None else measured.joints.get(name)
            if joint is not None and joint.torque_scale is not None:
                stiffness[j] = by_constant / joint.torque_scale
                std[j], known[j] = WEIGHED_STD, True
                continue
            by_motor = GEAR_EFFICIENCY * by_constant
            stiffness[j] = math.sqrt(by_load * by_motor)
            std[j] = max(ASSUMED_STD, 0.5 * abs(math.log(by_load / by_motor)))
        return cls(stiffness=stiffness, std=std, known=known, by_current=by_current)
