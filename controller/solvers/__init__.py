"""Solvers of the quadratic program of the controller, by name."""

from pepper_driver.config import UnknownNameError
from pepper_driver.controller.solvers.daqp_ import DaqpSolver
from pepper_driver.controller.solvers.solver import Solution, Solver

__all__ = ["Solution", "Solver", "make_solver"]


def make_solver(name: str) -> Solver:
    """Make a solver: ``daqp``, ``osqp``, or any solver of qpsolvers that is installed.

    Raises:
        UnknownNameError: No such solver; the message lists those that are available.
    """
    if name == "daqp":
        return DaqpSolver()
    # Imported only when selected: together they take a quarter of a second.
    if name == "osqp":
        from pepper_driver.controller.solvers.osqp_ import OsqpSolver

        return OsqpSolver()
    import qpsolvers

    from pepper_driver.controller.solvers.qpsolvers_ import QpsolversSolver

    if name in qpsolvers.available_solvers:
        return QpsolversSolver(name)
    raise UnknownNameError("solver", name, {"daqp", "osqp", *qpsolvers.available_solvers})
