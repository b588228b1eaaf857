"""The services ``ALTextToSpeech`` and ``ALAnimatedSpeech``; NAOqi 2.8 pages of these names."""

from __future__ import annotations

from itertools import count

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.modules.calls import blocking
from pepper_driver.backends.naoqi_server.motion.body import CallError, number
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

    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._voice = context.shared.voice
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
        """The language."""
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
        """What was set."""
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
        self._context = context
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
        """What was set."""
        return self._mode


def _language(name: object, where: str) -> str:
    if name not in LANGUAGES:
        raise CallError(where, f"unknown language: {name}{suggestion(str(name), LANGUAGES)}")
    return str(name)
