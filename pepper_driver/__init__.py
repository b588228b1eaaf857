"""Touch detection for the Pepper humanoid: where, when and how hard it is touched, from joint encoders alone."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pepper_driver.callbacks.events import (
        CueEvent,
        FaultEvent,
        PushEvent,
        ReflexEvent,
        SensorEvent,
        StepEvent,
        TickEvent,
    )
    from pepper_driver.config import PepperError
    from pepper_driver.experiments.experiment import ExperimentRun
    from pepper_driver.observer import Contact, Observation, Observer
    from pepper_driver.reflexes import (
        Assist,
        Comply,
        FollowHand,
        Hold,
        Ignore,
        Reflex,
        Retract,
        Soften,
        StopBase,
    )
    from pepper_driver.robot import Pepper
    from pepper_driver.safety import FaultError, FaultReason, RobotState

__all__ = [
    "Assist",
    "Comply",
    "Contact",
    "CueEvent",
    "ExperimentRun",
    "FaultError",
    "FaultEvent",
    "FaultReason",
    "FollowHand",
    "Hold",
    "Ignore",
    "Observation",
    "Observer",
    "Pepper",
    "PepperError",
    "PushEvent",
    "Reflex",
    "ReflexEvent",
    "Retract",
    "RobotState",
    "SensorEvent",
    "Soften",
    "StepEvent",
    "StopBase",
    "TickEvent",
]

# Looked up when first used: every layer imports this package first, and most need only those below.
_HOMES = {
    "Assist": "pepper_driver.reflexes",
    "Comply": "pepper_driver.reflexes",
    "Contact": "pepper_driver.observer",
    "CueEvent": "pepper_driver.callbacks.events",
    "ExperimentRun": "pepper_driver.experiments.experiment",
    "FaultError": "pepper_driver.safety",
    "FaultEvent": "pepper_driver.callbacks.events",
    "FaultReason": "pepper_driver.safety",
    "FollowHand": "pepper_driver.reflexes",
    "Hold": "pepper_driver.reflexes",
    "Ignore": "pepper_driver.reflexes",
    "Observation": "pepper_driver.observer",
    "Observer": "pepper_driver.observer",
    "Pepper": "pepper_driver.robot",
    "PepperError": "pepper_driver.config",
    "PushEvent": "pepper_driver.callbacks.events",
    "Reflex": "pepper_driver.reflexes",
    "ReflexEvent": "pepper_driver.callbacks.events",
    "Retract": "pepper_driver.reflexes",
    "RobotState": "pepper_driver.safety",
    "SensorEvent": "pepper_driver.callbacks.events",
    "Soften": "pepper_driver.reflexes",
    "StepEvent": "pepper_driver.callbacks.events",
    "StopBase": "pepper_driver.reflexes",
    "TickEvent": "pepper_driver.callbacks.events",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'pepper_driver' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
