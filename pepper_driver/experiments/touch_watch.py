"""Watches for touches that become as a trigger says."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from pepper_driver.callbacks.filters import meets
from pepper_driver.config import RobotConfig
from pepper_driver.config.contact_selector import TouchTrigger
from pepper_driver.observer import Contact


class TouchWatch:
    """Detects when touches that begin from now on satisfy a trigger; each touch counts once.

    Args:
        trigger: Checked already.
        robot: Its description.

    Attributes:
        fired: True once the trigger has been met.
    """

    def __init__(self, trigger: TouchTrigger, robot: RobotConfig) -> None:
        trigger.check(robot)
        self._trigger = trigger
        # To the nearest cycle, as all times of steps.
        self._lasting = trigger.lasting - robot.cycle / 2
        self._within = (trigger.within or 0.0) + robot.cycle / 2
        self._begun: dict[int, float] = {}  # touches that have not counted yet
        self._chosen: set[int] = set()  # those of them that are as chosen, by their newest event
        self._touches: deque[float] = deque(maxlen=trigger.touches)
        self.fired = False

    def step(self, contacts: Sequence[Contact], time: float) -> bool:
        """Take in the contact events of a tick at a time [s]; return True where the trigger is met in it."""
        met = False
        for contact in contacts:
            if contact.phase == "begin":
                self._begun[contact.id] = time
            if contact.phase == "end":
                self._forget(contact.id)
            elif contact.id in self._begun and meets(contact, self._trigger):
                self._chosen.add(contact.id)
                met |= self._count(contact.id, time)
            else:
                self._chosen.discard(contact.id)
        for contact_id in tuple(self._chosen):
            met |= self._count(contact_id, time)
        self.fired |= met
        return met

    def _count(self, contact_id: int, time: float) -> bool:
        """Count a touch that has lasted long enough; return True where as many as it takes have come."""
        touches, begun = self._touches, self._begun[contact_id]
        if time - begun < self._lasting:
            return False
        self._forget(contact_id)
        touches.append(begun)
        enough = len(touches) == self._trigger.touches
        if not enough or max(touches) - min(touches) > self._within:
            return False
        touches.clear()
        return True

    def _forget(self, contact_id: int) -> None:
        self._begun.pop(contact_id, None)
        self._chosen.discard(contact_id)
