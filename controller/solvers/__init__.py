"""Solvers for the controller's quadratic program, by name."""

from pepper_driver.config import UnknownNameError
from pepper_driver.controller.solvers.daqp_ import DaqpSolver
from pepper_driver.controller.solvers.solver import Solution, Solver

__all__ = ["Solution", "Solver", "make_solver"]


def make_solver(name: str) -> Solver:
    """``daqp``, ``osqp``, or any solver that qpsolvers knows and finds installed.

    Raises:
        UnknownNameError: No such solver here; the message lists those there are.
    """
    if name == "daqp":
        return DaqpSolver()
    # Only those asked for: together they take a quarter of a second to import.
    if name == "osqp":
        from pepper_driver.controller.solvers.osqp_ import OsqpSolver

        return OsqpSolver()
    import qpsolvers

    from pepper_driver.controller.solvers.qpsolvers_ import QpsolversSolver

    if name in qpsolvers.available_solvers:
        return QpsolversSolver(name)
    raise UnknownNameError("solver", name, {"daqp", "osqp", *qpsolvers.available_solvers})
