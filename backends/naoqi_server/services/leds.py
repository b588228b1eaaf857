"""ALLeds: groups of lights and their fading.

Names of Pepper's LEDs: groups, short names, actuators. NAOqi 2.8 pages "ALLeds" and "LEDs".

The service ``ALLeds``; NAOqi 2.8 page "ALLeds API". A user of the DCM: fading is the DCM's own interpolation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from random import Random

from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError, number
from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.backends.naoqi_server.services.calls import blocking
from pepper_driver.backends.naoqi_server.services.context import Context
from pepper_driver.config import suggestion

COLOURS = ("Red", "Green", "Blue")

SIDES = ("Left", "Right")

EYE = tuple(range(0, 360, 45))
"""[deg] Places of the LEDs of an eye."""

EAR = tuple(range(0, 360, 36))
"""[deg] Places of the LEDs of an ear."""

END = "/Actuator/Value"

EYE_PARTS = {"Top": (0, 7), "Bottom": (3, 4), "Internal": (5, 6), "External": (1, 2)}
"""Numbers of a left eye's LEDs in each quarter. Which LED is in which quarter is not documented: CHOSEN."""


def eye(side: str, place: int, colours: Iterable[str] = COLOURS) -> list[str]:
    """Actuators of an LED of an eye, by its number in the short names, from 0."""
    return [f"Face/Led/{colour}/{side}/{EYE[place]}Deg{END}" for colour in colours]


def short_names() -> dict[str, list[str]]:
    """Actuators by short name."""
    names: dict[str, list[str]] = {}
    for side in SIDES:
        for place in range(len(EYE)):
            names[f"{side}FaceLed{place + 1}"] = eye(side, place)
        for place, angle in enumerate(EAR):
            names[f"{side}EarLed{place + 1}"] = [f"Ears/Led/{side}/{angle}Deg{END}"]
    for colour in COLOURS:
        names[f"ChestLeds{colour}"] = [f"ChestBoard/Led/{colour}{END}"]
    return names


def groups() -> dict[str, list[str]]:
    """Actuators by group. A robot's right eye is numbered backwards in the groups of both eyes, as in a mirror."""
    made: dict[str, list[str]] = {}
    for side in SIDES:
        _eye_groups(made, side)
        ears = [f"Ears/Led/{side}/{angle}Deg{END}" for angle in EAR]
        half = len(ears) // 2
        made[f"{side}EarLeds"] = ears
        made[f"{side}EarLedsFront"], made[f"{side}EarLedsBack"] = ears[:half], ears[half:]
        made[f"{side}EarLedsEven"], made[f"{side}EarLedsOdd"] = ears[1::2], ears[0::2]
    for place in range(len(EYE)):
        made[f"FaceLed{place}"] = [*made[f"FaceLedLeft{place}"], *made[f"FaceLedRight{place}"]]
    for part in EYE_PARTS:
        made[f"FaceLeds{part}"] = [*made[f"FaceLedsLeft{part}"], *made[f"FaceLedsRight{part}"]]
    made["FaceLeds"] = [*made["LeftFaceLeds"], *made["RightFaceLeds"]]
    made["EarLeds"] = [*made["LeftEarLeds"], *made["RightEarLeds"]]
    made["ChestLeds"] = [f"ChestBoard/Led/{colour}{END}" for colour in COLOURS]
    made["AllLeds"] = [*made["FaceLeds"], *made["EarLeds"], *made["ChestLeds"]]
    for colour in COLOURS:
        made[f"AllLeds{colour}"] = [name for name in made["AllLeds"] if channel(name) == colour]
    return made


def _eye_groups(made: dict[str, list[str]], side: str) -> None:
    last = len(EYE) - 1
    places = [place if side == "Left" else last - place for place in range(len(EYE))]
    for index, place in enumerate(places):
        made[f"FaceLed{side}{index}"] = eye(side, place)
    for part, numbers in EYE_PARTS.items():
        made[f"FaceLeds{side}{part}"] = [
            name for number in numbers for name in made[f"FaceLed{side}{number}"]
        ]
    made[f"{side}FaceLeds"] = [name for place in range(len(EYE)) for name in eye(side, place)]
    for colour in COLOURS:
        made[f"{side}FaceLeds{colour}"] = [
            name for place in range(len(EYE)) for name in eye(side, place, [colour])
        ]


def channel(actuator: str) -> str:
    """Return the colour of an LED. Those of the ears are blue."""
    return next((colour for colour in COLOURS if f"/{colour}/" in actuator), "Blue")


