"""Isolation of contacts on the joints of a chain, and their events. Sec. III and V of the paper."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import count

from pepper_driver.config import ObserverSettings, RobotConfig
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
    """Return the paper's rule: the last joint of the chain whose residual is over the threshold.

    A contact turns the joints between it and the trunk, and none beyond it.

    Args:
        excursions: At least one; of one chain, from the trunk outwards.
    """
    return excursions[-1]


class ChainContact:
    """A contact that has begun and not ended."""

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
        """Put the contact on the joint of ``excursion``."""
        before = self.located
        if (before.joint, before.sign) != (excursion.joint, excursion.sign):
            self.peak = excursion.peak
        self.located = excursion

    def event(self, phase: Phase, time: float, robot: RobotConfig) -> Contact:
        """Return the contact as it stands."""
        self.peak = max(self.peak, self.located.peak)
        self.report_time, self.reported_peak = time, self.peak
        joint = robot.joints[self.located.joint]
        return Contact(
            id=self.number,
            phase=phase,
            kind=self.kind,
            limb=robot.limb_of(joint.name),
            joint=joint.name,
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
    """Contacts on one kinematic chain. Chains are independent of each other; a chain has one contact at a time.

    - A contact begins with the first joint of the chain over its threshold, on the last joint that is over it in that
      tick. All other joints of the chain over theirs, then or later, belong to it: two touches on one chain at a time
      are one contact here.
    - A joint further out that crosses later takes the contact over: an update with the same id. The contact never
      moves inwards, because the inner joints are slower to come back; only if its joint goes blind, it falls to the
      last one that is left.
    - Updates come at once when the contact moves, and not more often than every ``update_period`` when it grows.
    - It ends when all joints of the chain are free or blind; the end bears the time at which the last of them fell
      under its threshold, which lies ``merge_gap`` back.
    - If joints swing back and no other is over its threshold, the contact ends and a rebound begins, a contact with
      its own id. When a joint takes part that does not swing back, or no longer, the rebound ends and a contact begins:
      whoever waits for a touch hears of it.

    Args:
        robot: Its description.
        chain: Joint names from the trunk outwards.
        settings: Times of the events.
        onset: Tells when an excursion began.
        next_id: Gives the number of a new contact.
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
        self._touch: ChainContact | None = None

    @property
    def idle(self) -> bool:
        """True if a step with all residuals within their thresholds would change nothing."""
        return self._touch is None

    def step(
        self,
        time: float,
        residual: Sequence[float],
        threshold: Sequence[float],
        state: list[JointState],
    ) -> list[Contact]:
        """Take in one tick.

        Args:
            time: Clock of the robot [s], never running back.
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
        touch = self._touch
        if touch is not None and over and (touch.kind == "contact") != bool(touching):
            end = time if touch.fall_time is None else touch.fall_time
            events.append(touch.event("end", end, self._robot))
            touch = None
        if touch is None:
            if over:
                kind: Kind = "contact" if touching else "rebound"
                touch = ChainContact(self._next_id(), time, kind, last_in_chain(touching or over))
                events.append(touch.event("begin", time, self._robot))
        elif over:
            news = self._follow(touch, touching or over, state)
            touch.fall_time = None
            grown = math.degrees(touch.located.peak - touch.reported_peak) >= INTENSITY_STEP_DEG
            if news or (grown and time - touch.report_time >= self._update_period):
                events.append(touch.event("update", time, self._robot))
        else:
            if touch.fall_time is None:
                touch.fall_time = time
            if not live:
                events.append(touch.event("end", touch.fall_time, self._robot))
                touch = None
        self._touch = touch
        return events

    def _follow(
        self,
        touch: ChainContact,
        over: Sequence[Excursion],
        state: Sequence[JointState],
    ) -> bool:
        """Bring a contact up to date with the joints over their thresholds; whether it moved or turned round."""
        last = last_in_chain(over)
        joint, sign = touch.located.joint, touch.located.sign
        outwards = self._place[last.joint] - self._place[joint]
        if outwards >= 0 or state[joint] is JointState.BLIND:
            touch.move(last)
        return (touch.located.joint, touch.located.sign) != (joint, sign)

    def reset(self) -> None:
        """Forget everything."""
        self._touch = None
        for monitor in self._monitors:
            monitor.reset()


class ChainTrackers:
    """The trackers of all chains of a robot, which share the numbers of contacts: the rules of mode ``paper``.

    Args:
        robot: Its description.
        settings: Times of the events.
        onset: Tells when an excursion began.
    """

    def __init__(self, robot: RobotConfig, settings: ObserverSettings, onset: Onset) -> None:
        self._chains = [
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
        self, time: float, signal: Residuals, state: list[JointState], settled: list[bool]
    ) -> list[Contact]:
        """Take in one tick; see :meth:`ChainTracker.step`. Nothing settles here: the paper knows no such state."""
        residuals, thresholds = signal.residual.tolist(), signal.threshold.tolist()
        contacts: list[Contact] = []
        for chain in self._chains:
            contacts += chain.step(time, residuals, thresholds, state)
        return contacts
