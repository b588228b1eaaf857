"""Solvers for the controller's quadratic program, by name."""

from pepper_driver.controller.solvers.selection import make_solver
from pepper_driver.controller.solvers.solver import Solution, Solver

__all__ = ["Solution", "Solver", "make_solver"]
