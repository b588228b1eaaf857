"""The services ``ALAudioDevice`` and ``LogManager``: there, so that programs find them; nothing is heard or logged."""

from __future__ import annotations

import qi

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.modules.motion_calls import switch
from pepper_driver.backends.naoqi_server.motion.body import CallError, number


class AudioService:
    """Loudspeakers and microphones; NAOqi 2.8 page "ALAudioDevice API". Who subscribes is sent no sound."""

    def __init__(self, context: Context) -> None:
        self._record = context.shared.record
        self._volume, self._muted = 50, False
        self._preferences: dict[str, list[object]] = {}
        self._subscribers: set[str] = set()

    def setClientPreferences(
        self, name: object, rate: object, channels: object, deinterleaved: object
    ) -> None:
        """In which form a module wants its sound."""
        self._preferences[str(name)] = [rate, channels, deinterleaved]

    def subscribe(self, name: object) -> None:
        """Send a module sound; there is none."""
        self._subscribers.add(str(name))

    def unsubscribe(self, name: object) -> None:
        """End it."""
        self._subscribers.discard(str(name))

    def setOutputVolume(self, volume: object) -> None:
        """0..100."""
        where = "ALAudioDevice::setOutputVolume"
        level = number(volume, where, "the volume")
        if not 0 <= level <= 100:
            raise CallError(where, f"the volume must be in 0 to 100: {level}")
        self._volume = round(level)

    def getOutputVolume(self) -> int:
        """What was set."""
        return self._volume

    def muteAudioOut(self, mute: object) -> None:
        """Silence the loudspeakers."""
        self._muted = switch(mute, "ALAudioDevice::muteAudioOut")

    def isAudioOutMuted(self) -> bool:
        """Whether they are."""
        return self._muted

    def playSine(self, frequency: object, gain: object, pan: object, duration: object) -> None:
        """A tone that nobody hears."""
        self._record.add("ALAudioDevice", "playSine", frequency, gain, pan, duration)

    def enableEnergyComputation(self) -> None:
        """Measure how loud it is."""

    def disableEnergyComputation(self) -> None:
        """Stop it."""

    def getFrontMicEnergy(self) -> float:
        """Silence."""
        return 0.0

    def getRearMicEnergy(self) -> float:
        """Silence."""
        return 0.0

    def getLeftMicEnergy(self) -> float:
        """Silence."""
        return 0.0

    def getRightMicEnergy(self) -> float:
        """Silence."""
        return 0.0


class LogListener:
    """What ``LogManager.getListener`` returns: connect to its signals. No messages come."""

    def __init__(self) -> None:
        self.onLogMessage = qi.Signal("(m)")
        self.onLogMessages = qi.Signal("(m)")

    def setLevel(self, level: object) -> None:
        """Which messages to send."""

    def addFilter(self, category: object, level: object) -> None:
        """The same of a category."""

    def clearFilters(self) -> None:
        """Forget what was set."""


class LogManagerService:
    """``LogManager``."""

    def __init__(self, context: Context) -> None:
        self._listeners: list[LogListener] = []

    def getListener(self) -> LogListener:
        """An object that tells log messages."""
        self._listeners.append(LogListener())
        return self._listeners[-1]

    def createListener(self) -> LogListener:
        """As ``getListener``."""
        return self.getListener()

    def log(self, messages: object) -> None:
        """Take log messages of somebody; they are not kept."""
