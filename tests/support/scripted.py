"""Scripted contacts and reflexes on a robot without physics."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from pepper_driver import Pepper, Reflex
from pepper_driver.backends import Measurement
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.reflexes import ReflexRequests
from support import events

NAN: FloatArray = np.full(17, np.nan)
ON_THE_SHOULDER = {"joint": "LShoulderRoll", "shown_by": "LShoulderRoll", "link": "LBicep"}


def contact(
    number: int,
    phase: Literal["begin", "update", "end"],
    kind: Literal["contact", "collision", "rebound"] = "contact",
) -> Contact:
    return events.contact(number, phase=phase, kind=kind, **ON_THE_SHOULDER)


class Scripted(Observer):
    """Detects what a test requests, at times [s]; each once."""

    def __init__(self, script: dict[float, Contact] | None = None) -> None:
        self._script = dict(script or {})

    def step(self, tick: Tick) -> Observation:
        due = [time for time in self._script if time <= tick.measurement.time]
        nan = np.full(17, np.nan)
        return Observation(
            contacts=tuple(self._script.pop(time) for time in due),
            expected=nan,
            residual=nan,
            threshold=nan,
            torque=nan,
            torque_std=nan,
            state=np.zeros(17, dtype=np.int8),
        )

    def reset(self) -> None:
        pass

    def describe(self) -> str:
        return "scripted"


class Holder(Reflex):
    """Takes the posture over between two times [s]: where the joints are, or as ``change`` makes it of that."""

    _posture: FloatArray | None = None

    def __init__(
        self, begin: float, end: float, change: Callable[[FloatArray], FloatArray] | None = None
    ) -> None:
        super().__init__()
        self._from, self._to, self._change = begin, end, change or (lambda position: position)

    def step(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        if self._from <= measurement.time < self._to:
            if self._posture is None:
                self._posture = self._change(requests.controller.position)
            requests.hold_posture(self._posture, 400.0)

    def reset(self) -> None:
        self._posture = None


def make_pepper(reflex: Reflex, script: dict[float, Contact] | None = None) -> Pepper:
    """A Pepper whose joints are where they are sent, and which detects what a test requests."""
    return Pepper("mock", observer=Scripted(script), reflexes=[reflex])
