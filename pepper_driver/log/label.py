"""Labels: when a touch that someone knows of began and ended, and their place in the log."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Literal, get_args

LabelPhase = Literal["onset", "release"]

LABEL_TOPIC = "/label"


@dataclass(frozen=True, kw_only=True)
class Label:
    """One end of a touch, as a key, a touch sensor or a bumper told it.

    Attributes:
        time: Clock of the robot at the tick in which it was seen [s].
        phase: ``onset`` or ``release``.
        source: What told it: ``key``, ``head``, ``hand-left``, ``hand-right`` or ``bumper``.
        link: What is touched; None where nobody said.
        joint: The last joint of its chain that moves ``link``; None on trunk and base, and where nobody said.
    """

    time: float
    phase: LabelPhase
    source: str
    link: str | None = None
    joint: str | None = None


def label_schema() -> str:
    """JSON schema of ``/label``."""
    properties: dict[str, dict[str, object]] = {
        "time": {"type": "number", "description": "[s]"},
        "phase": {"type": "string", "enum": list(get_args(LabelPhase))},
        "source": {"type": "string"},
        "link": {"type": ["string", "null"]},
        "joint": {"type": ["string", "null"]},
    }
    return json.dumps(
        {
            "title": "pepper_driver.Label",
            "type": "object",
            "properties": properties,
            "required": list(properties),
        }
    )


def label_to_json(label: Label) -> bytes:
    """A label as JSON; floats keep every bit."""
    return json.dumps(asdict(label)).encode()
