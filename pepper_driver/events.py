"""What callbacks are told of, besides contacts. All of it happened inside one tick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pepper_driver.controller import Tick
from pepper_driver.observer import Contact, Observation
from pepper_driver.safety import Fault

SensorKind = Literal["touch", "bumper", "button"]
ReflexPhase = Literal["begin", "end"]


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


Event = Contact | TickEvent | SensorEvent | FaultEvent | ReflexEvent
