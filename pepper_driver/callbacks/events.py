"""Events besides contacts, the edges of sensors, and the contacts that last. All of it happened inside one tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.controller import Tick
from pepper_driver.observer import Contact, Observation
from pepper_driver.safety import Fault

SensorKind = Literal["touch", "bumper", "button"]
ReflexPhase = Literal["begin", "end"]
CueKind = Literal["say", "leds"]


@dataclass(frozen=True, kw_only=True, slots=True)
class TickEvent:
    """A tick is over. Its arrays are those of the loop: not to be changed.

    Attributes:
        tick: Measurement, and the reference and command it answers.
        observation: What was felt in it; None without an observer.
    """

    tick: Tick
    observation: Observation | None


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorEvent:
    """A touch sensor, bumper or button was pressed or let go.

    Attributes:
        kind: ``touch``, ``bumper`` or ``button``.
        name: As in ``sensors.yaml``: ``Head/Touch/Front``.
        pressed: Whether it is now.
        time: Clock of the robot [s].
    """

    kind: SensorKind
    name: str
    pressed: bool
    time: float


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultEvent:
    """The robot was stopped, once for all of this run.

    Attributes:
        fault: What the safety gate saw: a ``reason``, and ``text`` for people.
        time: Clock of the robot at the last measurement [s].
    """

    fault: Fault
    time: float


@dataclass(frozen=True, kw_only=True, slots=True)
class ReflexEvent:
    """A reflex began or ceased to act.

    Attributes:
        reflex: Its name.
        phase: ``begin`` or ``end``.
        time: Clock of the robot [s].
        contact_id: The contact that set it off; None where it was none.
        joints: Whose motion or stiffness it takes over.
    """

    reflex: str
    phase: ReflexPhase
    time: float
    contact_id: int | None
    joints: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class StepEvent:
    """A step of a motion or an experiment begins.

    Attributes:
        step: Its name, or its number, from 0, where it has none.
        time: Clock of the robot [s].
    """

    step: str
    time: float


@dataclass(frozen=True, kw_only=True, slots=True)
class CueEvent:
    """An experiment wants something said or shown; who hears of it may do so.

    Attributes:
        kind: ``say`` or ``leds``.
        text: What to say; empty for lights.
        group: Of lights, by NAOqi's name for it; empty for speech.
        colour: (r, g, b), each 0..1.
        duration: In which the lights fade to it [s].
        time: Clock of the robot [s].
    """

    kind: CueKind
    time: float
    text: str = ""
    group: str = ""
    colour: tuple[float, float, float] = (0.0, 0.0, 0.0)
    duration: float = 0.0

    def __str__(self) -> str:
        if self.kind == "say":
            return f"say: {self.text}"
        r, g, b = self.colour
        return f"{self.group} to {r:g} {g:g} {b:g}"


@dataclass(frozen=True, kw_only=True, slots=True)
class PushEvent:
    """A simulated robot is about to be pushed, or was spared.

    Attributes:
        link: Where.
        text: Which push, and why not if not.
        time: Clock of the robot when the push was ordered [s].
    """

    link: str
    text: str
    time: float


ProgramEvent = StepEvent | CueEvent | PushEvent
"""Event of a program that moves the robot; of no stage of a tick."""


@dataclass(frozen=True, slots=True)
class EndEvent:
    """The run is over: no more events will come. For those that wait."""


class SensorEdges:
    """Detection of touch sensors, bumpers and buttons that are pressed or released.

    Args:
        robot: Names the sensors.
        first: What is pressed in it already is no event; its release is one.
    """

    def __init__(self, robot: RobotConfig, first: Measurement) -> None:
        names = (robot.sensors.touch, robot.sensors.bumpers, robot.sensors.buttons)
        kinds = get_args(SensorKind)
        self._sensors = [(kind, n) for kind, of in zip(kinds, names, strict=True) for n in of]
        self._pressed, self._values = [False] * len(self._sensors), b""
        self.step(first)

    def step(self, measurement: Measurement) -> list[SensorEvent]:
        """Return the edges of one tick: touch sensors, bumpers, buttons, each in the order of ``sensors.yaml``."""
        arrays = (measurement.touch, measurement.bumpers, measurement.buttons)
        values = b"".join([array.tobytes() for array in arrays])  # the quickest to compare
        if values == self._values:
            return []
        before, self._values = self._pressed, values
        self._pressed = (np.concatenate(arrays) > 0.5).tolist()  # NaN presses nothing
        return [
            SensorEvent(kind=kind, name=name, pressed=pressed, time=measurement.time)
            for (kind, name), pressed, was in zip(self._sensors, self._pressed, before, strict=True)
            if pressed != was
        ]


class Touches:
    """Contacts that last: those that have begun and not ended. A rebound is none.

    Attributes:
        now: The newest event of each, in the order in which they began. Never changed in place: any thread may read it.
    """

    def __init__(self) -> None:
        self.now: tuple[Contact, ...] = ()

    def step(self, contacts: Sequence[Contact]) -> None:
        """Take in the contact events of one tick."""
        if contacts:
            lasting = {contact.id: contact for contact in self.now}
            for contact in contacts:
                if contact.phase == "end" or contact.kind == "rebound":
                    lasting.pop(contact.id, None)
                else:
                    lasting[contact.id] = contact
            self.now = tuple(lasting.values())
