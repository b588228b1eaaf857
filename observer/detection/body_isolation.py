"""Isolation of contacts on the whole body, and their events: the rules of mode ``fusion``."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count

from pepper_driver.config import ObserverSettings, RobotConfig
from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.robot import TRUNK
from pepper_driver.observer.detection.excursions import (
    TIME_TOLERANCE,
    Excursion,
    JointMonitor,
    Onset,
)
from pepper_driver.observer.interface import (
    INTENSITY_STEP_DEG,
    TORQUE_STEP_STDS,
    Contact,
    JointState,
    Phase,
    Residuals,
)

RELATIVE_RATIO = 0.35
"""Of the chain's largest ratio of residual and threshold: joints that stay below it are only shaken by the contact."""

RATIO_MEMORY = 12
"""Ticks over which the largest ratio of a joint counts."""

REISOLATION_TIMES = (0.05, 0.15)
"""[s] after the alarm, when the joint is named again."""

HOLD_BACK = 0.024
"""[s] For which a contact that the trunk feels is not reported yet: two ticks. The trunk often feels a push on a limb
first, and the limb within this time."""

TRUNK_LINK = "torso"
"""Of a contact that a joint of the legs feels: most of what can be touched above it is trunk."""

BASE_LINK = "base_link"
"""Of a contact that only the wheels feel."""


class BodyContact:
    """A contact that has begun and not ended, on one limb; it has a number once it is reported."""

    def __init__(self, time: float, onset_time: float) -> None:
        self.number: int | None = None
        self.kind: Kind = "contact"
        self.limb = ""
        self.joint: int | None = None
        self.link = ""
        self.sign = 0
        self.peak = 0.0
        self.onset_time = onset_time
        self.alarm_time = time
        self.detection_time = time
        self.report_time = time
        self.reported_peak = 0.0
        self.reported_torque: float | None = None
        self.fall_time: float | None = None
        self.revisions = 0


class _Limb:
    """A chain of joints with its monitors."""

    def __init__(self, joints: Sequence[int], monitors: Sequence[JointMonitor]) -> None:
        self.joints = tuple(joints)
        self.monitors = tuple(monitors)
        self.ratios: deque[list[float]] = deque(maxlen=RATIO_MEMORY)
        self.touch: BodyContact | None = None
        self.explained = False

    def live(self) -> list[Excursion]:
        return [m.excursion for m in self.monitors if m.excursion is not None]