NAMED = {
    "white": 0xFFFFFF,
    "red": 0xFF0000,
    "green": 0x00FF00,
    "blue": 0x0000FF,
    "yellow": 0xFFFF00,
    "magenta": 0xFF00FF,
    "cyan": 0x00FFFF,
}

RASTA = (0x00FF00, 0xFFFF00, 0xFF0000)

STEP = 0.25
"""[s] from one frame of an animation to the next."""

Colour = tuple[float, float, float]


class LedsService:
    """Lights. Animations take their time; colours that fade too."""

    # By default qi serves one call at a time of a Python object.
    __qi_threading__ = "multi"

    def __init__(self, context: Context) -> None:
        self._robot, self._record = context.robot, context.shared.record
        self._clock = context.clock
        self._prefix = context.config.naoqi.prefix
        self._shorts, self._groups = short_names(), groups()

    def listGroups(self) -> list[str]:
        """Names of the groups."""
        return sorted(self._groups)

    def listGroup(self, name: object) -> list[str]:
        """Actuators of a group."""
        if not isinstance(name, str) or name not in self._groups:
            known = suggestion(str(name), self._groups)
            raise CallError("ALLeds::listGroup", f"unknown group: {name}{known}")
        return self._groups[name]

    def listLEDs(self) -> list[str]:
        """Short names."""
        return sorted(self._shorts)

    def listLED(self, name: object) -> list[str]:
        """Actuators of a short name."""
        return self._actuators(name, "ALLeds::listLED")

    def createGroup(self, name: object, leds: Sequence[object]) -> None:
        """Make a group of LEDs, given by any names."""
        where = "ALLeds::createGroup"
        if not isinstance(name, str) or not isinstance(leds, list | tuple):
            raise CallError(where, "expected a name and a list of LEDs")
        self._groups[name] = [found for led in leds for found in self._actuators(led, where)]

    def getIntensity(self, name: object) -> float:
        """Return the intensity of an LED; of a group the mean."""
        actuators = self._actuators(name, "ALLeds::getIntensity")
        values = [self._robot.value(self._prefix + actuator) for actuator in actuators]
        return sum(values) / len(values)

    def setIntensity(self, name: object, intensity: object) -> None:
        """Set LEDs to an intensity, 0..1, at once."""
        self._all("setIntensity", name, number(intensity, "ALLeds::setIntensity", "the intensity"))

    def on(self, name: object) -> None:
        """Set LEDs to full light."""
        self._all("on", name, 1.0)

    def off(self, name: object) -> None:
        """Switch LEDs off."""
        self._all("off", name, 0.0)

    def reset(self, name: object) -> None:
        """Set LEDs to their default: full light."""
        self._all("reset", name, 1.0)

    @blocking
    def fade(self, name: object, intensity: object, duration: object) -> None:
        """Fade LEDs to an intensity, 0..1; waits."""
        where = "ALLeds::fade"
        level = number(intensity, where, "the intensity")
        seconds = _seconds(duration, where)
        actuators = self._actuators(name, where)
        self._record.add("ALLeds", "fade", name, level, seconds)
        self._light(dict.fromkeys(actuators, level), seconds)
        # The DCM fades by itself: only the caller waits.
        self._clock.sleep(seconds)

    @blocking
    def fadeRGB(self, name: object, *colour_and_duration: object) -> None:
        """Fade LEDs to a colour: (red, green, blue, duration), (name, duration) or (0x00RRGGBB, duration); waits."""
        where = "ALLeds::fadeRGB"
        colour = _colour(colour_and_duration[:-1], where)
        seconds = _seconds(colour_and_duration[-1] if colour_and_duration else None, where)
        actuators = self._actuators(name, where)
        self._record.add("ALLeds", "fadeRGB", name, list(colour), seconds)
        self._paint(actuators, colour, seconds)
        self._clock.sleep(seconds)

    @blocking
    def fadeListRGB(self, name: object, colours: object, times: object) -> None:
        """Fade LEDs through colours 0x00RRGGBB, each reached at its time [s]; waits."""
        where = "ALLeds::fadeListRGB"
        actuators = self._actuators(name, where)
        if not isinstance(colours, list | tuple) or not isinstance(times, list | tuple):
            raise CallError(where, "expected a list of colours and a list of times")
        if len(colours) != len(times):
            raise CallError(where, f"{len(colours)} colours and {len(times)} times")
        self._record.add("ALLeds", "fadeListRGB", name, list(colours), list(times))
        before = 0.0
        for colour, when in zip(colours, times, strict=True):
            seconds = _seconds(when, where) - before
            self._paint(actuators, _colour((colour,), where), max(seconds, 0.0))
            self._clock.sleep(max(seconds, 0.0))
            before += seconds

    @blocking
    def rotateEyes(self, colour: object, rotation: object, duration: object) -> None:
        """One light goes round each eye, once in ``rotation`` [s], for ``duration`` [s]; waits."""
        where = "ALLeds::rotateEyes"
        light, turn = _colour((colour,), where), max(_seconds(rotation, where), STEP)
        seconds = _seconds(duration, where)
        self._record.add("ALLeds", "rotateEyes", colour, turn, seconds)
        for step in range(round(seconds * len(EYE) / turn)):
            self._paint(self._groups["FaceLeds"], (0.0, 0.0, 0.0), 0.0)
            for side in ("Left", "Right"):
                self._paint(eye(side, step % len(EYE)), light, 0.0)
            self._clock.sleep(turn / len(EYE))

    @blocking
    def randomEyes(self, duration: object) -> None:
        """Colours of the eyes change at random for ``duration`` [s]; waits."""
        seconds = _seconds(duration, "ALLeds::randomEyes")
        self._record.add("ALLeds", "randomEyes", seconds)
        random = Random(0)
        for _ in range(round(seconds / STEP)):
            for place in range(len(EYE)):
                for side in ("Left", "Right"):
                    self._paint(
                        eye(side, place), (random.random(), random.random(), random.random()), STEP
                    )
            self._clock.sleep(STEP)

    @blocking
    def rasta(self, duration: object) -> None:
        """Green, yellow and red in turn on all LEDs for ``duration`` [s]; waits."""
        seconds = _seconds(duration, "ALLeds::rasta")
        self._record.add("ALLeds", "rasta", seconds)
        for step in range(round(seconds / STEP)):
            colour = _colour((RASTA[step % len(RASTA)],), "ALLeds::rasta")
            self._paint(self._groups["AllLeds"], colour, STEP)
            self._clock.sleep(STEP)

    def _all(self, method: str, name: object, level: float) -> None:
        actuators = self._actuators(name, f"ALLeds::{method}")
        self._record.add("ALLeds", method, name, level)
        self._light(dict.fromkeys(actuators, level), 0.0)

    def _paint(self, actuators: Sequence[str], colour: Colour, seconds: float) -> None:
        levels = dict(zip(("Red", "Green", "Blue"), colour, strict=True))
        self._light({actuator: levels[channel(actuator)] for actuator in actuators}, seconds)

    def _light(self, levels: Mapping[str, float], seconds: float) -> None:
        """Order intensities, each reached in ``seconds`` from now on."""
        when = wrapped(self._robot.time() + round(1000 * seconds))
        values = [[(min(max(level, 0.0), 1.0), when)] for level in levels.values()]
        # ClearAll: a new colour takes the place of a fade that goes on.
        self._robot.order([self._prefix + actuator for actuator in levels], "ClearAll", values)

    def _actuators(self, name: object, where: str) -> list[str]:
        text = str(name)
        for known in (self._groups, self._shorts):
            if text in known:
                return known[text]
        bare = text.removeprefix(self._prefix)
        if self._prefix + bare in self._robot.actuators and "/Led/" in bare:
            return [bare]
        raise CallError(where, f"unknown LED or group: {name}{suggestion(text, self._groups)}")


def _seconds(value: object, where: str) -> float:
    seconds = number(value, where, "the duration")
    if seconds < 0:
        raise CallError(where, f"the duration must not be negative: {seconds}")
    return seconds


def _colour(given: Sequence[object], where: str) -> Colour:
    """Red, green, blue in 0..1."""
    if len(given) == 3:
        red, green, blue = (number(part, where, "a colour") for part in given)
        return red, green, blue
    if len(given) == 1:
        code = NAMED.get(given[0]) if isinstance(given[0], str) else given[0]
        if code is None:
            raise CallError(where, f"unknown colour: {given[0]} (possible: {', '.join(NAMED)})")
        bits = int(number(code, where, "a colour"))
        return (bits >> 16 & 255) / 255, (bits >> 8 & 255) / 255, (bits & 255) / 255
    raise CallError(where, "expected red, green and blue, a name, or 0x00RRGGBB")
