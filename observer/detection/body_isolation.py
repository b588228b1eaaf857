"""Isolation of contacts on the whole body, and their events: rules of mode ``fusion``."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count

from pepper_driver.config import ObserverSettings, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.robot import TRUNK
from pepper_driver.observer.constants import (
    PUSH_TICKS,
    QUIET_RATIO,
    REPORT_DELAY,
    SETTLING_TICKS,
)
from pepper_driver.observer.detection.contact_force import ContactForce, ForceEstimator
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

REISOLATION_TIMES = (0.05, 0.15)
"""[s] after the detection, when the joint is determined again."""

SIGN_STDS = 2.0
"""Standard deviations of a torque beyond which its sign is known at the detection."""

COLLISION_TIME = 0.1
"""[s] from the onset until which a collision reaches its size: a hand that pushes is slower."""

TAP_TIME = 0.35
"""[s] A contact that is over sooner was a tap."""

DOUBLE_TAP_TIME = 0.8
"""[s] from the end of a tap to the beginning of another one that makes it a double tap."""

HOLD_TIME = 2.0
"""[s] after which a push is a hold."""

GRIP_TIME = 0.5
"""[s] from the end of a push to the beginning of one the other way: the same hand pulls and pushes."""

TRUNK_LINK = "torso"
"""Link of a contact that a joint of the legs detects: most of the surface above it belongs to the trunk."""

BASE_LINK = "base_link"
"""Link of a contact that only the wheels detect."""


class BodyContact:
    """Contact on one limb that has begun and not ended; its number is None until it is reported."""

    def __init__(self, time: float, onset_time: float, *, driving: bool) -> None:
        self.number: int | None = None
        self.kind: Kind = "contact"
        self.limb, self.limb_known = "", True
        self.driving = driving
        self.joint: int | None = None
        self.shown_by: int | None = None
        self.shown_sign = 0
        self.link = ""
        self.sign = 0
        self.peak = 0.0
        self.onset_time = onset_time
        self.begin_time = time
        self.detection_time = time
        self.report_time = time
        self.reported_peak = 0.0
        self.reported_torque: FloatArray | None = None
        self.fall_time: float | None = None
        self.revisions = 0
        self.force: ContactForce | None = None
        self.fit_time: float | None = None


class _Limb:
    """Joints of a limb with their monitors, from the trunk outwards."""

    def __init__(self, joints: Sequence[int], monitors: Sequence[JointMonitor]) -> None:
        self.joints = tuple(joints)
        self.monitors = tuple(monitors)
        self.ratios: deque[list[float]] = deque(maxlen=PUSH_TICKS)
        self.contact: BodyContact | None = None
        self.last: BodyContact | None = None
        self.last_end = 0.0
        self.explained = False

    def live(self) -> list[Excursion]:
        return [m.excursion for m in self.monitors if m.excursion is not None]

    def live_joints(self) -> list[int]:
        return [excursion.joint for excursion in self.live()]


class BodyTracker:
    """Tracker of contacts on the whole body: one at a time on each limb, and one on the trunk.

    - On a limb, a contact is on the link of the last joint whose largest ratio of residual and threshold exceeds 1 and
      QUIET_RATIO of the limb's largest. The last PUSH_TICKS ticks count. Joints beyond the contact are shaken, but
      less. The link is determined at the detection and again REISOLATION_TIMES later. Then it changes only when the
      residual of its joint is over while another one lasts.
    - The joint that is named is the one on which the force of the contact has the largest torque: friction may hide
      this torque. At the detection only torques count whose sign is known. It is the joint that carries the link on a
      joint of a hand, where no force can be fitted, and where no sign is known.
    - The trunk carries the limbs. Residuals of its joints belong to the contact on a limb if that contact exists now,
      existed when they began, or ended at most ``rebound_window`` before. A touch that no joint of a limb shows
      shakes the trunk in the same way: the limb of a contact there is not known.
    - A contact that begins on the trunk is reported REPORT_DELAY later. If a limb detects it until then, it is
      reported on that limb at once. If a limb detects it later, within the last of REISOLATION_TIMES, it moves there
      and keeps its id.
    - A contact becomes a ``collision`` when a residual exceeds ``collision_factor`` times its threshold; a ``push``
      after TAP_TIME, a ``hold`` after HOLD_TIME. One that ends before was a ``tap``, or a ``double tap``. A push that
      follows one the other way is a ``grip``.
    - One that begins just before the base drives is none: the wheels answer sooner than the joints.
    - A limb that swings back after its contact causes a ``rebound``, with an id of its own.

    Args:
        robot: Its description.
        settings: Times of the events.
        onset: Function that gives the time when an excursion began.
        forces: Estimate of forces.
    """

    def __init__(
        self,
        robot: RobotConfig,
        settings: ObserverSettings,
        onset: Onset,
        forces: ForceEstimator,
    ) -> None:
        self._robot, self._forces = robot, forces
        self._names = robot.joint_names
        self._hands = frozenset(robot.joint_index(name) for name in robot.hands.joints)
        self._collision = settings.collision_factor
        self._rebound_window = settings.rebound_window + TIME_TOLERANCE
        self._update_period = settings.update_period - TIME_TOLERANCE
        self._limbs: dict[str, _Limb] = {}
        for name, chain in robot.limbs.items():
            joints = [robot.joint_index(joint) for joint in chain]
            settling = SETTLING_TICKS * robot.cycle
            monitors = [JointMonitor(j, settings, onset, settling_time=settling) for j in joints]
            self._limbs[name] = _Limb(joints, monitors)
        # The wheels are the innermost joint of the trunk: their residual counts as that of one joint more.
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
            limb.contact, limb.last, limb.explained = None, None, False
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
        residuals: Residuals,
        position: FloatArray,
        state: list[JointState],
        settled: list[bool],
    ) -> list[Contact]:
        """Take in one tick.

        Args:
            time: Clock of the robot [s], not decreasing.
            residuals: Residuals, thresholds and torques.
            position: (17,) measured [rad].
            state: (17,) entries are set.
            settled: (17,) entries are set where a contact has ended.

        Returns:
            Events in their order.
        """
        self._residuals, self._position = residuals, position
        if self._idle:
            # An idle tracker need not be stepped: what it saw before is of another time.
            for limb in self._limbs.values():
                limb.ratios.clear()
        base, swinging = residuals.base_residual, self._trunk.monitors[0].excursion
        if swinging is not None and swinging.kind != "rebound":
            # A pushed base swings: what follows is no push the other way.
            base = math.copysign(base, swinging.sign)
        residual = [*residuals.residual.tolist(), base]
        threshold, band = (
            [*residuals.threshold.tolist(), 1.0],
            [*residuals.friction_band.tolist(), 0.0],
        )
        states, ended = [*state, JointState.BLIND], [*settled, False]
        idle = True
        for limb in self._limbs.values():
            ratios = []
            for joint, monitor in zip(limb.joints, limb.monitors, strict=True):
                size = abs(residual[joint])
                ratio = size / threshold[joint]
                ratios.append(ratio if ratio == ratio else 0.0)  # 0 for NaN
                # Most joints: a step would change nothing. NaN compares as False.
                if size <= threshold[joint] and monitor.idle:
                    states[joint], monitor.settled = JointState.FREE, False
                    continue
                states[joint] = monitor.step(time, residual[joint], threshold[joint], band[joint])
                ended[joint] = monitor.settled
                idle = idle and monitor.idle
                excursion = monitor.excursion
                if (
                    excursion is not None
                    and excursion.kind == "contact"
                    and ratio > self._collision
                    and time - excursion.onset_time <= COLLISION_TIME + TIME_TOLERANCE
                ):
                    excursion.kind = "collision"
            limb.ratios.append(ratios)
        state[:], settled[:] = states[:-1], ended[:-1]
        events: list[Contact] = []
        # Limbs before the trunk: a contact on one of them explains the residuals of the trunk in the same tick.
        for limb in self._outer:
            self._update_limb(limb, time, events)
        self._update_trunk(time, events)
        self._idle = idle and all(limb.contact is None for limb in self._limbs.values())
        return events

    def _update_trunk(self, time: float, events: list[Contact]) -> None:
        trunk = self._trunk
        live = trunk.live()
        if not live:
            trunk.explained = False
        elif trunk.contact is None and any(self._touched(limb, time) for limb in self._outer):
            trunk.explained = True
        elif trunk.contact is not None and self._drove_off(trunk.contact):
            trunk.contact, trunk.explained = None, True
        if not trunk.explained:
            self._update_limb(trunk, time, events)

    def _touched(self, limb: _Limb, time: float) -> bool:
        """Return True if a limb is touched, or was just let go: this shakes the trunk as well."""
        if limb.contact is not None:
            return True
        return limb.last is not None and time - limb.last_end <= self._rebound_window

    def _drove_off(self, contact: BodyContact) -> bool:
        """Return True for a contact on the standing base that drives before it is reported: a command has moved it.

        Wheels may answer sooner than joints, and commands are paired with the answers of joints.
        """
        return self._residuals.base_drives and not contact.driving and contact.number is None

    def _update_limb(self, limb: _Limb, time: float, events: list[Contact]) -> None:
        """Append the events of one limb."""
        live = limb.live()
        if not live and limb.contact is None:
            return
        over = [excursion for excursion in live if excursion.over]
        touching = [excursion for excursion in over if excursion.kind != "rebound"]
        contact = limb.contact
        # A rebound ends when a joint is pushed, and a contact when its joints only swing back.
        if contact is not None and over and (contact.kind == "rebound") == bool(touching):
            end = time if contact.fall_time is None else contact.fall_time
            self._end(limb, contact, end, time, events)
            contact = None
        if contact is None:
            if over:
                self._begin(limb, touching or over, time, events)
            return
        changed = False
        if over:
            contact.fall_time = None
            changed = self._revise(limb, contact, touching or over, time)
        else:
            if contact.fall_time is None:
                # A joint that friction holds was let go before.
                falls = [m.fall_time for m in limb.monitors if m.settled]
                falls += [e.fall_time for e in live if e.fall_time is not None]
                contact.fall_time = max(falls, default=time)
            if not live:
                self._end(limb, contact, contact.fall_time, time, events)
                return
        if contact.number is None:
            if time - contact.begin_time + TIME_TOLERANCE >= REPORT_DELAY:
                if over:
                    self._locate(limb, contact, touching or over, time)
                self._report(contact, "begin", time, events)
        elif changed or (
            over
            and time - contact.report_time >= self._update_period
            and self._has_changed(limb, contact)
        ):
            self._report(contact, "update", time, events)

    def _has_changed(self, limb: _Limb, contact: BodyContact) -> bool:
        """Return True if the intensity, or the torque of a joint, differs enough from that reported last."""
        if abs(math.degrees(contact.peak - contact.reported_peak)) >= INTENSITY_STEP_DEG:
            return True
        if contact.joint is None or contact.reported_torque is None:
            return False
        torque, std = self._residuals.torque, self._residuals.torque_std
        if math.isfinite(torque[contact.joint]) != math.isfinite(
            contact.reported_torque[contact.joint]
        ):
            return True
        # All joints of the limb: the force on it follows from them. NaN compares as False.
        return any(
            abs(torque[j] - contact.reported_torque[j]) >= TORQUE_STEP_STDS * std[j]
            for j in limb.joints
        )

    def _torque(self, contact: BodyContact) -> tuple[float | None, float | None]:
        """Return torque on the joint and its standard deviation [N m], both None if unknown."""
        if contact.force is not None and contact.joint in contact.force.torques:
            return contact.force.torques[contact.joint]
        if contact.joint is not None:
            torque = float(self._residuals.torque[contact.joint])
            std = float(self._residuals.torque_std[contact.joint])
            if torque == torque and std == std:  # not NaN
                return torque, std
        return None, None

    def _end(
        self, limb: _Limb, contact: BodyContact, end: float, time: float, events: list[Contact]
    ) -> None:
        """Report the end of a contact; if its begin was delayed, report it first."""
        limb.contact = None
        if contact.number is None:
            self._report(contact, "begin", time, events)
        if contact.kind == "contact" and end - contact.onset_time <= TAP_TIME:
            before = limb.last
            twice = before is not None and before.kind == "tap"
            twice = twice and contact.onset_time - limb.last_end <= DOUBLE_TAP_TIME
            contact.kind = "double tap" if twice else "tap"
        if contact.kind != "rebound":
            limb.last, limb.last_end = contact, end
        # The residual fell before the end is known; an end must not precede an event that was reported since.
        self._report(contact, "end", max(end, contact.report_time), events)

    def _begin(
        self, limb: _Limb, over: Sequence[Excursion], time: float, events: list[Contact]
    ) -> None:
        trunk = self._trunk
        first = min(excursion.onset_time for excursion in over)
        moved = trunk.contact
        if (
            limb is not trunk
            and moved is not None
            and moved.kind != "rebound"
            and time - moved.begin_time <= REISOLATION_TIMES[-1] + TIME_TOLERANCE
        ):
            # The trunk has detected the push on this limb first.
            limb.contact, trunk.contact, trunk.explained = moved, None, True
            moved.onset_time, moved.fall_time = min(moved.onset_time, first), None
            self._locate(limb, moved, over, time)
            self._report(moved, "begin" if moved.number is None else "update", time, events)
            return
        contact = limb.contact = BodyContact(time, first, driving=self._residuals.base_drives)
        if all(excursion.kind == "rebound" for excursion in over):
            contact.kind = "rebound"
        self._locate(limb, contact, over, time)
        last = limb.last
        if (
            contact.kind == "contact"
            and last is not None
            and last.kind in ("push", "hold", "grip")
            and last.shown_sign == -contact.shown_sign
            and last.shown_by == contact.shown_by
            and first - limb.last_end <= GRIP_TIME
        ):
            contact.kind = "grip"
        if limb is not trunk or contact.kind == "rebound":
            self._report(contact, "begin", time, events)

    def _revise(
        self, limb: _Limb, contact: BodyContact, over: Sequence[Excursion], time: float
    ) -> bool:
        """Update a contact; return True if there is a change to report."""
        before = (contact.joint, contact.link, contact.kind, contact.sign)
        since = time - contact.begin_time + TIME_TOLERANCE
        if (
            contact.revisions < len(REISOLATION_TIMES)
            and since >= REISOLATION_TIMES[contact.revisions]
        ):
            contact.revisions += 1
            self._locate(limb, contact, over, time)
        elif contact.shown_by is not None and contact.shown_by not in limb.live_joints():
            self._locate(limb, contact, over, time)
        if contact.kind == "contact" and any(e.kind == "collision" for e in over):
            contact.kind = "collision"
        lasted = time - contact.onset_time
        if contact.kind == "contact" and lasted > TAP_TIME:
            contact.kind = "push"
        elif contact.kind == "push" and lasted > HOLD_TIME:
            contact.kind = "hold"
        for excursion in over:
            if excursion.joint == contact.shown_by or (
                limb is self._trunk and excursion.joint < len(self._names)
            ):
                contact.peak = max(contact.peak, excursion.peak)
        return (contact.joint, contact.link, contact.kind, contact.sign) != before

    def _locate(
        self, limb: _Limb, contact: BodyContact, over: Sequence[Excursion], time: float
    ) -> None:
        """Determine joint and link of a contact."""
        peaks = [max(column) for column in zip(*limb.ratios, strict=True)]
        bound = QUIET_RATIO * max(peaks)
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
        contact.sign = contact.shown_sign = excursion.sign
        contact.peak = excursion.peak
        if excursion.kind == "collision" and contact.kind == "contact":
            contact.kind = "collision"
        if limb is self._trunk:
            contact.limb, contact.limb_known = TRUNK, False
            contact.joint = contact.shown_by = None
            contact.link = TRUNK_LINK if place > 0 else BASE_LINK
            contact.peak = max((e.peak for e in over if e.joint != limb.joints[0]), default=0.0)
        else:
            contact.joint = contact.shown_by = excursion.joint
            joint = self._robot.joints[excursion.joint]
            contact.limb, contact.link = self._robot.limb_of(joint.name), joint.child
            contact.limb_known = True
            self._fit_force(contact, time)
            if contact.force is not None and excursion.joint not in self._hands:
                # A wrist that is pushed shows sooner than the shoulder, and leaves the direction open.
                known = 0.0 if contact.revisions else SIGN_STDS
                named = contact.force.largest(known)
                if named is not None:
                    contact.joint = named
                    contact.sign = -1 if contact.force.torques[named][0] > 0.0 else 1

    def _fit_force(self, contact: BodyContact, time: float) -> None:
        """Fit a force to the torques of this tick."""
        if contact.limb == TRUNK or contact.kind == "rebound" or contact.fit_time == time:
            return
        contact.fit_time = time
        usable = ~self._residuals.doubtful
        usable[self._limbs[contact.limb].live_joints()] = True
        force = self._forces.estimate(
            contact.limb,
            self._residuals.torque,
            self._residuals.torque_std,
            usable,
            self._position,
        )
        if force is not None:
            contact.force = force

    def _report(
        self, contact: BodyContact, phase: Phase, time: float, events: list[Contact]
    ) -> None:
        if contact.number is None:
            contact.number, contact.detection_time = self._next_id(), time
        if phase != "end":
            self._fit_force(contact, time)
        torque, torque_std = self._torque(contact)
        contact.report_time, contact.reported_peak = time, contact.peak
        contact.reported_torque = self._residuals.torque
        event = Contact(
            id=contact.number,
            phase=phase,
            kind=contact.kind,
            limb=contact.limb,
            limb_known=contact.limb_known,
            joint=None if contact.joint is None else self._names[contact.joint],
            shown_by=None if contact.shown_by is None else self._names[contact.shown_by],
            link=contact.link,
            direction=-1 if contact.sign > 0 else 1,
            intensity_deg=math.degrees(contact.peak),
            torque=torque,
            torque_std=torque_std,
            onset_time=contact.onset_time,
            detection_time=contact.detection_time,
            time=time,
        )
        events.append(event if contact.force is None else _with_force(event, contact.force))


def _with_force(contact: Contact, force: ContactForce) -> Contact:
    """Return a contact with its force."""
    x, y, z = force.vector.tolist()
    px, py, pz = force.point.tolist()
    return replace(
        contact,
        force=(x, y, z),
        force_covariance=tuple(force.covariance.ravel().tolist()),
        force_interval=force.interval,
        point=(px, py, pz),
        point_covariance=tuple(force.point_covariance.ravel().tolist()),
        scale_known=force.scale_known,
    )
