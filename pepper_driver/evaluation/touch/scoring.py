"""Score of one take for one observer, by the events that a callback gets: each is right, a rebound or false."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.errors import UnknownNameError
from pepper_driver.config.robot import TRUNK
from pepper_driver.evaluation.touch.kinds import true_kinds
from pepper_driver.evaluation.touch.records import (
    BoardLaw,
    ForceEstimate,
    ObserverRecord,
    ReportedEvent,
    RobotRecord,
    Take,
    TorqueEstimate,
    Touched,
)
from pepper_driver.observer.interface import Contact
from pepper_driver.observer.scoring import JOINT_FRACTION

DETECTION_GRACE = 0.3
"""[s] A limb still counts as touched for this long after the release: the joint has not come back yet."""

REBOUND_TIME = 0.8
"""[s] After a release in which an event that calls itself a rebound is one."""

AFTER_RELEASE = 2.5
"""[s] False events until then after a release on the same limb are marked: the touch caused them."""

LATER = 0.15 + 0.012
"""[s] After the alarm. Observers locate a contact again until 150 ms, and report it in the next cycle."""

DIRECTION_FRACTION = 0.2
"""Fraction of the largest torque from which a joint has a direction that can be right or wrong."""

Verdict = Literal["right", "rebound", "open", "false"]


@dataclass(frozen=True, kw_only=True)
class FalseEvent:
    """An event that no touch on its limb explains.

    Attributes:
        time: When the callback got it [s].
        limb, shown_by: As the event has them.
        move: True if a contact moved there, False if it began there.
        rebound: True if it called itself a rebound.
        after_release: True if a touch on the same limb ended DETECTION_GRACE to AFTER_RELEASE before.
        other_touched: True if another limb was touched then.
    """

    time: float
    limb: str
    shown_by: str | None
    move: bool
    rebound: bool
    after_release: bool
    other_touched: bool


@dataclass(frozen=True, kw_only=True)
class LocationScore:
    """Place and direction of a contact at one moment, against the truth; None where there is no truth to compare with.

    Attributes:
        limb: It is on the touched limb.
        joint: Its joint has at least JOINT_FRACTION of the largest torque on the limb's joints. None on the trunk.
        largest_joint: Its joint has the largest. None on the trunk.
        direction: Its sign is that of the torque that acts on its joint then; None below the fraction
            DIRECTION_FRACTION of the largest torque. A hand that holds on to a moving limb pushes and pulls in turn.
            After the release, and where this torque is unknown, it is the largest that acted.
    """

    limb: bool
    joint: bool | None
    largest_joint: bool | None
    direction: bool | None


@dataclass(frozen=True, kw_only=True)
class TouchScore:
    """One touch and the reports on it.

    Attributes:
        touch: The touch.
        detected: True if an event on its limb reported it, from its onset to DETECTION_GRACE after its release.
        delay: From the onset, or from the first tick if it had begun before, to that event [s]; None if not
            detected.
        first_limb: True if the first report of it was on its limb, False if a false contact began on another one
            before. None if nothing was reported.
        alarm, later: Contact that reported it, then and LATER after; an ended one stays where it was. None if not
            detected.
        end_error: End of that contact minus release [s]; None if it is not detected or lasts until the end of the
            take.
        open: True if that contact lasts until the end of the take.
        torques: Pairs of true and estimated torque; empty if not detected.
        force: True and reported force; None if not detected, or none was reported before it faded.
        true_kind: Its kind; None where what the person did has no certain one.
        kind: Last kind of the contact that reported it. A ``grip`` is a contact of its own: of a true one, any contact
            that began on its limb while it acted counts. None if not detected.
    """

    touch: Touched
    detected: bool = False
    delay: float | None = None
    first_limb: bool | None = None
    alarm: LocationScore | None = None
    later: LocationScore | None = None
    end_error: float | None = None
    open: bool = False
    torques: tuple[TorqueEstimate, ...] = ()
    force: ForceEstimate | None = None
    true_kind: Kind | None = None
    kind: Kind | None = None


@dataclass(frozen=True, kw_only=True)
class TakeScore:
    """Score of one take for one observer.

    Attributes:
        suite, state, number, day: Of the take.
        hours: Time in which an alarm could have been false, a mean over the limbs [h].
        touches: All of the take, in their order.
        right, rebounds: Number of events that were right, or rebounds.
        open_limbs: Number of events that left their limb open while another one than theirs was touched.
        false: The other events, in the order of their times.
        idle_contact: Time in contacts where nothing touched their limb, or any limb if they leave it open, rebounds
            left out, summed over contacts [s].
        failure: Reason why the observer has no result: then no touch is detected and there are no hours. Empty if it
            has.
    """

    suite: str
    state: str
    number: int
    day: int | None
    hours: float
    touches: tuple[TouchScore, ...]
    right: int = 0
    rebounds: int = 0
    open_limbs: int = 0
    false: tuple[FalseEvent, ...] = ()
    idle_contact: float = 0.0
    failure: str = ""

    @property
    def false_begins(self) -> int:
        """Number of contacts that began where nothing touched."""
        return sum(not event.move for event in self.false)

    @property
    def false_moves(self) -> int:
        """Number of times that a contact moved to where nothing touched."""
        return sum(event.move for event in self.false)


@dataclass(frozen=True, kw_only=True)
class RobotScore:
    """Scores of all takes of one robot for one observer.

    Attributes:
        robot, law: Of the record.
        failure: Reason why the robot could not be identified; its touches are then not detected. Empty if it could.
        takes: Of the takes that were performed.
        failed_takes: Number of those that could not be performed: they are left out.
        failed_touches: Number of touches planned for these.
    """

    robot: str
    law: BoardLaw | None
    failure: str
    takes: tuple[TakeScore, ...]
    failed_takes: int
    failed_touches: int


def reported_events(
    contacts: Iterable[Contact], true_torques: Iterable[float | None]
) -> tuple[ReportedEvent, ...]:
    """Return the events of an observer that report something new.

    These are begins, ends, and updates with another joint, limb, direction or kind than the event before, or a limb
    that is known now, each with its time.

    Args:
        contacts: Events, each with the time at which a callback gets it.
        true_torques: For each of them, the external torque that acts on its joint then [N m]; None where it is unknown.
    """
    events: list[ReportedEvent] = []
    last: dict[int, tuple[object, ...]] = {}
    for contact, true_torque in zip(contacts, true_torques, strict=True):
        content = (
            contact.joint,
            contact.shown_by,
            contact.limb,
            contact.limb_known,
            contact.direction,
            contact.kind,
        )
        if contact.phase == "update" and last.get(contact.id) == content:
            continue
        last[contact.id] = content
        events.append(
            ReportedEvent(
                id=contact.id,
                phase=contact.phase,
                time=contact.time,
                kind=contact.kind,
                limb=contact.limb,
                limb_known=contact.limb_known,
                joint=contact.joint,
                shown_by=contact.shown_by,
                direction=contact.direction,
                true_torque=true_torque,
            )
        )
    return tuple(events)


def score_robot(record: RobotRecord, observer: str, limbs: Collection[str]) -> RobotScore:
    """Score all takes of a robot.

    Args:
        record: The robot. If its identification failed, no touch is detected.
        observer: Name of the observer.
        limbs: Names of all limbs of the robot.

    Raises:
        UnknownNameError: A take of an identified robot was not observed by it.
    """
    performed = [take for take in record.takes if not take.failure]
    failed = [take for take in record.takes if take.failure]
    return RobotScore(
        robot=record.robot,
        law=record.law,
        failure=record.failure,
        takes=tuple(
            _unobserved(take, record.failure)
            if record.failure
            else score_take(take, observer, limbs)
            for take in performed
        ),
        failed_takes=len(failed),
        failed_touches=sum(len(take.planned) for take in failed),
    )


def score_take(take: Take, observer: str, limbs: Collection[str]) -> TakeScore:
    """Score one performed take for one observer.

    - An event is a begin, or a move: an update to another limb or joint, or one that stops to be a rebound.
    - It is right if it is no rebound and its limb is touched, from the onset to DETECTION_GRACE after the release. A
      rebound is one until REBOUND_TIME after the release of a touch on its limb. One that leaves its limb open is
      neither of them while another limb is touched. Every other event is false.
    - A touch is detected by the first right begin on its limb, or move onto it. Each of these counts for one touch
      only: the one that began last of those not detected yet.
    - Events of a contact without a begin are left out.

    Args:
        take: The take.
        observer: Name of the observer.
        limbs: Names of all limbs of the robot.

    Raises:
        UnknownNameError: The take was not observed by it.
    """
    if observer not in take.hearings:
        raise UnknownNameError("observer", observer, tuple(take.hearings))
    observed = take.hearings[observer]
    if observed.failure:
        return _unobserved(take, observed.failure)
    tracks = _tracks(observed.events)
    alarms = sorted((a for track in tracks for a in _alarms(track)), key=lambda alarm: alarm.time)
    verdicts = [_verdict(alarm, take.touches) for alarm in alarms]
    false = [a for a, verdict in zip(alarms, verdicts, strict=True) if verdict == "false"]
    detected_by: dict[int, _Alarm] = {}
    for alarm, verdict in zip(alarms, verdicts, strict=True):
        if verdict == "right" and alarm.arrives:
            candidates = [
                (touch.onset, number)
                for number, touch in enumerate(take.touches)
                if number not in detected_by
                and touch.limb == alarm.event.limb
                and _within(touch, alarm.time, DETECTION_GRACE)
            ]
            if candidates:
                detected_by[max(candidates)[1]] = alarm
    touched = {limb: _touched(take, limb) for limb in {*limbs, *(t.limb for t in take.touches)}}
    exposed = sum(take.seconds - sum(end - start for start, end in touched[n]) for n in limbs)
    return TakeScore(
        suite=take.suite,
        state=take.state,
        number=take.number,
        day=take.day,
        hours=exposed / len(limbs) / 3600.0,
        touches=tuple(
            replace(
                _score_touch(take, number, detected_by.get(number), false, observed),
                true_kind=kind,
                kind=_reported_kind(kind, touch, detected_by.get(number), tracks),
            )
            for number, (touch, kind) in enumerate(zip(take.touches, true_kinds(take), strict=True))
        ),
        right=verdicts.count("right"),
        rebounds=verdicts.count("rebound"),
        open_limbs=verdicts.count("open"),
        false=tuple(_false_event(alarm, take.touches) for alarm in false),
        idle_contact=sum(_idle(track, touched, _touched(take), take.end) for track in tracks),
    )


@dataclass
class _Track:
    """Events of one contact, its last kind, and its end [s]: None if it lasts until the end of the take."""

    events: list[ReportedEvent]
    kind: Kind
    end: float | None = None

    def at(self, time: float) -> ReportedEvent:
        return next((e for e in reversed(self.events) if e.time <= time), self.events[0])


@dataclass(frozen=True, kw_only=True)
class _Alarm:
    """Event that is judged; ``arrives`` if it is the first of its contact on this limb that is no rebound."""

    event: ReportedEvent
    track: _Track
    move: bool
    arrives: bool

    @property
    def time(self) -> float:
        return self.event.time


def _unobserved(take: Take, failure: str) -> TakeScore:
    return TakeScore(
        suite=take.suite,
        state=take.state,
        number=take.number,
        day=take.day,
        hours=0.0,
        touches=tuple(
            TouchScore(touch=touch, true_kind=kind)
            for touch, kind in zip(take.touches, true_kinds(take), strict=True)
        ),
        failure=failure,
    )


def _tracks(events: Iterable[ReportedEvent]) -> list[_Track]:
    tracks: list[_Track] = []
    lasting: dict[int, _Track] = {}
    for event in events:
        if event.phase == "begin":
            if event.id in lasting:
                lasting[event.id].end = event.time
            lasting[event.id] = _Track([event], event.kind)
            tracks.append(lasting[event.id])
        elif event.id in lasting:
            lasting[event.id].kind = event.kind
            if event.phase == "update":
                lasting[event.id].events.append(event)
            else:
                lasting.pop(event.id).end = event.time
    return tracks


def _alarms(track: _Track) -> Iterable[_Alarm]:
    yield _Alarm(event=track.events[0], track=track, move=False, arrives=True)
    for before, event in zip(track.events, track.events[1:], strict=False):
        turned = before.kind == "rebound" and event.kind != "rebound"
        if turned or _place(event) != _place(before):
            arrives = turned or event.limb != before.limb
            yield _Alarm(event=event, track=track, move=True, arrives=arrives)


def _place(event: ReportedEvent) -> tuple[str | None, ...]:
    return event.limb, event.joint, event.shown_by


def _within(touch: Touched, time: float, after: float) -> bool:
    return touch.onset <= time <= touch.release + after


def _verdict(alarm: _Alarm, touches: Sequence[Touched]) -> Verdict:
    rebound = alarm.event.kind == "rebound"
    time = REBOUND_TIME if rebound else DETECTION_GRACE
    if any(t.limb == alarm.event.limb and _within(t, alarm.time, time) for t in touches):
        return "rebound" if rebound else "right"
    if not alarm.event.limb_known and any(_within(t, alarm.time, DETECTION_GRACE) for t in touches):
        return "open"
    return "false"


def _false_event(alarm: _Alarm, touches: Sequence[Touched]) -> FalseEvent:
    limb, time = alarm.event.limb, alarm.time
    return FalseEvent(
        time=time,
        limb=limb,
        shown_by=alarm.event.shown_by,
        move=alarm.move,
        rebound=alarm.event.kind == "rebound",
        after_release=any(
            t.limb == limb and t.release + DETECTION_GRACE < time <= t.release + AFTER_RELEASE
            for t in touches
        ),
        # Its own limb was not touched, or it would not be false.
        other_touched=any(_within(t, time, DETECTION_GRACE) for t in touches),
    )


def _score_touch(
    take: Take, number: int, alarm: _Alarm | None, false: Sequence[_Alarm], observed: ObserverRecord
) -> TouchScore:
    touch = take.touches[number]
    # Right begins on its limb belong to this touch or to another one; of the false ones this is unknown.
    elsewhere = [
        other.time
        for other in false
        if not other.move
        and other.event.kind != "rebound"
        and _within(touch, other.time, DETECTION_GRACE)
    ]
    if alarm is None:
        return TouchScore(touch=touch, first_limb=False if elsewhere else None)
    track, end = alarm.track, alarm.track.end
    return TouchScore(
        touch=touch,
        detected=True,
        delay=alarm.time - (take.start if touch.standing_start else touch.onset),
        first_limb=not any(time < alarm.time for time in elsewhere),
        alarm=_score_location(alarm.event, touch),
        later=_score_location(track.at(alarm.time + LATER), touch),
        end_error=None if end is None else end - touch.release,
        open=end is None,
        torques=tuple(pair for pair in observed.torques if pair.touch == number),
        force=next((pair for pair in observed.forces if pair.touch == number), None),
    )


def _reported_kind(
    true: Kind | None, touch: Touched, alarm: _Alarm | None, tracks: Sequence[_Track]
) -> Kind | None:
    if alarm is None:
        return None
    if true == "grip":
        for track in tracks:
            first = track.events[0]
            here = first.limb == touch.limb and _within(touch, first.time, DETECTION_GRACE)
            if here and track.kind == "grip":
                return "grip"
    return alarm.track.kind


def _score_location(event: ReportedEvent, touch: Touched) -> LocationScore:
    limb = event.limb == touch.limb
    sizes = {joint: abs(torque) for joint, torque in touch.torque.items()}
    largest = max(sizes.values(), default=0.0)
    if touch.limb == TRUNK or largest == 0.0:
        return LocationScore(limb=limb, joint=None, largest_joint=None, direction=None)
    torque = touch.torque.get(event.joint or "", 0.0)
    now = torque
    if limb and event.true_torque is not None and event.time <= touch.release:
        now = event.true_torque
    directed = abs(now) >= DIRECTION_FRACTION * largest
    return LocationScore(
        limb=limb,
        joint=abs(torque) >= JOINT_FRACTION * largest,
        largest_joint=abs(torque) == largest,
        direction=(now > 0.0) == (event.direction > 0) if directed else None,
    )


def _touched(take: Take, limb: str | None = None) -> list[tuple[float, float]]:
    """Return the times in which a limb, or any, is touched, DETECTION_GRACE included [s]: in order, without overlap."""
    spans: list[tuple[float, float]] = []
    touches = [touch for touch in take.touches if limb is None or touch.limb == limb]
    for touch in sorted(touches, key=lambda t: t.onset):
        start = max(touch.onset, take.start)
        end = min(touch.release + DETECTION_GRACE, take.end)
        if spans and start <= spans[-1][1]:
            spans[-1] = (spans[-1][0], max(spans[-1][1], end))
        elif start < end:
            spans.append((start, end))
    return spans


def _idle(
    track: _Track,
    touched: dict[str, list[tuple[float, float]]],
    anywhere: list[tuple[float, float]],
    take_end: float,
) -> float:
    """Time of a contact on limbs that nothing touches [s]."""
    last = take_end if track.end is None else track.end
    times = [*(event.time for event in track.events), last]
    idle = 0.0
    for event, start, end in zip(track.events, times, times[1:], strict=False):
        # An end is dated back, perhaps before the last update.
        if event.kind != "rebound" and start < end:
            spans = touched.get(event.limb, []) if event.limb_known else anywhere
            idle += end - start
            idle -= sum(max(0.0, min(end, stop) - max(start, begin)) for begin, stop in spans)
    return idle
