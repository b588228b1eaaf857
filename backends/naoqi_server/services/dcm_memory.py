"""DCM and ALMemory as services."""

from __future__ import annotations

import qi

from pepper_driver.backends.naoqi_server.dcm import (
    RequestError,
    TimedCommand,
    UpdateType,
    alias_request,
    set_alias_request,
    set_request,
    wrapped,
)
from pepper_driver.backends.naoqi_server.memory import Kind, Value
from pepper_driver.backends.naoqi_server.services.calls import named
from pepper_driver.backends.naoqi_server.services.context import Context

DEVICE_LIST = "Device/DeviceList/"


class DcmService:
    """Takes orders for the robot's actuators; NAOqi 2.5.10, page "DCM API"."""

    def __init__(self, context: Context) -> None:
        self._robot = context.robot
        self._prefix = context.config.naoqi.prefix
        self._aliases: dict[str, list[str]] = {}

    def getPrefix(self) -> list[str]:
        """Return the prefixes of the names of sub-devices, and of devices."""
        return [self._prefix, DEVICE_LIST]

    def getTime(self, offset: int) -> int:
        """Return the DCM's time [ms], 32 bits with a sign, and ``offset`` ms more."""
        if not isinstance(offset, int) or isinstance(offset, bool):
            raise RequestError(f"the offset must be a whole number of ms, got {offset!r}")
        return wrapped(self._robot.time() + offset)

    def createAlias(self, request: object) -> list[object]:
        """Make or change an alias: ``[name, [actuator, ...]]``; returned with "" for actuators that do not exist.

        A command for one of those is accepted and does nothing.
        """
        name, actuators = alias_request(request)
        found = [actuator if self._key(actuator) else "" for actuator in actuators]
        self._aliases[name] = [self._key(actuator) for actuator in actuators]
        return [name, found]

    def set(self, request: object) -> None:
        """Set commands of an actuator, or of all in an alias: ``[name, update type, [[value, time], ...]]``."""
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
        # Actuators that do not exist keep their places in an alias, and commands for them do nothing.
        known = [place for place, key in enumerate(keys) if key]
        self._robot.order(
            [keys[place] for place in known], update, [commands[place] for place in known]
        )

    def _key(self, name: str) -> str:
        """Return the full key of an actuator, given with or without its prefix; "" if it does not exist."""
        for key in (name, self._prefix + name):
            if key in self._robot.actuators:
                return key
        return ""

    def _alias(self, name: str) -> list[str]:
        if name not in self._aliases:
            raise RequestError(f"no actuator or alias '{name}'")
        return self._aliases[name]


class Subscriber:
    """Result of ``subscriber``: connect to its ``signal``."""

    def __init__(self) -> None:
        self.signal = qi.Signal("(m)")


