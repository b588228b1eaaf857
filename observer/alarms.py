"""Contacts from begin to end, put together from the events that tell of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pepper_driver.config import RobotConfig
from pepper_driver.observer.contact import Contact


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """One contact as it was told: ``begin``, the ``updates`` in their order, ``end`` [s].

    While it lasts, ``end`` is the time of the last event.
    """

    begin: Contact
    updates: tuple[Contact, ...]
    end: float

    def at(self, time: float) -> Contact:
        """What was known of the contact at a time [s]: the last event until then; ``begin`` before it."""
        return next((event for event in reversed(self.updates) if event.time <= time), self.begin)

    def limbs(self, until: float, robot: RobotConfig) -> frozenset[str]:
        """The limbs it was put on until a time [s], that of its begin always."""
        told = (self.begin, *(event for event in self.updates if event.time <= until))
        return frozenset(robot.limb_of(event.joint) for event in told)


def alarms_of(contacts: Iterable[Contact]) -> tuple[Alarm, ...]:
    """The contacts that the events of one run tell of, in the order in which they begin.

    Events of a contact whose begin is missing are left out.
    """
    lives: list[list[Contact]] = []
    current: dict[int, list[Contact]] = {}
    for event in contacts:
        if event.phase == "begin":
            current[event.id] = [event]
            lives.append(current[event.id])
        elif event.id in current:
            current[event.id].append(event)
    return tuple(
        Alarm(
            begin=life[0],
            updates=tuple(event for event in life if event.phase == "update"),
            end=life[-1].time,
        )
        for life in lives
    )
