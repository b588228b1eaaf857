"""Robot, settings and small parts that the controller's tests share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pepper_driver.config import ConstraintSwitches, load_controller_settings, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference, RobotModel, WholeBodyController
from pepper_driver.controller.constraints import BrakingLimits, Constraint, LinearInequality

ROBOT = load_robot()
STANDARD = load_controller_settings(ROBOT)
ALONE = ConstraintSwitches(
    coupled_limits=False, wheel_speed=False, self_collision=False, balance=False
)
SETTINGS = replace(STANDARD, constraints=ALONE)
"""Limits of single joints alone: what other constraints do is tested where they are added."""

DT = ROBOT.cycle
JOINTS = len(ROBOT.joint_names)
MIDDLE = (ROBOT.lower + ROBOT.upper) / 2
VELOCITY = np.array([SETTINGS.velocity_limit[name] for name in ROBOT.joint_names])
ACCELERATION = np.array([SETTINGS.acceleration_limit[name] for name in ROBOT.joint_names])
BASE = ROBOT.limits.base
BASE_VELOCITY = np.array([BASE.linear_velocity, BASE.linear_velocity, BASE.angular_velocity])
BASE_ACCELERATION = np.array(
    [BASE.linear_acceleration, BASE.linear_acceleration, BASE.angular_acceleration]
)


def controller(solver: str = "daqp") -> WholeBodyController:
    return WholeBodyController(ROBOT, replace(SETTINGS, solver=solver))


def random_posture(random: np.random.Generator) -> FloatArray:
    return random.uniform(ROBOT.lower, ROBOT.upper)


def wander(
    control: WholeBodyController, ticks: int, *, seed: int, hold: int = 125
) -> list[Reference]:
    """References on the way to random postures and base twists, new ones every ``hold`` ticks."""
    random = np.random.default_rng(seed)
    references = []
    for tick in range(ticks):
        if tick % hold == 0:
            control.posture.target = random_posture(random)
            control.base_velocity.target = random.uniform(-0.2, 0.2, 3)
        references.append(control.step())
        assert control.status.solver == "solved"
    return references


class FixedRows(Constraint):
    """Rows that do not depend on the state."""

    name = "rows"
    needs_kinematics = False

    def __init__(self, matrix: FloatArray, bound: FloatArray) -> None:
        self._rows = LinearInequality(matrix, bound, tuple(f"row {i}" for i in range(len(bound))))

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality:
        return self._rows
