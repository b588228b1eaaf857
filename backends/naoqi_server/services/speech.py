"""ALTextToSpeech, ALAnimatedSpeech, audio devices and logs.

The services ``ALTextToSpeech`` and ``ALAnimatedSpeech``; NAOqi 2.8 pages of these names.
"""

from __future__ import annotations

from itertools import count

import qi

from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError, number
from pepper_driver.backends.naoqi_server.services.calls import blocking
from pepper_driver.backends.naoqi_server.services.context import Context, switch
from pepper_driver.config import suggestion

LANGUAGES = {
    "Arabic": "ar_AR",
    "Brazilian": "pt_BR",
    "Chinese": "zh_CN",
    "Czech": "cs_CZ",
    "Danish": "da_DK",
    "Dutch": "nl_NL",
    "English": "en_US",
    "Finnish": "fi_FI",
    "French": "fr_FR",
    "German": "de_DE",
    "Italian": "it_IT",
    "Japanese": "ja_JP",
    "Korean": "ko_KR",
    "Norwegian": "nn_NO",
    "Polish": "pl_PL",
    "Portuguese": "pt_PT",
    "Russian": "ru_RU",
    "Spanish": "es_ES",
    "Swedish": "sv_SE",
    "Turkish": "tr_TR",
}

SPEEDS = (50.0, 400.0)
"""Of the voice, 100 is as usual."""


class SpeechService:
    """``ALTextToSpeech``."""

    # By default qi serves one call at a time of a Python object.
    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._voice, self._clock = context.shared.voice, context.clock
        self._volume, self._name = 1.0, "naoenu"

    @blocking
    def say(self, text: object, *language: object) -> None:
        """Say a text, in a language if one is given; waits until it is said."""
        where = "ALTextToSpeech::say"
        if not isinstance(text, str):
            raise CallError(where, f"expected a text, got {text!r}")
        spoken_in = _language(language[0], where) if language else self._voice.language
        self._voice.speak(text, spoken_in, "ALTextToSpeech")

    def stopAll(self) -> None:
        """End what is being said, and what waits to be."""
        self._voice.stop()

    def setLanguage(self, language: object) -> None:
        """Speak another language from now on."""
        self._voice.language = _language(language, "ALTextToSpeech::setLanguage")

    def getLanguage(self) -> str:
        """Return the language."""
        return self._voice.language

    def locale(self) -> str:
        """Code of the language."""
        return LANGUAGES[self._voice.language]

    def getAvailableLanguages(self) -> list[str]:
        """Languages it speaks."""
        return list(LANGUAGES)

    def getSupportedLanguages(self) -> list[str]:
        """Languages it could speak."""
        return list(LANGUAGES)

    def setVolume(self, volume: object) -> None:
        """0..1."""
        where = "ALTextToSpeech::setVolume"
        level = number(volume, where, "the volume")
        if not 0 <= level <= 1:
            raise CallError(where, f"the volume must be in 0 to 1: {level}")
        self._volume = level

    def getVolume(self) -> float:
        """0..1."""
        return self._volume

    def setParameter(self, name: object, value: object) -> None:
        """Speed, pitch and others of the voice. The speed changes how long a text takes."""
        where = "ALTextToSpeech::setParameter"
        level = number(value, where, str(name))
        if name not in self._voice.parameters:
            known = suggestion(str(name), self._voice.parameters)
            raise CallError(where, f"unknown parameter: {name}{known}")
        if name in ("speed", "defaultVoiceSpeed") and not SPEEDS[0] <= level <= SPEEDS[1]:
            raise CallError(where, f"{name} must be in {SPEEDS[0]:.0f} to {SPEEDS[1]:.0f}: {level}")
        self._voice.parameters[str(name)] = level
        if name == "defaultVoiceSpeed":
            self.resetSpeed()

    def getParameter(self, name: object) -> float:
        """Return the value that was set."""
        if name not in self._voice.parameters:
            raise CallError("ALTextToSpeech::getParameter", f"unknown parameter: {name}")
        return self._voice.parameters[str(name)]

    def resetSpeed(self) -> None:
        """Back to the default speed."""
        self._voice.parameters["speed"] = self._voice.parameters["defaultVoiceSpeed"]

    def getVoice(self) -> str:
        """Name of the voice."""
        return self._name

    def setVoice(self, voice: object) -> None:
        """Another voice; its name is only kept."""
        self._name = str(voice)

    def getAvailableVoices(self) -> list[str]:
        """Names of voices."""
        return [self._name]


class AnimatedSpeechService:
    """``ALAnimatedSpeech``: as ``ALTextToSpeech``; the robot does not move to it."""

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._context, self._clock = context, context.clock
        self._mode = "contextual"
        self._numbers = count(1)

    @blocking
    def say(self, text: object, *configuration: object) -> None:
        """Say a text with annotations; waits until it is said."""
        if not isinstance(text, str):
            raise CallError("ALAnimatedSpeech::say", f"expected a text, got {text!r}")
        voice = self._context.shared.voice
        voice.speak(text, voice.language, "ALAnimatedSpeech")
        self._context.memory.raise_event(
            "ALAnimatedSpeech/EndOfAnimatedSpeech", next(self._numbers)
        )

    def setBodyLanguageModeFromStr(self, mode: object) -> None:
        """disabled, random or contextual; only kept."""
        modes = ("disabled", "random", "contextual")
        if mode not in modes:
            where = "ALAnimatedSpeech::setBodyLanguageModeFromStr"
            raise CallError(where, f"unknown mode: {mode} (possible: {', '.join(modes)})")
        self._mode = str(mode)

    def getBodyLanguageModeToStr(self) -> str:
        """Return the value that was set."""
        return self._mode


def _language(name: object, where: str) -> str:
    if name not in LANGUAGES:
        raise CallError(where, f"unknown language: {name}{suggestion(str(name), LANGUAGES)}")
    return str(name)


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
        """Set the format of a module's sound."""
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
        """Return the value that was set."""
        return self._volume

    def muteAudioOut(self, mute: object) -> None:
        """Silence the loudspeakers."""
        self._muted = switch(mute, "ALAudioDevice::muteAudioOut")

    def isAudioOutMuted(self) -> bool:
        """Return true if it is switched on."""
        return self._muted

    def playSine(self, frequency: object, gain: object, pan: object, duration: object) -> None:
        """Play a tone, silently."""
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
    """Result of ``LogManager.getListener``: connect to its signals. No messages come."""

    def __init__(self) -> None:
        self.onLogMessage = qi.Signal("(m)")
        self.onLogMessages = qi.Signal("(m)")

    def setLevel(self, level: object) -> None:
        """Set the level of messages to send."""

    def addFilter(self, category: object, level: object) -> None:
        """Set the level of a category."""

    def clearFilters(self) -> None:
        """Forget what was set."""


class LogManagerService:
    """``LogManager``."""

    def __init__(self, context: Context) -> None:
        self._listeners: list[LogListener] = []

    def getListener(self) -> LogListener:
        """Return an object that emits log messages."""
        self._listeners.append(LogListener())
        return self._listeners[-1]

    def createListener(self) -> LogListener:
        """As ``getListener``."""
        return self.getListener()

    def log(self, messages: object) -> None:
        """Accept log messages of a client; they are not kept."""
