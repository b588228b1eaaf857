"""Topics of a log in JSON: contacts, labels, events."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Generic, Literal, TypeVar, get_args

import numpy as np

from pepper_driver.backends.simulated import ContactKind, TrueContact
from pepper_driver.callbacks.events import (
    CueEvent,
    ProgramEvent,
    PushEvent,
    ReflexEvent,
    SensorEvent,
    StepEvent,
)
from pepper_driver.config.contact_selector import Kind
from pepper_driver.observer.interface import Contact, Phase

Property = Mapping[str, object]
"""JSON schema of one field. Foxglove refuses a message with any field of more than one type."""

T = TypeVar("T")

_NUMBER: Property = {"type": "number"}
_NUMBERS: Property = {"type": "array", "items": _NUMBER}


class JsonTopic(Generic[T]):
    """Messages of one dataclass. A value of None or not finite is left out: JSON in a browser has no NaN.

    Attributes:
        types: ``string``, ``number``, ``integer``, ``boolean``, ``array`` of text or ``numbers`` by field.

    Args:
        topic: Name of the topic.
        kind: The dataclass; its values are text, numbers, or tuples of them. Numbers in a tuple must be finite.
        properties: Schema of each of its fields.
        optional: Fields that may be None; numbers that are not finite come back as None there, as NaN elsewhere.
    """

    def __init__(
        self,
        topic: str,
        kind: type[T],
        properties: Mapping[str, Property],
        *,
        optional: frozenset[str] = frozenset(),
    ) -> None:
        self.topic = topic
        self.name = kind.__name__
        self.types = {
            name: "numbers" if schema.get("items") == _NUMBER else str(schema["type"])
            for name, schema in properties.items()
        }
        self._kind = kind
        self._names = tuple(field.name for field in fields(kind))  # type: ignore[arg-type]
        self._properties = properties
        self._optional = optional

    @property
    def schema(self) -> str:
        """JSON schema of a message."""
        numbers = {name for name, kind in self.types.items() if kind == "number"}
        return json.dumps(
            {
                "title": f"pepper_driver.{self.name}",
                "type": "object",
                "properties": self._properties,
                "required": [n for n in self._names if n not in self._optional | numbers],
            }
        )

    def encode(self, item: T) -> bytes:
        """Return a message; floats keep every bit.

        Raises:
            TypeError: A value that is neither text nor number.
        """
        values = {name: _plain(getattr(item, name)) for name in self._names}
        present = {
            name: value
            for name, value in values.items()
            if value is not None and not (isinstance(value, float) and not math.isfinite(value))
        }
        return json.dumps(present, allow_nan=False).encode()

    def decode(self, message: bytes) -> T:
        """Return the item of a message.

        Raises:
            TypeError: A value is missing or unknown.
            ValueError: No JSON.
        """
        values: dict[str, Any] = dict.fromkeys(self._optional)
        for name, kind in self.types.items():
            if kind == "number" and name not in self._optional:
                values[name] = math.nan
        for name, value in json.loads(message).items():
            values[name] = tuple(value) if isinstance(value, list) else value
        return self._kind(**values)


def _plain(value: object) -> object:
    """NumPy scalars, as observers may return them, become Python's; arrays are refused."""
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    raise TypeError(f"{value!r} is neither text nor number")


CONTACTS = JsonTopic(
    "/contact",
    Contact,
    {
        "id": {"type": "integer"},
        "phase": {"type": "string", "enum": list(get_args(Phase))},
        "kind": {"type": "string", "enum": list(get_args(Kind))},
        "limb": {"type": "string"},
        "limb_known": {"type": "boolean"},
        "joint": {"type": "string"},
        "shown_by": {"type": "string"},
        "link": {"type": "string"},
        "direction": {"type": "integer", "enum": [-1, 1]},
        "intensity_deg": {"type": "number", "description": "[deg]"},
        "torque": {"type": "number", "description": "[N m]"},
        "torque_std": {"type": "number", "description": "[N m]"},
        "force": {**_NUMBERS, "description": "in base_link [N]"},
        "force_covariance": {**_NUMBERS, "description": "row by row [N2]"},
        "force_interval": {**_NUMBERS, "description": "of its size, 90 % [N]"},
        "point": {**_NUMBERS, "description": "in base_link [m]"},
        "point_covariance": {**_NUMBERS, "description": "row by row [m2]"},
        "scale_known": {"type": "boolean"},
        "onset_time": {"type": "number", "description": "[s]"},
        "detection_time": {"type": "number", "description": "[s]"},
        "time": {"type": "number", "description": "[s]"},
    },
    optional=frozenset(
        {
            "joint",
            "shown_by",
            "torque",
            "torque_std",
            "force",
            "force_covariance",
            "force_interval",
            "point",
            "point_covariance",
            "scale_known",
        }
    ),
)


