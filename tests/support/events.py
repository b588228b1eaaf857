"""Contacts, callbacks and a robot without physics that detects what a test requests."""

import threading
from typing import Any

import numpy as np

from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.config import load_robot
from pepper_driver.controller import Tick
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.reflexes import Reflex
from pepper_driver.robot import Pepper

ROBOT = load_robot()
LONG = 30.0  # [s] only a failing test waits this long


def contact(number: int = 0, **changes: Any) -> Contact:
    values: dict[str, Any] = {
        "id": number,
        "phase": "begin",
        "kind": "contact",
        "limb": ROBOT.limb_of(changes.get("joint", "LElbowRoll")),
        "joint": "LElbowRoll",
        "shown_by": "LElbowRoll",
        "link": "LForeArm",
        "direction": 1,
        "intensity_deg": 3.0,
        "torque": None,
        "torque_std": None,
        "onset_time": 0.0,
        "detection_time": 0.1,
        "time": 0.1,
    }
    return Contact(**(values | changes))


class Blocker:
    """A callback that hangs until released."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.release = threading.Event()
        self.ids: list[int] = []

    def __call__(self, event: Contact) -> None:
        self.entered.set()
        assert self.release.wait(LONG)
        self.ids.append(event.id)


class Scripted(Observer):
    """Detects the contacts it was given, each in its tick, counted from 1."""

    def __init__(self) -> None:
        self.at: dict[int, tuple[Contact, ...]] = {}

    def step(self, tick: Tick) -> Observation:
        nothing = np.zeros(17)
        return Observation(
            contacts=self.at.get(tick.measurement.tick, ()),
            expected=nothing,
            residual=nothing,
            threshold=nothing,
            torque=nothing,
            torque_std=nothing,
            state=np.zeros(17, dtype=np.int8),
        )

    def reset(self) -> None:
        pass

    def describe(self) -> str:
        return "scripted"


def make_pepper(
    at: dict[int, tuple[Contact, ...]] | None = None,
    faults: dict[int, Fault] | None = None,
    reflexes: tuple[Reflex, ...] = (),
    real_time: bool = False,
) -> Pepper:
    """A robot without physics. ``at``: what it detects in which tick; ``faults``: what happens to its measurements."""
    observer = Scripted()
    observer.at = at or {}
    pepper = Pepper("mock", observer=observer, reflexes=reflexes, real_time=real_time)
    pepper.backend = MockBackend(faults=faults)
    return pepper
