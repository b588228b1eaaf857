"""The service ``ALMemory``."""

from __future__ import annotations

import qi

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.front import named
from pepper_driver.backends.naoqi_server.memory import Kind, Value


class Subscriber:
    """What ``subscriber`` returns: connect to its ``signal``."""

    def __init__(self) -> None:
        self.signal = qi.Signal("(m)")


class MemoryService:
    """Data and events of the robot; NAOqi 2.5.10, page "ALMemory API"."""

    def __init__(self, context: Context) -> None:
        self._memory, self._call = context.memory, context.call
        self._subscribers: dict[str, Subscriber] = {}
        self._modules: dict[tuple[str, str], tuple[str, str]] = {}
        self._heard: set[str] = set()

    def getData(self, key: str) -> Value:
        """Value of one key; an error where there is none."""
        return self._memory.get(_text(key))

    @named("getData")
    def _get_data(self, key: str, unused: int) -> Value:
        """As old programs call it."""
        return self.getData(key)

    def getListData(self, keys: object) -> list[Value]:
        """Values of many keys, None where there is none."""
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
        """Whether a key is "Data", an "Event" or a "MicroEvent"."""
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
        """Likewise, with the name of who will raise it."""
        self.declareEvent(name)

    def raiseEvent(self, name: str, value: Value) -> None:
        """Tell a value to all who listen to this event."""
        self._memory.raise_event(_text(name), value)

    def raiseMicroEvent(self, name: str, value: Value) -> None:
        """Likewise for a micro-event."""
        self._memory.raise_event(_text(name), value, "MicroEvent")

    def subscriber(self, name: str) -> Subscriber:
        """An object whose ``signal`` is emitted with the value each time the event is raised."""
        if name not in self._subscribers:
            made = self._subscribers[_text(name)] = Subscriber()
            self._memory.listen(name, made.signal)
        return self._subscribers[name]

    def subscribeToEvent(self, name: str, module: str, method: str) -> None:
        """Call ``method(name, value, "")`` of a service each time the event is raised."""
        self._subscribe(name, module, method, "", "Event")

    @named("subscribeToEvent")
    def _subscribe_to_event(self, name: str, module: str, message: str, method: str) -> None:
        """Likewise, with a message for the method."""
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
        if name not in self._heard:
            self._heard.add(name)
            self._memory.listen(name, lambda value: self._tell(name, value))

    def _tell(self, name: str, value: Value) -> None:
        for (event, module), (method, message) in list(self._modules.items()):
            if event == name:
                self._call(module, method, name, value, message)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expected text, got {value!r}")
    return value
