"""The service ``StandIn``, which no robot has: what happens to a robot from outside, and what it really did."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from pepper_driver.backends.naoqi_server.context import Context


class StandInService:
    """Pushes, faults and truth of the simulated robot."""

    def __init__(self, context: Context) -> None:
        self._robot, self._faults = context.robot, context.faults
        self._record = context.shared.record

    def info(self) -> dict[str, Any]:
        """Which robot this is: ``identity``, ``plant``, ``parents``, ``uri``, ``response_delay``, ``pid``, ..."""
        return dict(self._robot.info)

    def push(self, arguments: dict[str, Any]) -> None:
        """Push a link; arguments of ``Backend.push`` by name."""
        self._robot.push(**arguments)

    def grab(self, arguments: dict[str, Any]) -> None:
        """Take a link in a springy hand; arguments of ``Backend.grab`` by name."""
        self._robot.grab(**arguments)

    def setFault(self, name: str, arguments: dict[str, Any]) -> None:
        """Let something go wrong: a name of ``faults.FAULTS``, and its arguments by name."""
        self._faults.set(name, arguments)

    def clearFaults(self) -> None:
        """End all faults that can end."""
        self._faults.clear()

    def record(self) -> list[list[Any]]:
        """What was said and shown: ``[seconds since the start, service, method, [arguments]]``, oldest first."""
        return self._record.entries

    def blackBox(self, last: int) -> dict[str, Any]:
        """What the robot really did in the ``last`` cycles: lists by name, see ``BlackBox``."""
        return {name: rows.tolist() for name, rows in asdict(self._robot.black_box(last)).items()}
