"""Events: what happened in a run besides contacts, and their place in the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pepper_driver.callbacks.events import (
    CueEvent,
    ProgramEvent,
    PushEvent,
    ReflexEvent,
    SensorEvent,
    StepEvent,
)
from pepper_driver.log.json_topic import JsonTopic

EventKind = Literal["reflex", "fault", "sensor", "step", "cue", "push", "attentive"]
Logged = ReflexEvent | SensorEvent | ProgramEvent
EventPhase = Literal["begin", "update", "end"]


@dataclass(frozen=True, kw_only=True)
class LogEvent:
    """One thing that happened.

    Attributes:
        time: Clock of the robot [s].
        kind: A ``reflex`` began or ceased to act, or was given other joints; a ``fault`` stopped the robot; a touch
            ``sensor``, bumper or button was pressed or let go; a ``step`` of a motion began; a ``cue`` was given; a
            simulated robot was told to ``push`` itself; the robot began or ceased to be ``attentive``.
        name: Of the reflex with its number, the sensor or step, the kind of fault or cue, the link pushed.
        phase: ``begin`` or ``end`` of a reflex, of a press, or of being attentive; ``update`` of a reflex that is given
            other joints; None for what has no duration.
        contact_id: The contact that a reflex answers; None for none.
        joints: Those a reflex acts on.
        held_joints: Those a reflex has; of its end, those that it gives back.
        text: More, for people: why the robot was stopped, for example.
    """

    time: float
    kind: EventKind
    name: str = ""
    phase: EventPhase | None = None
    contact_id: int | None = None
    joints: tuple[str, ...] = ()
    held_joints: tuple[str, ...] = ()
    text: str = ""

    @classmethod
    def of(cls, event: Logged) -> LogEvent:
        """The same as the callbacks are told of."""
        if isinstance(event, SensorEvent):
            phase: EventPhase = "begin" if event.pressed else "end"
            return cls(time=event.time, kind="sensor", name=event.name, phase=phase)
        if isinstance(event, StepEvent):
            return cls(time=event.time, kind="step", name=event.step)
        if isinstance(event, CueEvent):
            return cls(time=event.time, kind="cue", name=event.kind, text=str(event))
        if isinstance(event, PushEvent):
            return cls(time=event.time, kind="push", name=event.link, text=event.text)
        return cls(
            time=event.time,
            kind="reflex",
            name=event.reflex,
            phase=event.phase,
            contact_id=event.contact_id,
            joints=event.joints,
            held_joints=event.held_joints,
        )


EVENTS = JsonTopic(
    "/event",
    LogEvent,
    {
        "time": {"type": "number", "description": "[s]"},
        "kind": {"type": "string", "enum": list(get_args(EventKind))},
        "name": {"type": "string"},
        "phase": {"type": "string", "enum": list(get_args(EventPhase))},
        "contact_id": {"type": "integer"},
        "joints": {"type": "array", "items": {"type": "string"}},
        "held_joints": {"type": "array", "items": {"type": "string"}},
        "text": {"type": "string"},
    },
    optional=frozenset({"phase", "contact_id"}),
)