LabelPhase = Literal["onset", "release"]


@dataclass(frozen=True, kw_only=True)
class Label:
    """One end of a touch, as a key, a touch sensor or a bumper reported it.

    Attributes:
        time: Clock of the robot at the tick in which it was seen [s].
        phase: ``onset`` or ``release``.
        source: Source of the label: ``key``, ``head``, ``hand-left``, ``hand-right`` or ``bumper``.
        link: What is touched; None where the user named no link.
        joint: The last joint of its chain that moves ``link``; None on trunk and base, and where the user named no
            link.
        force: That the person was asked for, with a spring scale [N]; None where it is unknown.
    """

    time: float
    phase: LabelPhase
    source: str
    link: str | None = None
    joint: str | None = None
    force: float | None = None


LABELS = JsonTopic(
    "/label",
    Label,
    {
        "time": {"type": "number", "description": "[s]"},
        "phase": {"type": "string", "enum": list(get_args(LabelPhase))},
        "source": {"type": "string"},
        "link": {"type": "string"},
        "joint": {"type": "string"},
        "force": {"type": "number", "description": "[N]"},
    },
    optional=frozenset({"link", "joint", "force"}),
)


EventKind = Literal["reflex", "fault", "sensor", "step", "cue", "push", "attentive"]
Logged = ReflexEvent | SensorEvent | ProgramEvent
EventPhase = Literal["begin", "update", "end"]


@dataclass(frozen=True, kw_only=True)
class LogEvent:
    """One event.

    Attributes:
        time: Clock of the robot [s].
        kind: A ``reflex`` began or ceased to act, or was given other joints; a ``fault`` stopped the robot; a touch
            ``sensor``, bumper or button was pressed or released; a ``step`` of a motion began; a ``cue`` was given; a
            simulated robot was pushed by ``push``; it began or ceased to be ``attentive``, or a joint became less so.
        name: Of the reflex with its number, the sensor or step, the kind of fault or cue, the link pushed.
        phase: ``begin`` or ``end`` of a reflex, of a press, or of being attentive; ``update`` of a reflex that is given
            other joints, or of a joint that is less attentive; None for what has no duration.
        contact_id: The contact that a reflex answers; None for none.
        joints: Those a reflex acts on.
        held_joints: Those a reflex has; of its end, those that it gives back.
        text: Human-readable detail: why the robot was stopped, or a joint does not oscillate, for example.
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
        """Return the event that callbacks get."""
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


@dataclass(frozen=True, kw_only=True)
class TrueForce:
    """Effect of one object on one link of a simulated robot in one cycle; in the world, as ``TrueContact`` has it.

    Attributes:
        time: Clock of the robot at the end of the cycle, as in ``/truth`` [s].
        kind: A scheduled ``push``, a ``hand`` that holds on, or an ``object`` of the world.
        link: That it acted on.
        object: Name of the object; None for a push or a hand.
        x, y, z: Where it acted [m].
        force_x, force_y, force_z: On the robot, mean over the cycle [N].
        peak: Size of the largest force in a step of physics [N].
    """

    time: float
    kind: ContactKind
    link: str
    object: str | None = None
    x: float
    y: float
    z: float
    force_x: float
    force_y: float
    force_z: float
    peak: float

    @classmethod
    def of(cls, contact: TrueContact, time: float) -> TrueForce:
        """Return what the truth of a cycle that ended at ``time`` [s] says of one contact."""
        (x, y, z), force = map(float, contact.point), contact.force
        return cls(
            time=time,
            kind=contact.kind,
            link=contact.link,
            object=contact.object,
            x=x,
            y=y,
            z=z,
            force_x=float(force[0]),
            force_y=float(force[1]),
            force_z=float(force[2]),
            peak=float(contact.peak),
        )


FORCES = JsonTopic(
    "/force",
    TrueForce,
    {
        "time": {"type": "number", "description": "[s]"},
        "kind": {"type": "string", "enum": list(get_args(ContactKind))},
        "link": {"type": "string"},
        "object": {"type": "string"},
        **{axis: {"type": "number", "description": "[m]"} for axis in "xyz"},
        **{f"force_{axis}": {"type": "number", "description": "[N]"} for axis in "xyz"},
        "peak": {"type": "number", "description": "[N]"},
    },
    optional=frozenset({"object"}),
)
