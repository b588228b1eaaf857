"""Names of Pepper's LEDs: groups, short names, actuators. NAOqi 2.8 pages "ALLeds" and "LEDs"."""

from __future__ import annotations

from collections.abc import Iterable

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
    for number, place in enumerate(places):
        made[f"FaceLed{side}{number}"] = eye(side, place)
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
    """The colour of an LED. Those of the ears are blue."""
    return next((colour for colour in COLOURS if f"/{colour}/" in actuator), "Blue")
