"""Which part of the whole body a contact is on, and the events that tell of it: the rules of mode ``fusion``."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count

from pepper_driver.config import ObserverSettings, RobotConfig
from pepper_driver.observer.contact import Contact, Kind, Phase
from pepper_driver.observer.events import TIME_TOLERANCE, Excursion, JointMonitor, Onset
from pepper_driver.observer.interface import JointState
from pepper_driver.observer.signal import Signal

RELATIVE_SHARE = 0.35
"""Of the chain's largest ratio of residual and threshold: joints that stay below it are only shaken by the contact."""

RATIO_MEMORY = 12
"""Ticks over which the largest ratio of a joint counts."""

REVISIONS = (0.05, 0.15)
"""[s] after the alarm, when the joint is named anew."""

TRUNK_LINK = "torso"
"""Of a contact that a joint of the legs feels: most of what can be touched above it is trunk."""

BASE_LINK = "base_link"
"""Of a contact that only the wheels feel."""


class _Touch:
    """A contact that has begun and not ended, on one limb."""

    def __init__(self, number: int, time: float, onset_time: float) -> None:
        self.number = number
        self.kind: Kind = "contact"
        self.joint: int | None = None
        self.link = ""
        self.sign = 0
        self.peak = 0.0
        self.onset_time = onset_time
        self.detection_time = time
        self.told_time = time
        self.fall_time: float | None = None
        self.revisions = 0


class _Limb:
    """A chain of joints with its monitors."""

    def __init__(self, joints: Sequence[int], monitors: Sequence[JointMonitor]) -> None:
        self.joints = tuple(joints)
        self.monitors = tuple(monitors)
        self.ratios: deque[list[float]] = deque(maxlen=RATIO_MEMORY)
        self.touch: _Touch | None = None
        self.explained = False

    def live(self) -> list[Excursion]:
        return [m.excursion for m in self.monitors if m.excursion is not None]


