"""Faults that can be injected: their catalogue, and the schedule of those that act."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import RLock, Timer
from typing import Literal, Protocol

from pepper_driver.config import ConfigError, PepperError, UnknownNameError, suggestion
from pepper_driver.config.errors import shown

Place = Literal["link", "process", "services", "robot", "start"]
"""Where a fault is: in the network; the NAOqi process as a whole; its services; the robot; only at its start."""

Value = str | float


@dataclass(frozen=True, kw_only=True)
class FaultKind:
    """One switch.

    Attributes:
        place: Who makes it happen.
        effect: What it does to the stand-in.
        source: When a real robot does this, and how that is known.
        arguments: Names in the order in which they may be given, with their defaults, which define the types.
        ranges: Least and most of some of them.
    """

    place: Place
    effect: str
    source: str
    arguments: Mapping[str, Value] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


TIMING: Mapping[str, Value] = {"seconds": math.inf, "after": 0.0}
"""Arguments of all faults but those of the start: how long it lasts, and when it begins, from now on [s]."""

FAULTS: Mapping[str, FaultKind] = {
    "network": FaultKind(
        place="link",
        arguments={"name": "wifi"},
        effect="packets are late as in config/networks; 'clear' is the end of it",
        source="assumed: delays of a cable and of Wi-Fi, not measured on a robot",
    ),
    "blocked": FaultKind(
        place="link",
        effect="nothing arrives in either direction, without an error; it all arrives at the end",
        source="out of reach of Wi-Fi; measured on a disabled interface: libqi notices after 30 s",
    ),
    "cut": FaultKind(
        place="link",
        effect="all connections are closed, new ones at once",
        source="the robot's network is restarted; assumed",
    ),
    "hang": FaultKind(
        place="process",
        effect="SIGSTOP for the NAOqi process, SIGCONT at the end; the DCM and the robot continue",
        source="a module that blocks NAOqi. Assumed: on the robot the DCM is part of NAOqi, and what the boards do "
        "without it is not published",
    ),
    "kill": FaultKind(
        place="process",
        effect="kill -9 of the NAOqi process, a new one at the end; the DCM and the robot continue",
        source="a module that crashes NAOqi. Assumed, as for 'hang'",
    ),
    "stall": FaultKind(
        place="services",
        arguments={"calls": ""},
        effect="calls are answered only at the end; 'DCM' are those of a service, 'DCM.setAlias' of a method, '' all",
        source="a service works one call after the other, and waits for its slowest; measured with libqi",
    ),
    "slow": FaultKind(
        place="services",
        arguments={"delay": 0.05, "calls": ""},
        ranges={"delay": (0.0, 60.0)},
        effect="each call takes this time [s] longer; 'calls' as for 'stall'",
        source="a loaded robot; assumed",
    ),
    "error": FaultKind(
        place="services",
        arguments={"calls": "DCM", "text": "the stand-in refuses this by an injected fault"},
        effect="calls are refused with an error; 'calls' as for 'stall'",
        source="NAOqi refuses with its method and a line of text; the text is assumed",
    ),
    "none": FaultKind(
        place="services",
        arguments={"keys": ""},
        effect="ALMemory answers None for keys that hold this text, '' for all",
        source="getListData is documented to give None for what does not exist (2.5.10, ALMemory)",
    ),
    "missing": FaultKind(
        place="services",
        arguments={"service": "DCM"},
        effect="the service is not there",
        source="NAOqi 2.9 offers no DCM to programs outside; not verified on a robot",
    ),
    "wrong-type": FaultKind(
        place="services",
        arguments={"type": "Nao"},
        effect="the robot says that it is another type",
        source="RobotConfig/Body/Type, getRobotConfig and getRobotType say which robot it is (2.5.10)",
    ),
    "dropped": FaultKind(
        place="robot",
        arguments={"fraction": 1.0},
        effect="in this fraction of the cycles no sample is published: values and DCM/Time stand",
        source="ALMemory on NAOqi 2.8 is said to refresh at 2 Hz; a busy robot; assumed",
        ranges={"fraction": (0.0, 1.0)},
    ),
    "asleep": FaultKind(
        place="robot",
        effect="no motor has power, for any command: brakes hold hip and knee, arms sink, wheels run out",
        source="ALMotion.rest, by the chest button, the fall manager or low battery; "
        "assumed: that a DCM client cannot wake it",
    ),
    "hot": FaultKind(
        place="robot",
        arguments={"joint": "RShoulderPitch", "celsius": 80.0},
        effect="the motor's temperature sensor shows this [deg C]",
        source="Temperature/Sensor/Value (2.5.10); boards that reduce the current are not shown",
    ),
    "disconnected": FaultKind(
        place="robot",
        arguments={"joint": "RShoulderPitch"},
        effect="the joint's sensors stand, its motor has no current",
        source="a broken cable; assumed: that ALMemory keeps the last values. With 'none:JOINT' it has none",
    ),
    "press": FaultKind(
        place="robot",
        arguments={"sensors": "ChestBoard/Button"},
        effect="touch sensors, bumpers or the button on the chest are pressed: one, or several with + in between",
        source="a person, or what the robot drives into; keys of 2.5.10, 'Actuator and sensor names'",
    ),
    "value": FaultKind(
        place="robot",
        arguments={"key": "Battery/Charge/Sensor/Value", "value": 0.0},
        effect="this sensor shows this value",
        source="any sensor can break; keys as in 2.5.10, 'Actuator and sensor names'",
    ),
    "rollover": FaultKind(
        place="start",
        arguments={"in": 5.0},
        ranges={"in": (0.0, 2.0**31 / 1000)},
        effect="the DCM's clock starts so that it rolls over, from 2^31 - 1 to -2^31 ms, after this time",
        source="DCM time has 4 bytes with a sign and 'can roll-over' (2.5.10, DCM)",
    ),
}


@dataclass(frozen=True, kw_only=True)
class InjectedFault:
    """A switch that is set: begins ``after`` [s] from when it was set, and lasts ``seconds`` [s]."""

    name: str
    arguments: Mapping[str, Value]
    after: float = 0.0
    seconds: float = math.inf

    @property
    def kind(self) -> FaultKind:
        """Kind of the fault."""
        return FAULTS[self.name]

    @property
    def all_arguments(self) -> dict[str, Value]:
        """As :func:`make_fault` takes them, times too."""
        return {**self.arguments, "seconds": self.seconds, "after": self.after}

    @property
    def identity(self) -> tuple[str, ...]:
        """Name and texts: a fault takes the place of another that has the same."""
        return (self.name, *(text for text in self.arguments.values() if isinstance(text, str)))


def make_fault(name: str, arguments: Mapping[str, object] | None = None) -> InjectedFault:
    """Return a fault by name; arguments that are not given have their defaults.

    Raises:
        UnknownNameError: No fault of this name.
        ConfigError: It takes no such argument, or not this value.
    """
    if name not in FAULTS:
        raise UnknownNameError("fault", name, FAULTS)
    kind = FAULTS[name]
    takes = {**kind.arguments} if kind.place == "start" else {**kind.arguments, **TIMING}
    given: dict[str, Value] = dict(takes)
    for key, value in (arguments or {}).items():
        if key not in takes:
            raise ConfigError(f"fault '{name}': unknown argument '{key}'{suggestion(key, takes)}")
        given[key] = _checked(name, key, value, takes[key])
    timing = {key: float(given.pop(key)) for key in TIMING if key in given}
    for key, value in timing.items():
        _check_range(name, key, value, 0.0, math.inf)
    for key, (least, most) in kind.ranges.items():
        _check_range(name, key, float(given[key]), least, most)
    return InjectedFault(name=name, arguments=given, **timing)


def parse_fault(text: str) -> InjectedFault:
    """Return a fault as on a command line: ``NAME[:ARGUMENT,...]``, arguments in their order or as ``key=value``.

    For example ``hang:seconds=2,after=5`` or ``slow:0.02,DCM.setAlias``.

    Raises:
        UnknownNameError: No fault of this name.
        ConfigError: It takes no such argument, or not this value.
    """
    if not isinstance(text, str):
        raise ConfigError(f"a fault is a text such as 'hang:seconds=2', got {shown(text)}")
    name, _, rest = text.partition(":")
    if name not in FAULTS:
        raise UnknownNameError("fault", name, FAULTS)
    names: Sequence[str] = [*FAULTS[name].arguments, *TIMING]
    arguments: dict[str, object] = {}
    for number, part in enumerate(rest.split(",") if rest else ()):
        key, given, value = part.partition("=")
        if not given:
            if number >= len(names):
                raise ConfigError(f"fault '{text}': takes no more than {', '.join(names)}")
            key, value = names[number], part
        if key in arguments:
            raise ConfigError(f"fault '{text}': '{key}' is given twice")
        arguments[key] = value
    return make_fault(name, arguments)


def _check_range(fault: str, key: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        allowed = f"from {least:g} to {most:g}" if math.isfinite(most) else f"at least {least:g}"
        raise ConfigError(f"fault '{fault}': {key} must be {allowed}, got {value:g}")


def _checked(fault: str, key: str, value: object, default: Value) -> Value:
    """Return an argument in the type of its default."""
    if isinstance(default, str):
        if isinstance(value, str):
            return value
        raise ConfigError(f"fault '{fault}': {key} must be a text, got {value!r}")
    try:
        number = float(value) if isinstance(value, str | int | float) else math.nan
    except ValueError:
        number = math.nan
    if math.isnan(number):
        raise ConfigError(f"fault '{fault}': {key} must be a number, got {value!r}")
    return number


logger = logging.getLogger("pepper_driver")


@dataclass(eq=False)
class _Entry:
    end: Callable[[], None]
    timers: list[Delayed] = field(default_factory=list)
    begun: bool = False


class Delayed(Protocol):
    """An action to come."""

    def cancel(self) -> None:
        """Keep it from beginning."""


def start_timer(seconds: float, action: Callable[[], None]) -> Delayed:
    """Begin an action after some time, on a thread of its own, which does not keep the process alive."""
    timer = Timer(seconds, action)
    timer.daemon = True
    timer.start()
    return timer


class Schedule:
    """Begins each fault ``after`` some time, at once where that is 0, and ends it after its ``seconds``.

    One takes the place of another of the same name and the same texts, which ends. Safe to use from several threads.

    Args:
        delayed: ``delayed(seconds, action)`` begins an action later.
    """

    def __init__(
        self, delayed: Callable[[float, Callable[[], None]], Delayed] = start_timer
    ) -> None:
        self._lock, self._delayed = RLock(), delayed
        self._entries: dict[tuple[str, ...], _Entry] = {}

    def set(self, fault: InjectedFault, begin: Callable[[], None], end: Callable[[], None]) -> None:
        """Inject a fault.

        Raises:
            PepperError: What ``begin`` raises, where that is called at once. Later it is only logged.
        """
        with self._lock:
            self._finish(fault.identity)
            entry = self._entries[fault.identity] = _Entry(end)
            if fault.after == 0.0:
                self._begin(entry, begin)
            else:
                self._later(entry, fault.after, lambda: self._begin(entry, begin))
            if math.isfinite(fault.seconds):
                at = fault.after + fault.seconds
                self._later(entry, at, lambda: self._finish(fault.identity))

    def clear(self) -> None:
        """End all that have begun; the others never begin."""
        with self._lock:
            for identity in list(self._entries):
                self._finish(identity)

    def close(self) -> None:
        """Leave everything as it is: nothing begins or ends any more."""
        with self._lock:
            for entry in self._entries.values():
                _cancel(entry)
            self._entries.clear()

    def _begin(self, entry: _Entry, begin: Callable[[], None]) -> None:
        begin()
        # Only after success: what did not begin must not be ended.
        entry.begun = True

    def _finish(self, identity: tuple[str, ...]) -> None:
        entry = self._entries.pop(identity, None)
        if entry is not None:
            _cancel(entry)
            if entry.begun:
                entry.end()

    def _later(self, entry: _Entry, seconds: float, action: Callable[[], None]) -> None:
        def act() -> None:
            with self._lock:
                if timer not in entry.timers:
                    return  # cancelled while it waited for the lock
                try:
                    action()
                # On the timer's thread no caller could catch it.
                except PepperError as error:
                    logger.error("%s", error)

        # Within the lock: `act` must find it.
        timer = self._delayed(seconds, act)
        entry.timers.append(timer)


def _cancel(entry: _Entry) -> None:
    for timer in entry.timers:
        # A timer that already waits for the lock is not stopped by this: it finds the list empty.
        timer.cancel()
    entry.timers.clear()
