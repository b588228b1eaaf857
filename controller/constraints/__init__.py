"""What the robot must not do: bounds on accelerations, and rows of inequalities."""

from pepper_driver.controller.constraints.box import AccelerationBox
from pepper_driver.controller.constraints.constraint import Constraint, Rows
from pepper_driver.controller.constraints.stopping import Stopping

__all__ = ["AccelerationBox", "Constraint", "Rows", "Stopping"]