class BodyTracker:
    """Contacts on the whole body: one at a time on each limb, and one on the trunk.

    - On a limb, a contact is on the last joint whose ratio of residual and threshold has exceeded 1 and RELATIVE_RATIO
      of the limb's largest, within the last RATIO_MEMORY ticks: joints beyond the hand are shaken, but less. It is
      named at the alarm, and again REISOLATION_TIMES later; then it stays, unless it goes blind.
    - The trunk carries the limbs: while one is touched, or had been when the trunk's joints began to feel it, what they
      feel belongs to it. A contact that begins on the trunk is reported HOLD_BACK later. If a limb feels it until then,
      it is reported on that limb at once. If a limb feels it later, within the last of REISOLATION_TIMES, it moves
      there and keeps its id.
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
        for name, chain in robot.limbs.items():
            joints = [robot.joint_index(joint) for joint in chain]
            monitors = [JointMonitor(j, settings, onset, settles=True) for j in joints]
            self._limbs[name] = _Limb(joints, monitors)
        # The wheels are the trunk's innermost joint.
        wheels = len(self._names)
        self._trunk = self._limbs[TRUNK]
        self._trunk.joints = (wheels, *self._trunk.joints)
        self._trunk.monitors = (JointMonitor(wheels, settings, onset), *self._trunk.monitors)
        self._outer = [limb for name, limb in self._limbs.items() if name != TRUNK]
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
        """True if a step with all residuals within their thresholds would change nothing."""
        return self._idle

    def step(
        self,
        time: float,
        signal: Residuals,
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
            end = time if touch.fall_time is None else touch.fall_time
            self._end(limb, touch, end, time, events)
            touch = None
        if touch is None:
            if over:
                self._begin(limb, touching or over, time, events)
            return
        news = False
        if over:
            touch.fall_time = None
            news = self._revise(limb, touch, touching or over, time)
        else:
            if touch.fall_time is None:
                touch.fall_time = time
            if not live:
                self._end(limb, touch, touch.fall_time, time, events)
                return
        if touch.number is None:
            if time - touch.alarm_time + TIME_TOLERANCE >= HOLD_BACK:
                if over:
                    self._locate(limb, touch, touching or over)
                self._report(touch, "begin", time, events)
        elif news or (
            over and time - touch.report_time >= self._update_period and self._has_changed(touch)
        ):
            self._report(touch, "update", time, events)

    def _has_changed(self, touch: BodyContact) -> bool:
        """Return True where intensity or torque are no longer what was reported last."""
        if abs(math.degrees(touch.peak - touch.reported_peak)) >= INTENSITY_STEP_DEG:
            return True
        torque, std = self._torque(touch)
        if torque is None or std is None or touch.reported_torque is None:
            return torque is not touch.reported_torque
        return abs(torque - touch.reported_torque) >= TORQUE_STEP_STDS * std

    def _torque(self, touch: BodyContact) -> tuple[float | None, float | None]:
        """Return torque on the joint and its standard deviation [N m]; None where they are unknown."""
        if touch.joint is not None:
            torque = float(self._signal.torque[touch.joint])
            std = float(self._signal.torque_std[touch.joint])
            if torque == torque and std == std:  # not NaN
                return torque, std
        return None, None

    def _end(
        self, limb: _Limb, touch: BodyContact, end: float, time: float, events: list[Contact]
    ) -> None:
        """Report at ``time`` that a contact has ended; one that was held back is reported first."""
        limb.touch = None
        if touch.number is None:
            self._report(touch, "begin", time, events)
        self._report(touch, "end", max(end, touch.report_time), events)

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
            and time - moved.alarm_time <= REISOLATION_TIMES[-1] + TIME_TOLERANCE
        ):
            # What the trunk felt first was the push on this limb.
            limb.touch, trunk.touch, trunk.explained = moved, None, True
            moved.onset_time, moved.fall_time = min(moved.onset_time, first), None
            self._locate(limb, moved, over)
            self._report(moved, "begin" if moved.number is None else "update", time, events)
            return
        touch = limb.touch = BodyContact(time, first)
        if all(excursion.kind == "rebound" for excursion in over):
            touch.kind = "rebound"
        self._locate(limb, touch, over)
        if limb is not trunk or touch.kind == "rebound":
            self._report(touch, "begin", time, events)

    def _revise(
        self, limb: _Limb, touch: BodyContact, over: Sequence[Excursion], time: float
    ) -> bool:
        """Bring a contact up to date; whether there is something to tell."""
        before = (touch.joint, touch.link, touch.kind, touch.sign)
        since = time - touch.alarm_time + TIME_TOLERANCE
        if touch.revisions < len(REISOLATION_TIMES) and since >= REISOLATION_TIMES[touch.revisions]:
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
        return (touch.joint, touch.link, touch.kind, touch.sign) != before

    def _locate(self, limb: _Limb, touch: BodyContact, over: Sequence[Excursion]) -> None:
        """Name joint and link."""
        peaks = [max(column) for column in zip(*limb.ratios, strict=True)]
        bound = RELATIVE_RATIO * max(peaks)
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
            touch.limb, touch.joint = TRUNK, None
            touch.link = TRUNK_LINK if place > 0 else BASE_LINK
            touch.peak = max((e.peak for e in over if e.joint != limb.joints[0]), default=0.0)
        else:
            touch.joint = excursion.joint
            joint = self._robot.joints[excursion.joint]
            touch.limb, touch.link = self._robot.limb_of(joint.name), joint.child

    def _report(self, touch: BodyContact, phase: Phase, time: float, events: list[Contact]) -> None:
        if touch.number is None:
            touch.number, touch.detection_time = self._next_id(), time
        torque, torque_std = self._torque(touch)
        touch.report_time, touch.reported_peak, touch.reported_torque = time, touch.peak, torque
        events.append(
            Contact(
                id=touch.number,
                phase=phase,
                kind=touch.kind,
                limb=touch.limb,
                joint=None if touch.joint is None else self._names[touch.joint],
                link=touch.link,
                direction=-1 if touch.sign > 0 else 1,
                intensity_deg=math.degrees(touch.peak),
                torque=torque,
                torque_std=torque_std,
                onset_time=touch.onset_time,
                detection_time=touch.detection_time,
                time=time,
            )
        )
