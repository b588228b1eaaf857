"""Gives a simulated robot its planned contacts, and keeps a record of them for scoring. No estimator sees it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.callbacks.events import PushEvent
from pepper_driver.config import RobotConfig
from pepper_driver.experiments.segments import PlannedContact
from pepper_driver.observer import KnownPush


class ContactSchedule:
    """Contacts that a simulated robot was given.

    Args:
        backend: The robot.
        robot: Its description.

    Attributes:
        pushes: In the order in which they were ordered, in the robot's time.
    """

    def __init__(self, backend: Backend, robot: RobotConfig) -> None:
        self._backend, self._robot = backend, robot
        self.pushes: list[KnownPush] = []

    def order(self, contacts: Iterable[PlannedContact], time: float) -> list[PushEvent]:
        """Order contacts whose delays count from now, at a ``time`` [s]; return the events to report."""
        events = []
        for contact in contacts:
            text, link = str(contact), contact.planned.link
            push = self._push(contact, time)
            try:
                self._order(contact)
            except ValueError as error:  # a hand of an earlier step still holds the link
                text = f"left out: {text}: {error}"
                events.append(PushEvent(link=link, text=text, time=time, push=None))
            else:
                self.pushes.append(push)
                events.append(PushEvent(link=link, text=text, time=time, push=push))
        return events

    def watch(self, time: float) -> None:
        """Mark current contacts whose joint's motor board is at its limit: planning considers the rest state only."""
        if not self.pushes or "truth" not in self._backend.info.capabilities:
            return
        saturated = self._backend.truth.saturated
        if not saturated.any():
            return
        robot = self._robot
        for number, push in enumerate(self.pushes):
            # Of a push on trunk or base no joint is meant: the legs count.
            joints = robot.chains["legs"] if push.joint is None else (push.joint,)
            if push.onset <= time <= push.release and any(
                saturated[robot.joint_index(name)] for name in joints
            ):
                self.pushes[number] = replace(push, saturated=True)

    def _order(self, contact: PlannedContact) -> None:
        planned, grab, backend = contact.planned, contact.grab, self._backend
        if grab is None:
            backend.push(
                planned.link,
                planned.force,
                planned.point,
                contact.duration,
                frame=planned.frame,
                delay=contact.delay,
                **({} if contact.rise is None else {"rise": contact.rise}),
            )
            return
        backend.grab(
            grab.link,
            np.array(grab.pull),
            np.array(grab.xyz),
            stiffness=grab.stiffness,
            rise=grab.rise,
            hold=grab.hold,
            release=grab.release,
            max_force=grab.max_force,
            frame=grab.frame,
            delay=contact.delay,
        )

    def _push(self, contact: PlannedContact, time: float) -> KnownPush:
        planned, onset = contact.planned, time + contact.delay
        robot = self._robot
        limb = robot.limbs[robot.limb_of(planned.joint)]
        return KnownPush(
            joint=planned.joint,
            link=planned.link,
            direction=int(np.sign(planned.torque)),
            force=planned.newtons,
            torque=abs(planned.torque),
            degrees=planned.degrees,
            onset=onset,
            release=onset + contact.duration,
            moving=contact.moving,
            saturating=planned.load > 1.0,
            torques={name: float(planned.torques[robot.joint_index(name)]) for name in limb},
        )
