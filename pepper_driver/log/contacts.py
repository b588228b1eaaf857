"""The place of contacts in the log."""

from __future__ import annotations

from typing import get_args

from pepper_driver.config.contact_selector import Kind
from pepper_driver.log.json_topic import JsonTopic
from pepper_driver.observer.interface import Contact, Phase

CONTACTS = JsonTopic(
    "/contact",
    Contact,
    {
        "id": {"type": "integer"},
        "phase": {"type": "string", "enum": list(get_args(Phase))},
        "kind": {"type": "string", "enum": list(get_args(Kind))},
        "limb": {"type": "string"},
        "joint": {"type": "string"},
        "link": {"type": "string"},
        "direction": {"type": "integer", "enum": [-1, 1]},
        "intensity": {"type": "number", "description": "[deg]"},
        "torque": {"type": "number", "description": "[N m]"},
        "torque_std": {"type": "number", "description": "[N m]"},
        "onset_time": {"type": "number", "description": "[s]"},
        "detection_time": {"type": "number", "description": "[s]"},
        "time": {"type": "number", "description": "[s]"},
    },
    optional=frozenset({"joint", "torque", "torque_std"}),
)
