"""Events other than contacts, the edges of sensors, and the contacts that last. All of it happened inside one tick."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.config.steps import Cues
from pepper_driver.controller import Tick
from pepper_driver.observer import Contact, KnownPush, Observation
from pepper_driver.safety import Fault

SensorKind = Literal["touch", "bumper", "button"]
ReflexPhase = Literal["begin", "update", "end"]
CueKind = Literal["say", "leds", "cue"]


@dataclass(frozen=True, kw_only=True, slots=True)
class TickEvent:
    """A tick is over. Its arrays are those of the loop: not to be changed.

    Attributes:
        tick: Measurement, and the reference and command it answers.
        observation: Output of the observer in it; None without an observer.
    """

    tick: Tick
    observation: Observation | None


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorEvent:
    """A touch sensor, bumper or button was pressed or released.

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
        fault: Fault of the safety gate: a ``reason``, and a human-readable ``text``.
        time: Clock of the robot at the last measurement [s].
    """

    fault: Fault
    time: float


@dataclass(frozen=True, kw_only=True, slots=True)
class ReflexEvent:
    """A reflex began or ceased to act, or was given other joints than before.

    Attributes:
        reflex: Its name, with its number where several have this name: ``follow_hand 2``.
        kind: Its class in small letters: ``follow_hand``.
        number: Its place among the reflexes of its name, from 1, in the order in which they are asked.
        phase: ``begin``; ``update``, when the joints that it is given change; ``end``.
        time: Clock of the robot [s].
        contact_id: The contact that set it off; None where it was none.
        joints: Joints whose motion or stiffness it requests.
        held_joints: Those it has; of an ``end``, those that it gives back. Empty while another reflex has them, and
            for a reflex that claims none.
    """

    reflex: str
    kind: str
    number: int
    phase: ReflexPhase
    time: float
    contact_id: int | None
    joints: tuple[str, ...]
    held_joints: tuple[str, ...]


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
    """A request of an experiment to say or show something; subscribers may do so.

    Attributes:
        kind: ``say``, ``leds``, or ``cue``: a word of the author's, for callbacks and the log.
        text: Speech or word; empty for lights.
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

    @classmethod
    def of(cls, cues: Cues, time: float) -> Iterator[CueEvent]:
        """Make the events of all cues that are given at a time [s]."""
        if cues.say is not None:
            yield cls(kind="say", text=cues.say, time=time)
        if (leds := cues.leds) is not None:
            yield cls(
                kind="leds",
                group=leds.group,
                colour=leds.colour,
                duration=leds.duration,
                time=time,
            )
        if cues.cue is not None:
            yield cls(kind="cue", text=cues.cue, time=time)

    def __str__(self) -> str:
        if self.kind != "leds":
            return f"{self.kind}: {self.text}"
        r, g, b = self.colour
        return f"{self.group} to {r:g} {g:g} {b:g}"


@dataclass(frozen=True, kw_only=True, slots=True)
class PushEvent:
    """A simulated robot is about to be pushed, or was spared.

    Attributes:
        link: Where.
        text: Size and length of the push, and the reason if it was left out.
        time: Clock of the robot when the push was ordered [s].
        push: The push; None where it was left out.
    """

    link: str
    text: str
    time: float
    push: KnownPush | None


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
    """Contacts that last: those that have begun and not ended, without rebounds.

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