class MemoryService:
    """Data and events of the robot; NAOqi 2.5.10, page "ALMemory API"."""

    def __init__(self, context: Context) -> None:
        self._memory, self._call = context.memory, context.call
        self._subscribers: dict[str, Subscriber] = {}
        self._modules: dict[tuple[str, str], tuple[str, str]] = {}
        self._subscribed: set[str] = set()

    def getData(self, key: str) -> Value:
        """Value of one key; an error if it does not exist."""
        return self._memory.get(_text(key))

    @named("getData")
    def _get_data(self, key: str, unused: int) -> Value:
        """As old programs call it."""
        return self.getData(key)

    def getListData(self, keys: object) -> list[Value]:
        """Values of many keys, None for missing ones."""
        if not isinstance(keys, list | tuple):
            raise ValueError(f"expected a list of keys, got {keys!r}")
        return self._memory.get_list(keys)

    def getTimestamp(self, key: str) -> list[Value]:
        """``[value, seconds, microseconds]`` of the last write."""
        stamp = self._memory.stamp(_text(key))
        return [self._memory.get(key), int(stamp), int(stamp % 1.0 * 1e6)]

    def getDataList(self, part: str) -> list[str]:
        """Names of the keys that hold ``part``."""
        return self._memory.names(part=_text(part))

    def getDataListName(self) -> list[str]:
        """Names of all keys."""
        return self._memory.names()

    def getEventList(self) -> list[str]:
        """Names of all events."""
        return self._memory.names(kind="Event")

    def getMicroEventList(self) -> list[str]:
        """Names of all micro-events."""
        return self._memory.names(kind="MicroEvent")

    def getType(self, key: str) -> str:
        """Return the type of a key: "Data", "Event" or "MicroEvent"."""
        return self._memory.kind(_text(key))

    def insertData(self, key: str, value: Value) -> None:
        """Put a value in; no event."""
        self._memory.insert(_text(key), value)

    def insertListData(self, pairs: Value) -> None:
        """Put many values in: ``[[key, value], ...]``."""
        for key, value in pairs:
            self._memory.insert(_text(key), value)

    def removeData(self, key: str) -> None:
        """Forget a key."""
        self._memory.remove(_text(key))

    def declareEvent(self, name: str) -> None:
        """Make an event known."""
        self._memory.declare(_text(name))

    @named("declareEvent")
    def _declare_event(self, name: str, extractor: str) -> None:
        """Declare an event, with the name of the module that will raise it."""
        self.declareEvent(name)

    def raiseEvent(self, name: str, value: Value) -> None:
        """Send a value to all subscribers of this event."""
        self._memory.raise_event(_text(name), value)

    def raiseMicroEvent(self, name: str, value: Value) -> None:
        """Raise a micro-event."""
        self._memory.raise_event(_text(name), value, "MicroEvent")

    def subscriber(self, name: str) -> Subscriber:
        """Return an object whose ``signal`` is emitted with the value each time the event is raised."""
        if name not in self._subscribers:
            made = self._subscribers[_text(name)] = Subscriber()
            self._memory.listen(name, made.signal)
        return self._subscribers[name]

    def subscribeToEvent(self, name: str, module: str, method: str) -> None:
        """Call ``method(name, value, "")`` of a service each time the event is raised."""
        self._subscribe(name, module, method, "", "Event")

    @named("subscribeToEvent")
    def _subscribe_to_event(self, name: str, module: str, message: str, method: str) -> None:
        """Subscribe to an event, with a message for the method."""
        self._subscribe(name, module, method, message, "Event")

    def subscribeToMicroEvent(self, name: str, module: str, message: str, method: str) -> None:
        """Call ``method(name, value, message)`` of a service each time the micro-event is raised."""
        self._subscribe(name, module, method, message, "MicroEvent")

    def unsubscribeToEvent(self, name: str, module: str) -> None:
        """End what :meth:`subscribeToEvent` began."""
        self._modules.pop((_text(name), module), None)

    def unsubscribeToMicroEvent(self, name: str, module: str) -> None:
        """End what :meth:`subscribeToMicroEvent` began."""
        self._modules.pop((_text(name), module), None)

    def getSubscribers(self, name: str) -> list[str]:
        """Names of the services that :meth:`subscribeToEvent` subscribed."""
        return [module for event, module in self._modules if event == name]

    def _subscribe(self, name: str, module: str, method: str, message: str, kind: Kind) -> None:
        for text in (name, module, method, message):
            _text(text)
        if name not in self._memory.names(kind=kind):
            self._memory.declare(name, kind)
        self._modules[name, module] = (method, message)
        if name not in self._subscribed:
            self._subscribed.add(name)
            self._memory.listen(name, lambda value: self._notify(name, value))

    def _notify(self, name: str, value: Value) -> None:
        # A copy, because clients subscribe and unsubscribe meanwhile.
        for (event, module), (method, message) in list(self._modules.items()):
            if event == name:
                self._call(module, method, name, value, message)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expected text, got {value!r}")
    return value
