"""Shared parts of the services: robot, memory, ALMotion, voice."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from threading import Lock
from typing import Any

from pepper_driver.backends.naoqi_server.almotion.engine import MotionEngine
from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError
from pepper_driver.backends.naoqi_server.almotion.postures import Life, Postures, Waking
from pepper_driver.backends.naoqi_server.ipc import Robot
from pepper_driver.backends.naoqi_server.memory import Memory, SensorEvents
from pepper_driver.backends.naoqi_server.service_faults import FaultRouter
from pepper_driver.backends.naoqi_server.services.calls import Record
from pepper_driver.config import RobotConfig, load_naoqi_services
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock
from pepper_driver.config.naoqi_services import Speech

PARAMETERS = {
    "pitchShift": 0.0,
    "doubleVoice": 0.0,
    "doubleVoiceLevel": 0.0,
    "doubleVoiceTimeShift": 0.0,
    "speed": 100.0,
    "defaultVoiceSpeed": 100.0,
    "volume": 80.0,
    "pitch": 100.0,
}

_TAGS = re.compile(r"\\+\w+(?:=[^\\]*)?\\+|\^\w+(?:\([^)]*\))?")
"""Of the voice, with backslashes, and of animations, ``^start(animations/...)``: they are not spoken."""

PREFIX = "ALTextToSpeech/"


class Voice:
    """Says one text after the other. Safe to use from several threads.

    Attributes:
        language: By its English name.
        parameters: Of the voice, by NAOqi's names; ``speed`` 100 is as usual.
    """

    def __init__(self, memory: Memory, record: Record, settings: Speech, clock: Clock) -> None:
        self._memory, self._record, self._settings = memory, record, settings
        self._clock = clock
        self.language = "English"
        self.parameters = dict(PARAMETERS)
        self._lock = Lock()
        self._last = self._stopped = self._said = 0
        for event in ("TextStarted", "TextDone", "TextInterrupted"):
            memory.raise_event(PREFIX + event, 0)

    def speak(self, text: str, language: str, service: str) -> None:
        """Say a text for a service; waits until it is said, or stopped."""
        with self._lock:
            number = self._last = self._last + 1
        self._notify("Status", [number, "enqueued"])
        # A robot has one voice: texts of all services wait for each other.
        self._clock.wait_for(lambda: self._said == number - 1)
        try:
            self._record.add(service, "say", text, language)
            plain = spoken(text)
            self._notify("CurrentSentence", plain)
            self._notify("Status", [number, "started"])
            self._notify("TextDone", 0)
            self._notify("TextStarted", 1)
            rate = self._settings.characters * self.parameters["speed"] / 100
            seconds = self._settings.start + len(plain) / rate
            # By number, because stop() also ends texts that have not begun.
            stopped = self._clock.wait_for(lambda: number <= self._stopped, seconds)
            self._notify("TextInterrupted" if stopped else "TextDone", 1)
            self._notify("TextStarted", 0)
            self._notify("Status", [number, "stopped" if stopped else "done"])
        finally:
            self._said = number

    def stop(self) -> None:
        """End what is being said, and what waits to be."""
        with self._lock:
            self._stopped = self._last

    def _notify(self, event: str, value: object) -> None:
        self._memory.raise_event(PREFIX + event, value)


def spoken(text: str) -> str:
    """Return the spoken part of a text: without tags."""
    return " ".join(_TAGS.sub(" ", text).split())


class Shared:
    """Made once by the server. The writer of ALMotion begins with :meth:`start`.

    Args:
        robot: The robot.
        memory: What ALMemory holds.
        config: What the robot is.
        consent: True if its owner allows safety reflexes to be switched off.
        version: Of NAOqi, as ``ALSystem.systemVersion`` returns it; "" for that of the settings.
        clock: Time of its motions and of what it says.

    Attributes:
        settings: Of the services.
        motion: What ALMotion commands.
        postures: Motions to postures.
        waking: Motors on and off.
        life: Its state and abilities.
        record: Actions without a visible effect.
        voice: That all services speak with.
        version: Of NAOqi.
    """

    def __init__(
        self,
        robot: Robot,
        memory: Memory,
        config: RobotConfig,
        *,
        consent: bool = False,
        version: str = "",
        clock: Clock = MONOTONIC_CLOCK,
    ) -> None:
        self.settings = load_naoqi_services(config)
        self.motion = MotionEngine(robot, config, self.settings, consent=consent, clock=clock)
        self.postures = Postures(self.motion, config, self.settings)
        self.waking = Waking(self.motion, self.postures, memory, self.settings)
        self.life = Life(self.motion)
        self.record = Record(clock)
        self.voice = Voice(memory, self.record, self.settings.speech, clock)
        self.version = version or self.settings.version

    def start(self) -> None:
        """Begin to move the robot."""
        self.motion.start()


@dataclass(frozen=True, kw_only=True)
class Context:
    """Common objects of services.

    Attributes:
        robot: The robot.
        memory: What ALMemory holds; raises events.
        config: What the robot is.
        events: Raises events of its touch sensors.
        faults: Receives the injected faults.
        shared: Common objects of the services of the package ``modules``.
        services: Names of the services that this session offers.
        call: ``call(service, method, *arguments)`` calls a service of this session without waiting for it.
        clock: Time of all that takes time.
    """

    robot: Robot
    memory: Memory
    config: RobotConfig
    events: SensorEvents
    faults: FaultRouter
    shared: Shared
    services: Callable[[], Collection[str]]
    call: Callable[..., Any]
    clock: Clock = MONOTONIC_CLOCK

    def start(self) -> None:
        """Begin to move the robot and to raise events of its sensors."""
        self.events.start()
        self.shared.start()


class MotionCalls:
    """Calls that use the writer of ALMotion. A motion that takes its time does not hold up the others."""

    # By default qi serves one call at a time of a Python object.
    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._shared = context.shared
        self._motion = context.shared.motion
        self._memory, self._clock = context.memory, context.clock


def rising(times: Sequence[float], where: str) -> list[float]:
    """Return the times of a motion [s].

    Raises:
        CallError: They are not positive, or do not rise.
    """
    if not times or times[0] <= 0 or any(a >= b for a, b in pairwise(times)):
        raise CallError(where, f"times must be above 0 and rise: {list(times)}")
    return list(times)


def switch(value: object, where: str) -> bool:
    """Return True or False, also as 1 or 0.

    Raises:
        CallError: It is of another type.
    """
    if value not in (True, False):
        raise CallError(where, f"expected true or false, got {value!r}")
    return bool(value)
