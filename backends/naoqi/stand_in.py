"""What only a stand-in can do, and no robot: be pushed and grabbed by its own program."""

from __future__ import annotations

from pepper_driver.backends.naoqi.connection import Connection, ServiceError
from pepper_driver.config import RobotConfig, UnknownNameError

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


def _plain(value: object) -> object:
    """As qi takes it; it makes no sense of numpy."""
    tolist = getattr(value, "tolist", None)
    return value if tolist is None else tolist()