class BodyTracker:
    """Contacts on the whole body: one at a time on each limb, and one on the trunk.

    - On a limb, a contact is on the last joint whose ratio of residual and threshold has exceeded 1 and RELATIVE_SHARE
      of the limb's largest, within the last RATIO_MEMORY ticks: joints beyond the hand are shaken, but less. It is
      named at the alarm, and again REVISIONS later; then it stays, unless it goes blind.
    - The trunk carries the limbs: while one is touched, or had been when the trunk's joints began to feel it, what they
      feel belongs to it. A contact that begins on the trunk moves to a limb that feels it within the last of REVISIONS;
      it keeps its id.
    - A contact becomes a ``collision`` when a residual exceeds ``collision_factor`` times its threshold.
    - A limb that swings back after its contact makes a ``rebound``, with an id of its own.

    Args:
        robot: Its description.
        settings: Times of the events.
        onset: Tells when an excursion began.
    """

    def __init__(self, robot: RobotConfig, settings: ObserverSettings, onset: Onset) -> None:
        self._robot = robot
        self._names = robot.joint_names
        self._collision = settings.collision_factor
        self._update_period = settings.update_period - TIME_TOLERANCE
        self._limbs: dict[str, _Limb] = {}
        for name, chain in robot.chains.items():
            joints = [robot.joint_index(joint) for joint in chain]
            monitors = [JointMonitor(j, settings, onset, settles=True) for j in joints]
            self._limbs[name] = _Limb(joints, monitors)
        # The wheels are the trunk's innermost joint.
        wheels = len(self._names)
        self._trunk = self._limbs["legs"]
        self._trunk.joints = (wheels, *self._trunk.joints)
        self._trunk.monitors = (JointMonitor(wheels, settings, onset), *self._trunk.monitors)
        self._outer = [limb for name, limb in self._limbs.items() if name != "legs"]
        self._next_id: Callable[[], int]
        self.reset()

    def reset(self) -> None:
        """Forget everything; contacts are counted from 1 again."""
        self._next_id = count(1).__next__
        self._idle = True
        for limb in self._limbs.values():
            limb.touch, limb.explained = None, False
            limb.ratios.clear()
            for monitor in limb.monitors:
                monitor.reset()

    @property
    def idle(self) -> bool:
        """Whether nothing is going on: with all residuals within their thresholds, a step would change nothing."""
        return self._idle

    def step(
        self,
        time: float,
        signal: Signal,
        state: list[JointState],
        settled: list[bool],
    ) -> list[Contact]:
        """Take in one tick.

        Args:
            time: Clock of the robot [s], never running back.
            signal: Residuals, thresholds and torques.
            state: (17,) entries are set.
            settled: (17,) entries are set where a contact has ended.

        Returns:
            Events in their order.
        """
        self._signal = signal
        residual = [*signal.residual.tolist(), signal.base_residual]
        threshold, band = [*signal.threshold.tolist(), 1.0], [*signal.band.tolist(), 0.0]
        states, ended = [*state, JointState.BLIND], [*settled, False]
        for limb in self._limbs.values():
            ratios = []
            for joint, monitor in zip(limb.joints, limb.monitors, strict=True):
                states[joint] = monitor.step(time, residual[joint], threshold[joint], band[joint])
                ended[joint] = monitor.settled
                ratio = abs(residual[joint]) / threshold[joint]
                ratios.append(ratio if ratio == ratio else 0.0)
                excursion = monitor.excursion
                if (
                    excursion is not None
                    and excursion.kind == "contact"
                    and ratio > self._collision
                ):
                    excursion.kind = "collision"
            limb.ratios.append(ratios)
        state[:], settled[:] = states[:-1], ended[:-1]
        events: list[Contact] = []
        for limb in self._outer:
            self._follow(limb, time, events)
        self._follow_trunk(time, events)
        self._idle = all(
            limb.touch is None and all(monitor.idle(time) for monitor in limb.monitors)
            for limb in self._limbs.values()
        )
        return events

    def _follow_trunk(self, time: float, events: list[Contact]) -> None:
        trunk = self._trunk
        live = trunk.live()
        if not live:
            trunk.explained = False
        elif trunk.touch is None and any(limb.touch is not None for limb in self._outer):
            trunk.explained = True
        if not trunk.explained:
            self._follow(trunk, time, events)

    def _follow(self, limb: _Limb, time: float, events: list[Contact]) -> None:
        """Events of one limb."""
        live = limb.live()
        over = [excursion for excursion in live if excursion.over]
        touching = [excursion for excursion in over if excursion.kind != "rebound"]
        touch = limb.touch
        if touch is not None and over and (touch.kind == "rebound") == bool(touching):
            self._tell(touch, "end", time if touch.fall_time is None else touch.fall_time, events)
            touch = limb.touch = None
        if touch is None:
            if over:
                self._begin(limb, touching or over, time, events)
            return
        if not over:
            if touch.fall_time is None:
                touch.fall_time = time
            if not live:
                self._tell(touch, "end", touch.fall_time, events)
                limb.touch = None
            return
        touch.fall_time = None
        news = self._revise(limb, touch, touching or over, time)
        if news or time - touch.told_time >= self._update_period:
            self._tell(touch, "update", time, events)

    def _begin(
        self, limb: _Limb, over: Sequence[Excursion], time: float, events: list[Contact]
    ) -> None:
        trunk = self._trunk
        first = min(excursion.onset_time for excursion in over)
        moved = trunk.touch
        if (
            limb is not trunk
            and moved is not None
            and moved.kind != "rebound"
            and time - moved.detection_time <= REVISIONS[-1] + TIME_TOLERANCE
        ):
            # What the trunk felt first was the push on this limb.
            limb.touch, trunk.touch, trunk.explained = moved, None, True
            moved.onset_time, moved.fall_time = min(moved.onset_time, first), None
            self._locate(limb, moved, over)
            self._tell(moved, "update", time, events)
            return
        touch = limb.touch = _Touch(self._next_id(), time, first)
        if all(excursion.kind == "rebound" for excursion in over):
            touch.kind = "rebound"
        self._locate(limb, touch, over)
        self._tell(touch, "begin", time, events)

    def _revise(self, limb: _Limb, touch: _Touch, over: Sequence[Excursion], time: float) -> bool:
        """Bring a contact up to date; whether there is something to tell."""
        before = (touch.joint, touch.link, touch.kind)
        since = time - touch.detection_time + TIME_TOLERANCE
        if touch.revisions < len(REVISIONS) and since >= REVISIONS[touch.revisions]:
            touch.revisions += 1
            self._locate(limb, touch, over)
        elif touch.joint is not None and not any(e.joint == touch.joint for e in limb.live()):
            self._locate(limb, touch, over)
        if touch.kind == "contact" and any(e.kind == "collision" for e in over):
            touch.kind = "collision"
        for excursion in over:
            if excursion.joint == touch.joint or (
                limb is self._trunk and excursion.joint < len(self._names)
            ):
                touch.peak = max(touch.peak, excursion.peak)
        return (touch.joint, touch.link, touch.kind) != before

    def _locate(self, limb: _Limb, touch: _Touch, over: Sequence[Excursion]) -> None:
        """Name joint and link."""
        peaks = [max(column) for column in zip(*limb.ratios, strict=True)]
        bound = RELATIVE_SHARE * max(peaks)
        if limb is not self._trunk:
            bound = max(1.0, bound)
        by_joint = {excursion.joint: excursion for excursion in over}
        places = [
            place
            for place, peak in enumerate(peaks)
            if peak >= bound and (limb is self._trunk or limb.joints[place] in by_joint)
        ]
        place = places[-1] if places else limb.joints.index(over[-1].joint)
        excursion = by_joint.get(limb.joints[place], over[-1])
        touch.sign = excursion.sign
        touch.peak = excursion.peak
        if excursion.kind == "collision" and touch.kind == "contact":
            touch.kind = "collision"
        if limb is self._trunk:
            touch.joint = None
            touch.link = TRUNK_LINK if place > 0 else BASE_LINK
            touch.peak = max((e.peak for e in over if e.joint != limb.joints[0]), default=0.0)
        else:
            touch.joint = excursion.joint
            touch.link = self._robot.joints[excursion.joint].child

    def _tell(self, touch: _Touch, phase: Phase, time: float, events: list[Contact]) -> None:
        touch.told_time = time
        torque = torque_std = None
        if touch.joint is not None:
            value = float(self._signal.torque[touch.joint])
            std = float(self._signal.torque_std[touch.joint])
            if value == value and std == std:
                torque, torque_std = value, std
        events.append(
            Contact(
                id=touch.number,
                phase=phase,
                kind=touch.kind,
                joint=None if touch.joint is None else self._names[touch.joint],
                link=touch.link,
                direction=-1 if touch.sign > 0 else 1,
                intensity=math.degrees(touch.peak),
                torque=torque,
                torque_std=torque_std,
                onset_time=touch.onset_time,
                detection_time=touch.detection_time,
                time=time,
            )
        )
