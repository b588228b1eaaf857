"""The voice that all services speak with: silent, but it takes its time and tells its events."""

from __future__ import annotations

import re
from threading import Condition, Lock

from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.backends.naoqi_server.modules.calls import Record
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

    def __init__(self, memory: Memory, record: Record, settings: Speech) -> None:
        self._memory, self._record, self._settings = memory, record, settings
        self.language = "English"
        self.parameters = dict(PARAMETERS)
        self._turn = Lock()
        self._changed = Condition()
        self._last = self._stopped = 0
        for event in ("TextStarted", "TextDone", "TextInterrupted"):
            memory.raise_event(PREFIX + event, 0)

    def speak(self, text: str, language: str, service: str) -> None:
        """Say a text for a service; waits until it is said, or stopped."""
        with self._changed:
            number = self._last = self._last + 1
        self._tell("Status", [number, "enqueued"])
        with self._turn:
            self._record.add(service, "say", text, language)
            plain = spoken(text)
            self._tell("CurrentSentence", plain)
            self._tell("Status", [number, "started"])
            self._tell("TextDone", 0)
            self._tell("TextStarted", 1)
            rate = self._settings.characters * self.parameters["speed"] / 100
            seconds = self._settings.start + len(plain) / rate
            with self._changed:
                stopped = self._changed.wait_for(lambda: number <= self._stopped, seconds)
            self._tell("TextInterrupted" if stopped else "TextDone", 1)
            self._tell("TextStarted", 0)
            self._tell("Status", [number, "stopped" if stopped else "done"])

    def stop(self) -> None:
        """End what is being said, and what waits to be."""
        with self._changed:
            self._stopped = self._last
            self._changed.notify_all()

    def _tell(self, event: str, value: object) -> None:
        self._memory.raise_event(PREFIX + event, value)


def spoken(text: str) -> str:
    """What is said of a text: without tags."""
    return " ".join(_TAGS.sub(" ", text).split())
