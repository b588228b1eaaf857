"""Constraints: bounds on accelerations, and rows of inequalities."""

from pepper_driver.config import ControllerSettings, RobotConfig
from pepper_driver.controller.constraints.balance import Balance
from pepper_driver.controller.constraints.box import AccelerationBox
from pepper_driver.controller.constraints.constraint import (
    BrakingLimits,
    Constraint,
    LinearInequality,
)
from pepper_driver.controller.constraints.coupled import CoupledLimits
from pepper_driver.controller.constraints.motor_limits import TorqueLimit, WheelSpeedLimit
from pepper_driver.controller.constraints.self_collision import SelfCollision

__all__ = [
    "AccelerationBox",
    "Balance",
    "BrakingLimits",
    "Constraint",
    "CoupledLimits",
    "LinearInequality",
    "SelfCollision",
    "TorqueLimit",
    "WheelSpeedLimit",
    "standard_constraints",
]


def standard_constraints(robot: RobotConfig, settings: ControllerSettings) -> list[Constraint]:
    """Make the constraints that the settings select."""
    switches, constraints = settings.constraints, list[Constraint]()
    if switches.coupled_limits:
        constraints.append(CoupledLimits(robot, settings.position_margin))
    if switches.wheel_speed:
        constraints.append(WheelSpeedLimit(robot))
    if switches.self_collision:
        constraints.append(SelfCollision(robot))
    if switches.balance:
        constraints.append(Balance(robot))
    return constraints
