"""What the robot must not do: bounds on accelerations, and rows of inequalities."""

from pepper_driver.controller.constraints.balance import Balance
from pepper_driver.controller.constraints.box import AccelerationBox
from pepper_driver.controller.constraints.constraint import Constraint, Rows
from pepper_driver.controller.constraints.coupled import CoupledLimits
from pepper_driver.controller.constraints.selection import standard_constraints
from pepper_driver.controller.constraints.self_collision import SelfCollision
from pepper_driver.controller.constraints.stopping import Stopping
from pepper_driver.controller.constraints.torque import TorqueLimit
from pepper_driver.controller.constraints.wheel_speed import WheelSpeedLimit

__all__ = [
    "AccelerationBox",
    "Balance",
    "Constraint",
    "CoupledLimits",
    "Rows",
    "SelfCollision",
    "Stopping",
    "TorqueLimit",
    "WheelSpeedLimit",
    "standard_constraints",
]
