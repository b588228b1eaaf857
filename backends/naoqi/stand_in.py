"""What only a stand-in can do, and no robot: be pushed and grabbed by its own program, and say what it is made of."""

from __future__ import annotations

from pepper_driver.backends.interface import CapabilityError, SimulatedPlant
from pepper_driver.backends.naoqi.connection import Connection, ServiceError
from pepper_driver.backends.selection import make_backend
from pepper_driver.config import PepperError, RobotConfig, UnknownNameError

SERVICE = "StandIn"


class HandlingError(ServiceError, ValueError):
    """The stand-in cannot push or grab like that; the message says why."""


def handle(
    connection: Connection, robot: RobotConfig, method: str, link: str, **arguments: object
) -> None:
    """Have a link pushed or grabbed; see :class:`~pepper_driver.backends.interface.Backend`.

    This waits for the answer: a few milliseconds of a tick, on a robot that is none.

    Args:
        connection: With the stand-in.
        robot: Names its links.
        method: ``push`` or ``grab``.
        link: Name of the link.
        arguments: The others.

    Raises:
        UnknownNameError: No such link.
        HandlingError: That is not possible, for the reason given.
    """
    if link not in robot.links:
        raise UnknownNameError("link", link, robot.links)
    plain = {"link": link, **{name: _plain(value) for name, value in arguments.items()}}
    try:
        connection.call(SERVICE, method, plain)
    except ServiceError as error:
        raise HandlingError(str(error)) from error


def simulated_plant(connection: Connection, robot: RobotConfig) -> SimulatedPlant:
    """The robot that the stand-in simulates, from its URI.

    Raises:
        CapabilityError: It cannot be simulated here, for example as its plant is a file of another computer.
    """
    info = connection.call(SERVICE, "info")
    try:
        backend = make_backend(str(info["uri"]), robot)
        same = backend.info.identity == info["identity"]
        problem = "" if same else "here it is another one"
    except PepperError as error:
        problem = str(error)
    if problem:
        raise CapabilityError(f"the stand-in simulates '{info['uri']}': {problem}")
    return backend.plant


def _plain(value: object) -> object:
    """As qi takes it; it makes no sense of numpy."""
    tolist = getattr(value, "tolist", None)
    return value if tolist is None else tolist()
