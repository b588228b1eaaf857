"""All reflexes of a robot: who is asked when, and what they have done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pepper_driver.backends import Measurement
from pepper_driver.callbacks.events import ReflexEvent
from pepper_driver.config import RobotConfig
from pepper_driver.observer import Observation
from pepper_driver.reflexes.control import Control
from pepper_driver.reflexes.declared import declare
from pepper_driver.reflexes.ignore import Ignore
from pepper_driver.reflexes.reflex import Reflex, ReflexError


class Reflexes:
    """Asks reflexes in the order of their priority, those of the same one in the order given.

    Args:
        reflexes: Their names are made different by numbers where they are not.
        robot: Its description.

    Raises:
        ReflexError: Something among them is no reflex, or is there twice.
        UnknownNameError: One is for a link or joint that the robot does not have.
    """

    def __init__(self, reflexes: Sequence[Reflex], robot: RobotConfig) -> None:
        for reflex in reflexes:
            if not isinstance(reflex, Reflex):
                raise ReflexError(f"{reflex!r} is no reflex: give objects such as Hold()")
            if sum(other is reflex for other in reflexes) > 1:
                raise ReflexError(f"'{reflex.name}' is given twice: make a second one like it")
        self._reflexes = sorted(reflexes, key=lambda reflex: -reflex.priority)
        self._robot = robot
        self._was_active = [False] * len(self._reflexes)
        for reflex in self._reflexes:
            reflex.prepare(robot)
        names: list[str] = []
        for reflex in self._reflexes:
            alike = sum(name == reflex.name for name in names)
            names.append(reflex.name)
            if alike:
                reflex.name = f"{reflex.name} {alike + 1}"

    @property
    def names(self) -> tuple[str, ...]:
        """As in events and log, in the order in which they are asked."""
        return tuple(reflex.name for reflex in self._reflexes)

    @property
    def all(self) -> tuple[Reflex, ...]:
        """In the order in which they are asked."""
        return tuple(self._reflexes)

    @property
    def declarations(self) -> list[dict[str, Any]]:
        """Each with its arguments, in the same order."""
        return [declare(reflex) for reflex in self._reflexes]

    def __bool__(self) -> bool:
        return bool(self._reflexes)

    def reset(self) -> None:
        """Let go of everything."""
        self._was_active = [False] * len(self._reflexes)
        for reflex in self._reflexes:
            reflex.reset()

    def step(
        self, observation: Observation, measurement: Measurement, control: Control
    ) -> tuple[ReflexEvent, ...]:
        """Ask all of them; what has begun and ended in this tick."""
        control.begin()
        events: list[ReflexEvent] = []
        for number, reflex in enumerate(self._reflexes):
            if isinstance(reflex, Ignore):
                observation = _without(observation, reflex)
                continue
            claimed = control.claimed
            reflex.step(observation, measurement, control)
            if control.claimed is not claimed:
                reflex.had = reflex.had | (control.claimed & ~claimed)
            if reflex.active != self._was_active[number]:
                self._was_active[number] = reflex.active
                events.append(self._event(reflex, measurement.time))
        control.finish()
        return tuple(events)

    def _event(self, reflex: Reflex, time: float) -> ReflexEvent:
        names, contact = self._robot.joint_names, reflex.contact
        return ReflexEvent(
            reflex=reflex.name,
            phase="begin" if reflex.active else "end",
            time=time,
            contact_id=None if contact is None else contact.id,
            joints=tuple(names[joint] for joint in np.flatnonzero(reflex.joints)),
        )


def _without(observation: Observation, ignore: Ignore) -> Observation:
    """The same without the contacts that are ignored; one that turns out to be ignored is over for those below."""
    if not observation.contacts:
        return observation
    left = tuple(
        replace(contact, phase="end") if ignore.is_for(contact) else contact
        for contact in observation.contacts
    )
    return replace(observation, contacts=left)
