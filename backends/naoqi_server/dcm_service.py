"""The service ``DCM``."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.clock import wrapped
from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.dcm import TimedCommand, UpdateType
from pepper_driver.backends.naoqi_server.requests import (
    RequestError,
    alias_request,
    set_alias_request,
    set_request,
)

DEVICE_LIST = "Device/DeviceList/"


class DcmService:
    """Takes orders for the robot's actuators; NAOqi 2.5.10, page "DCM API"."""

    def __init__(self, context: Context) -> None:
        self._robot = context.robot
        self._prefix = context.config.naoqi.prefix
        self._aliases: dict[str, list[str]] = {}

    def getPrefix(self) -> list[str]:
        """What stands before the names of sub-devices, and of devices."""
        return [self._prefix, DEVICE_LIST]

    def getTime(self, offset: int) -> int:
        """The DCM's time [ms], 32 bits with a sign, and ``offset`` ms more."""
        if not isinstance(offset, int) or isinstance(offset, bool):
            raise RequestError(f"the offset must be a whole number of ms, got {offset!r}")
        return wrapped(self._robot.time() + offset)

    def createAlias(self, request: object) -> list[object]:
        """Make or change an alias: ``[name, [actuator, ...]]``; returned with "" for actuators that do not exist.

        A command for one of those is taken and does nothing.
        """
        name, actuators = alias_request(request)
        found = [actuator if self._key(actuator) else "" for actuator in actuators]
        self._aliases[name] = [self._key(actuator) for actuator in actuators]
        return [name, found]

    def set(self, request: object) -> None:
        """The same commands for an actuator, or for all of an alias: ``[name, update type, [[value, time], ...]]``."""
        name, update, commands = set_request(request)
        keys = [self._key(name)] if self._key(name) else self._alias(name)
        self._order(keys, update, [commands] * len(keys))

    def setAlias(self, request: object) -> None:
        """Commands for each actuator of an alias, "time-mixed" or "time-separate"."""
        name, update, commands = set_alias_request(request)
        keys = self._alias(name)
        if len(commands) != len(keys):
            raise RequestError(
                f"alias '{name}' has {len(keys)} actuators, and there are {len(commands)} lists"
            )
        self._order(keys, update, commands)

    def _order(
        self, keys: list[str], update: UpdateType, commands: list[list[TimedCommand]]
    ) -> None:
        known = [place for place, key in enumerate(keys) if key]
        self._robot.order(
            [keys[place] for place in known], update, [commands[place] for place in known]
        )

    def _key(self, name: str) -> str:
        """The full key of an actuator, given with or without its prefix; "" if there is none."""
        for key in (name, self._prefix + name):
            if key in self._robot.actuators:
                return key
        return ""

    def _alias(self, name: str) -> list[str]:
        if name not in self._aliases:
            raise RequestError(f"no actuator or alias '{name}'")
        return self._aliases[name]
