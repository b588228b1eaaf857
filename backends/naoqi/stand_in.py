"""Abilities of a stand-in alone: pushes and grabs by its own program, and the parameters of its plant."""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

import numpy as np

from pepper_driver.backends.interface import Backend, CapabilityError
from pepper_driver.backends.naoqi.connection import Connection, ServiceError
from pepper_driver.backends.pushes import check_grab, check_push
from pepper_driver.backends.selection import make_backend
from pepper_driver.backends.simulated import Grab, Push, SimulatedPlant
from pepper_driver.config import PepperError, RobotConfig, RobotIdentity

SERVICE = "StandIn"


class RemotePushError(ServiceError, ValueError):
    """The stand-in cannot push or grab like that; the message says why."""


class RemotePushMixin(Backend):
    """Pushes and grabs of a robot that may be a stand-in."""

    _robot: RobotConfig
    _plant: SimulatedPlant | None = None

    @abstractmethod
    def _connected(self) -> Connection:
        """Return the connection of an open robot."""

    @abstractmethod
    def _met(self) -> Connection:
        """Return the connection of a robot; open it if necessary."""

    def schedule_push(self, push: Push) -> None:
        """Have a link of a stand-in pushed."""
        self._handle("push", push)

    def schedule_grab(self, grab: Grab) -> None:
        """Grab a link of a stand-in by a hand that acts as a spring."""
        self._handle("grab", grab)

    @property
    def plant(self) -> SimulatedPlant:
        """Robot that a stand-in simulates."""
        if "push" not in self.info.capabilities:
            return super().plant
        if self._plant is None:
            self._plant = simulated_plant(self._met(), self._robot)
        return self._plant

    def _handle(self, method: Literal["push", "grab"], request: Push | Grab) -> None:
        """Have a link pushed or grabbed; waits for the answer: a few milliseconds of a tick, on a simulated robot.

        Raises:
            UnknownNameError: No such link or frame.
            CommandError: A number that is not finite or out of range.
            RemotePushError: That is not possible, for the reason given.
        """
        connection = self._connected()
        if method not in self.info.capabilities:
            raise CapabilityError(f"'{self.uri}' cannot {method} itself: only simulated robots can")
        # Checked on this side too: over qi every error becomes a RuntimeError without its type.
        if isinstance(request, Push):
            check_push(request, self._robot.links)
        else:
            check_grab(request, self._robot.links)
        plain = {name: _plain(value) for name, value in vars(request).items()}
        try:
            connection.call(SERVICE, method, plain)
        except ServiceError as error:
            raise RemotePushError(str(error)) from error


def simulated_plant(connection: Connection, robot: RobotConfig) -> SimulatedPlant:
    """Return the robot that the stand-in simulates, from its URI.

    Raises:
        CapabilityError: It cannot be simulated here, for example as its plant is a file of another computer.
    """
    info = connection.call(SERVICE, "info")
    try:
        backend = make_backend(str(info["uri"]), robot)
        # A plant given by a file may differ between the two computers.
        same = backend.info.identity == info["identity"]
        problem = "" if same else "here it is another one"
    except PepperError as error:
        problem = str(error)
    if problem:
        raise CapabilityError(f"the stand-in simulates '{info['uri']}': {problem}")
    return backend.plant


def simulated_parents(connection: Connection) -> tuple[RobotIdentity, ...]:
    """Return the plants of which the robot of the stand-in is a variant, nearest first."""
    parents = connection.call(SERVICE, "info")["parents"]
    return tuple(RobotIdentity(name=name, identity=identity) for name, identity in parents)


def _plain(value: object) -> object:
    """As qi takes it; it makes no sense of numpy."""
    if isinstance(value, str | None):
        return value
    plain: object = np.asarray(value).tolist()
    return plain
