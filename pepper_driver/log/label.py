"""Labels: when a touch that someone knows of began and ended, and their place in the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pepper_driver.log.json_topic import JsonTopic

LabelPhase = Literal["onset", "release"]


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


LABELS = JsonTopic(
    "/label",
    Label,
    {
        "time": {"type": "number", "description": "[s]"},
        "phase": {"type": "string", "enum": list(get_args(LabelPhase))},
        "source": {"type": "string"},
        "link": {"type": "string"},
        "joint": {"type": "string"},
    },
    optional=frozenset({"link", "joint"}),
)
