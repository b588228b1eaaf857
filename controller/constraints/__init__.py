"""What the robot must not do: bounds on accelerations, and rows of inequalities."""

from pepper_driver.controller.constraints.balance import Balance
from pepper_driver.controller.constraints.box import AccelerationBox
from pepper_driver.controller.constraints.braking_limits import BrakingLimits
from pepper_driver.controller.constraints.constraint import Constraint, LinearInequality
from pepper_driver.controller.constraints.coupled import CoupledLimits
from pepper_driver.controller.constraints.selection import standard_constraints
from pepper_driver.controller.constraints.self_collision import SelfCollision
from pepper_driver.controller.constraints.torque import TorqueLimit
from pepper_driver.controller.constraints.wheel_speed import WheelSpeedLimit

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
