"""Isolation of contacts on the joints of a chain, and their events: Sec. III and V of the paper."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import count

from pepper_driver.config import ObserverSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.observer.detection.excursions import (
    TIME_TOLERANCE,
    Excursion,
    JointMonitor,
    Onset,
)
from pepper_driver.observer.interface import (
    INTENSITY_STEP_DEG,
    Contact,
    JointState,
    Phase,
    Residuals,
)


def last_in_chain(excursions: Sequence[Excursion]) -> Excursion:
    """Return the last joint of the chain whose residual exceeds its threshold: the rule of the paper.

    A contact turns the joints between it and the trunk, and none beyond it.

    Args:
        excursions: At least one; of one chain, from the trunk outwards.
    """
    return excursions[-1]


class ChainContact:
    """Contact on one chain that has begun and not ended."""

    def __init__(self, number: int, time: float, kind: Kind, located: Excursion) -> None:
        self.number = number
        self.kind = kind
        self.located = located
        self.peak = located.peak
        self.onset_time = located.onset_time
        self.detection_time = time
        self.report_time = time
        self.reported_peak = located.peak
        self.fall_time: float | None = None

    def move(self, excursion: Excursion) -> None:
        """Move the contact to the joint of ``excursion``."""
        before = self.located
        if (before.joint, before.sign) != (excursion.joint, excursion.sign):
            self.peak = excursion.peak
        self.located = excursion

    def event(self, phase: Phase, time: float, robot: RobotConfig) -> Contact:
        """Return an event with the present state of the contact."""
        self.peak = max(self.peak, self.located.peak)
        self.report_time, self.reported_peak = time, self.peak
        joint = robot.joints[self.located.joint]
        return Contact(
            id=self.number,
            phase=phase,
            kind=self.kind,
            limb=robot.limb_of(joint.name),
            joint=joint.name,
            shown_by=joint.name,
            link=joint.child,
            direction=-1 if self.located.sign > 0 else 1,
            intensity_deg=math.degrees(self.peak),
            torque=None,
            torque_std=None,
            onset_time=self.onset_time,
            detection_time=self.detection_time,
            time=time,
        )


class ChainTracker:
    """Tracker of contacts on one kinematic chain. Chains are independent; a chain has one contact at a time.

    - A contact begins when the first joint of the chain exceeds its threshold, on the last joint that exceeds it in
      that tick. All other joints that exceed theirs, then or later, belong to it: two touches on one chain at a time
      are one contact.
    - A joint further out that exceeds its threshold later takes the contact over: an update with the same id. The
      contact never moves inwards, because the inner joints return more slowly. If its joint becomes blind, it moves to
      the last joint that exceeds its threshold.
    - Updates come at once when the contact moves, and at most once per ``update_period`` when it grows.
    - It ends when all joints of the chain are free or blind. The end has the time at which the last of them fell below
      its threshold, which is ``merge_gap`` earlier.
    - If joints swing back and no other exceeds its threshold, the contact ends and a rebound begins, with its own id.
      When a joint exceeds its threshold that does not swing back, the rebound ends and a contact begins: a program that
      waits for a touch must receive it.

    Args:
        robot: Its description.
        chain: Joint names from the trunk outwards.
        settings: Times of the events.
        onset: Function that gives the time when an excursion began.
        next_id: Function that gives the number of a new contact.
    """

    def __init__(
        self,
        robot: RobotConfig,
        chain: Sequence[str],
        settings: ObserverSettings,
        onset: Onset,
        next_id: Callable[[], int],
    ) -> None:
        self._robot = robot
        self.joints = tuple(robot.joint_index(name) for name in chain)
        self._place = {joint: place for place, joint in enumerate(self.joints)}
        self._monitors = [JointMonitor(joint, settings, onset) for joint in self.joints]
        self._update_period = settings.update_period - TIME_TOLERANCE
        self._next_id = next_id
        self._contact: ChainContact | None = None

    @property
    def idle(self) -> bool:
        """True if a step with all residuals within their thresholds would change nothing."""
        return self._contact is None

    def step(
        self,
        time: float,
        residual: Sequence[float],
        threshold: Sequence[float],
        state: list[JointState],
    ) -> list[Contact]:
        """Take in one tick.

        Args:
            time: Clock of the robot [s], not decreasing.
            residual: (17,) filtered r of all joints [rad], NaN for blind ones.
            threshold: (17,) [rad].
            state: (17,) entries of this chain's joints are set.

        Returns:
            Events of this chain, in their order.
        """
        live = []
        for joint, monitor in zip(self.joints, self._monitors, strict=True):
            state[joint] = monitor.step(time, residual[joint], threshold[joint])
            if monitor.excursion is not None:
                live.append(monitor.excursion)
        over = [excursion for excursion in live if excursion.over]
        touching = [excursion for excursion in over if excursion.kind == "contact"]
        events = []
        contact = self._contact
        # A rebound ends when a joint is pushed, and a contact when its joints only swing back.
        if contact is not None and over and (contact.kind == "contact") != bool(touching):
            end = time if contact.fall_time is None else contact.fall_time
            events.append(contact.event("end", end, self._robot))
            contact = None
        if contact is None:
            if over:
                kind: Kind = "contact" if touching else "rebound"
                contact = ChainContact(self._next_id(), time, kind, last_in_chain(touching or over))
                events.append(contact.event("begin", time, self._robot))
        elif over:
            changed = self._update_contact(contact, touching or over, state)
            contact.fall_time = None
            grown = math.degrees(contact.located.peak - contact.reported_peak) >= INTENSITY_STEP_DEG
            if changed or (grown and time - contact.report_time >= self._update_period):
                events.append(contact.event("update", time, self._robot))
        else:
            if contact.fall_time is None:
                contact.fall_time = time
            if not live:
                events.append(contact.event("end", contact.fall_time, self._robot))
                contact = None
        self._contact = contact
        return events

    def _update_contact(
        self,
        contact: ChainContact,
        over: Sequence[Excursion],
        state: Sequence[JointState],
    ) -> bool:
        """Update a contact by the joints over their thresholds; return True if joint or direction changed."""
        last = last_in_chain(over)
        joint, sign = contact.located.joint, contact.located.sign
        outwards = self._place[last.joint] - self._place[joint]
        if outwards >= 0 or state[joint] is JointState.BLIND:
            contact.move(last)
        return (contact.located.joint, contact.located.sign) != (joint, sign)

    def reset(self) -> None:
        """Forget everything."""
        self._contact = None
        for monitor in self._monitors:
            monitor.reset()


class ChainTrackers:
    """Trackers of all chains of a robot, which share the numbers of contacts: rules of mode ``paper``.

    Args:
        robot: Its description.
        settings: Times of the events.
        onset: Function that gives the time when an excursion began.
    """

    def __init__(self, robot: RobotConfig, settings: ObserverSettings, onset: Onset) -> None:
        self._chains = [
            # A lambda, because `reset` replaces the counter.
            ChainTracker(robot, chain, settings, onset, lambda: next(self._ids))
            for chain in robot.chains.values()
        ]
        self.reset()

    def reset(self) -> None:
        """Forget everything; contacts are counted from 1 again."""
        self._ids = count(1)
        for chain in self._chains:
            chain.reset()

    @property
    def idle(self) -> bool:
        """True if a step with all residuals within their thresholds would change nothing."""
        return all(chain.idle for chain in self._chains)

    def step(
        self,
        time: float,
        residuals: Residuals,
        position: FloatArray,
        state: list[JointState],
        settled: list[bool],
    ) -> list[Contact]:
        """Take in one tick; see :meth:`ChainTracker.step`. ``settled`` stays: the paper has no such state.

        Nor has it forces, for which ``position`` is needed.
        """
        residual, threshold = residuals.residual.tolist(), residuals.threshold.tolist()
        contacts: list[Contact] = []
        for chain in self._chains:
            contacts += chain.step(time, residual, threshold, state)
        return contacts
