"""Scores of all robots of a split, pooled for each observer: what the page of results says."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple, TypeVar, get_args

import numpy as np

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.robot import TRUNK
from pepper_driver.config.touch_suites import EVEN, TouchSuites
from pepper_driver.evaluation.touch.kinds import UNKNOWN_IN_LOGS, UNSHARPENED
from pepper_driver.evaluation.touch.ledger import MainResults
from pepper_driver.evaluation.touch.n90 import N90, ForceTouch, n90
from pepper_driver.evaluation.touch.observers import FUSION
from pepper_driver.evaluation.touch.records import LOG, BoardLaw, RobotRecord, Touched
from pepper_driver.evaluation.touch.scoring import (
    AFTER_RELEASE,
    FalseEvent,
    LocationScore,
    RobotScore,
    TakeScore,
    TouchScore,
    score_robot,
)
from pepper_driver.evaluation.touch.states import STATES
from pepper_driver.evaluation.touch.summary_data import (
    ALL,
    EARLY,
    FAST_RISE,
    FORCE_PLACES,
    FORCE_TOLERANCE,
    GROUPS,
    OTHER_ARM,
    PARTS,
    STRONG,
    STRONG_FORCE,
    UNKNOWN,
    WEIGHT_ARM,
    By,
    Cell,
    Delays,
    Ends,
    FalseContacts,
    FalseGroup,
    ForceFraction,
    Forces,
    Fraction,
    Kinds,
    Located,
    LoweredForces,
    ObserverSummary,
    Quantiles,
    Rate,
    RestAndMotion,
    RobotResults,
    RobotSummary,
    RowFraction,
    Suite,
    Torques,
    TouchSummary,
)

T = TypeVar("T")

LOWERED = 0.97
"""Fraction of the force asked for; one below it was lowered."""

MIN_FORCE_TIME = 0.3
"""[s] From the onset to the fading of a force, below which its estimate does not count: a tap is over before."""

FORCE_STEP = 0.1
"""[N] Forces are rounded to it for N90."""

MIN_N90_FORCES = 4
"""Different forces of a row of the suites below which it has no N90."""


class _One(NamedTuple):
    """One touch and the reports on it."""

    robot: str
    law: str
    state: str
    score: TouchScore
    alone: bool

    @property
    def touch(self) -> Touched:
        return self.score.touch

    @property
    def main(self) -> bool:
        return self.touch.row in (EVEN, LOG)


class _Judged(NamedTuple):
    """One robot under one observer."""

    law: str
    score: RobotScore
    touches: tuple[_One, ...]


def group_of(state: str) -> str:
    """Return the group of a state, or the state if it is in none."""
    return next((name for name, states in GROUPS.items() if state in states), state)


def summarise_touch(
    records: Sequence[RobotRecord],
    observers: Sequence[str],
    robot: RobotConfig,
    *,
    suites: TouchSuites | None = None,
    by_state: Collection[str] | None = None,
) -> TouchSummary:
    """Score robots for observers, and pool the scores.

    No observer detects touches of a robot whose identification failed. Where an observer did not see every
    performed take of a robot, the robot is left out for this observer, and named.

    Args:
        records: All robots of a split, or of logs.
        observers: Names of observers.
        robot: Description of the robot.
        suites: For the order of places and rows; None for that of their names.
        by_state: Observers that get N90 of every state; others get it of groups of states alone, which takes less time.
            None for the first one.
    """
    whole = observers[:1] if by_state is None else by_state
    takes = [take for record in records for take in record.takes if not take.failure]
    touches = [touch for take in takes for touch in take.touches]
    laws = _in_order((_law(record) for record in records), get_args(BoardLaw))
    places = _in_order((t.place for t in touches), () if suites is None else tuple(suites.places))
    rows = _in_order(
        (t.row for t in touches), () if suites is None else [row.name for row in suites.rows]
    )
    states = _in_order((take.state for take in takes), tuple(STATES))
    return TouchSummary(
        robots=tuple(_robot(record) for record in records),
        observers=tuple(
            _observer(records, name, robot, places, states, rows, name in whole)
            for name in observers
        ),
        laws=laws,
        places=places,
        states=states,
        rows=rows,
        lowered=tuple(_lowered(touches, places)),
    )


def main_results(records: Sequence[RobotRecord]) -> MainResults:
    """Return the results of the project's own observer for the ledger: its false contacts are begins and moves."""
    summary = summarise_touch(records, (FUSION,), load_robot(), by_state=())
    ours = summary.observer(FUSION)
    if ours is None:
        return MainResults()
    free = ours.false_contacts("free")
    delay = ours.delays[0].fast.median if ours.delays else None

    def hand(law: BoardLaw, group: str) -> float | None:
        cell = ours.group(law, "hand", group)
        return None if cell is None or cell.n90 is None else cell.n90.newtons

    return MainResults(
        false_contacts=free.events if free is not None and free.hours > 0.0 else None,
        hours=free.hours if free is not None and free.hours > 0.0 else None,
        n90_standing_nominal=hand("nominal", "standing"),
        n90_standing_integral=hand("integral", "standing"),
        n90_moving_nominal=hand("nominal", "in motion"),
        n90_moving_integral=hand("integral", "in motion"),
        delay_ms=None if delay is None else 1e3 * delay,
    )


def _law(record: RobotRecord) -> str:
    return record.law or UNKNOWN


def _in_order(names: Iterable[str], order: Sequence[str]) -> tuple[str, ...]:
    """Return each name once: those of ``order`` first, the others by name."""
    left = set(names)
    known = [name for name in order if name in left]
    return (*known, *sorted(left.difference(known)))


def _robot(record: RobotRecord) -> RobotSummary:
    performed = [take for take in record.takes if not take.failure]
    failed = [take for take in record.takes if take.failure]
    return RobotSummary(
        robot=record.robot,
        draw=record.draw,
        law=_law(record),
        identity=record.identity,
        failure=record.failure,
        warnings=record.warnings,
        fit=_mean(record.fit.values()),
        hours=sum(take.seconds for take in performed) / 3600.0,
        takes=len(performed),
        redrawn=sum(take.redrawn > 0 for take in performed),
        redraws=dict(Counter(reason for take in performed for reason in take.reasons)),
        touches=sum(len(take.touches) for take in performed),
        failed_takes={f"{take.suite} {take.state} {take.number}": take.failure for take in failed},
        failed_touches=sum(len(take.planned) for take in failed),
    )


def _lowered(touches: Sequence[Touched], places: Sequence[str]) -> Iterator[LoweredForces]:
    for place in places:
        pairs = [
            (touch.force, touch.asked)
            for touch in touches
            if touch.place == place and touch.force is not None and touch.asked is not None
        ]
        if pairs:
            yield LoweredForces(
                place=place,
                lowered=sum(force < LOWERED * asked for force, asked in pairs),
                of=len(pairs),
                max_force=max(force for force, _ in pairs),
            )


def _observer(
    records: Sequence[RobotRecord],
    name: str,
    robot: RobotConfig,
    places: Sequence[str],
    states: Sequence[str],
    rows: Sequence[str],
    whole: bool,
) -> ObserverSummary:
    seen = [record for record in records if record.failure or _saw(record, name)]
    if len(seen) < len(records) and all(record.failure for record in seen):
        seen = []  # robots that failed say nothing of an observer that saw no other one
    judged = []
    for record in seen:
        score = score_robot(record, name, tuple(robot.limbs))
        judged.append(_Judged(_law(record), score, tuple(_ones(score, _law(record)))))
    ones = [one for entry in judged for one in entry.touches]
    main = [one for one in ones if one.main]
    limits = _limits(main)
    hearings = [
        take.hearings[name]
        for record in seen
        if not record.failure
        for take in record.takes
        if not take.failure
    ]
    complete = [observed for observed in hearings if not observed.failure]
    failures = [observed.failure for observed in hearings if observed.failure]
    return ObserverSummary(
        name=name,
        robots=tuple(_robot_results(entry) for entry in judged),
        left_out=tuple(record.robot for record in records if record not in seen),
        failures={reason: failures.count(reason) for reason in dict.fromkeys(failures)},
        cells=tuple(_cells(main, places, {s: (s,) for s in states})) if whole else (),
        groups=tuple(_cells(main, places, GROUPS)),
        rows=tuple(_rows([one for one in ones if not one.main], rows, places)),
        false=tuple(_false_groups(judged, states, robot)),
        located=_by_law(main, _located),
        delays=_by_law(ones, lambda law, some: _delays(law, some, limits)),
        ends=_by_law(ones, _ends),
        torques=_by_law(ones, _torques),
        forces=tuple(_forces(ones)),
        kinds=tuple(_kinds([one.score for one in ones])),
        motion=_by_law(
            main,
            lambda law, some: RestAndMotion(
                law=law,
                rest=Fraction.among(one.score.detected for one in some if not one.touch.moving),
                moving=Fraction.among(one.score.detected for one in some if one.touch.moving),
            ),
        ),
        threshold_deg=_medians(observed.threshold_deg for observed in complete),
    )


def _saw(record: RobotRecord, observer: str) -> bool:
    return all(observer in take.hearings for take in record.takes if not take.failure)


def _ones(score: RobotScore, law: str) -> Iterator[_One]:
    for take in score.takes:
        for number, one in enumerate(take.touches):
            yield _One(score.robot, law, take.state, one, _alone(take, number))


def _alone(take: TakeScore, number: int) -> bool:
    """Return true if no other touch of the limb acts from the onset to AFTER_RELEASE after the release."""
    touch = take.touches[number].touch
    return not any(
        other.touch.limb == touch.limb
        and other.touch.onset <= touch.release + AFTER_RELEASE
        and other.touch.release >= touch.onset
        for place, other in enumerate(take.touches)
        if place != number
    )


def _laws(found: Iterable[str]) -> tuple[str, ...]:
    return (ALL, *_in_order(found, get_args(BoardLaw)))


def _by_law(ones: Sequence[_One], make: Callable[[str, Sequence[_One]], T]) -> tuple[T, ...]:
    return tuple(
        make(law, [one for one in ones if law in (ALL, one.law)])
        for law in _laws(one.law for one in ones)
    )


def _robot_results(entry: _Judged) -> RobotResults:
    return RobotResults(
        robot=entry.score.robot,
        law=entry.law,
        identified=not entry.score.failure,
        detected=Fraction.among(one.score.detected for one in entry.touches if one.main),
        false=_false(entry.score.takes),
    )


# -- N90 and rows -----------------------------------------------------------------------------------------------------


def _force_touches(ones: Iterable[_One]) -> list[ForceTouch]:
    """Return the touches whose force is known, as N90 takes them."""
    return [
        ForceTouch(
            max(round(one.touch.force / FORCE_STEP), 1) * FORCE_STEP, one.score.detected, one.robot
        )
        for one in ones
        if one.touch.force is not None
    ]


def _cells(
    ones: Sequence[_One], places: Sequence[str], groups: Mapping[str, Sequence[str]]
) -> Iterator[Cell]:
    for law in _laws(one.law for one in ones)[1:]:
        for place in places:
            here = [one for one in ones if (one.law, one.touch.place) == (law, place)]
            for name, states in groups.items():
                some = [one for one in here if one.state in states]
                if some:
                    yield _cell(law, place, name, some)


def _cell(law: str, place: str, state: str, ones: Sequence[_One]) -> Cell:
    touches = _force_touches(ones)
    by_asked: dict[float, list[_One]] = {}
    for one in ones:
        if one.touch.asked is not None:
            by_asked.setdefault(one.touch.asked, []).append(one)
    return Cell(
        law=law,
        place=place,
        state=state,
        n90=n90(touches) if touches else None,
        detected=Fraction.among(one.score.detected for one in ones),
        forces=tuple(
            ForceFraction(
                asked=asked,
                acted=_or(_median(one.touch.force for one in some), asked),
                detected=Fraction.among(one.score.detected for one in some),
            )
            for asked, some in sorted(by_asked.items())
        ),
        bound=_median(one.touch.friction_bound for one in ones),
    )


def _rows(
    ones: Sequence[_One], rows: Sequence[str], places: Sequence[str]
) -> Iterator[RowFraction]:
    for row in rows:
        of_row = [one for one in ones if one.touch.row == row]
        here = [place for place in places if any(one.touch.place == place for one in of_row)]
        groups = _in_order((group_of(one.state) for one in of_row), (*GROUPS, *STATES))
        kinds: list[tuple[str, str]] = [(ALL, ALL)]
        kinds += [(place, ALL) for place in here if len(here) > 1]
        kinds += [(ALL, group) for group in groups if len(groups) > 1]
        for law in _laws(one.law for one in of_row) if of_row else ():
            for place, group in kinds:
                some = [
                    one
                    for one in of_row
                    if law in (ALL, one.law)
                    and place in (ALL, one.touch.place)
                    and group in (ALL, group_of(one.state))
                ]
                one_place = place != ALL or len(here) == 1
                yield RowFraction(
                    row=row,
                    law=law,
                    place=place,
                    state=group,
                    detected=Fraction.among(one.score.detected for one in some),
                    force=_median(one.touch.force for one in some),
                    n90=_row_n90(some) if law != ALL and one_place and group == ALL else None,
                )


def _row_n90(ones: Sequence[_One]) -> N90 | None:
    forces = {one.touch.asked for one in ones if one.touch.asked is not None}
    touches = _force_touches(ones)
    return n90(touches, limit=max(forces)) if len(forces) >= MIN_N90_FORCES and touches else None


# -- false contacts ---------------------------------------------------------------------------------------------------


def _false_groups(
    judged: Sequence[_Judged], states: Sequence[str], robot: RobotConfig
) -> Iterator[FalseGroup]:
    suites: tuple[Suite, ...] = (ALL, "free", "touch")
    for suite in suites:
        for law in _laws(entry.law for entry in judged):
            of_law = [entry for entry in judged if law in (ALL, entry.law)]
            by_robot = {
                entry.score.robot: [t for t in entry.score.takes if suite in (ALL, t.suite)]
                for entry in of_law
            }
            takes = [take for some in by_robot.values() for take in some]
            for by, name, contacts in _false_kinds(takes, by_robot, states, robot):
                yield FalseGroup(suite=suite, law=law, by=by, name=name, contacts=contacts)


def _false_kinds(
    takes: Sequence[TakeScore],
    by_robot: Mapping[str, Sequence[TakeScore]],
    states: Sequence[str],
    robot: RobotConfig,
) -> Iterator[tuple[By, str, FalseContacts]]:
    yield ALL, ALL, _false(takes)
    for state in states:
        if some := [take for take in takes if take.state == state]:
            yield "state", state, _false(some)
    for name, own in by_robot.items():
        if own:
            yield "robot", name, _false(own)
    joints = dict.fromkeys(_joint(robot.limb_of(name), name) for name in robot.joint_names)
    kinds: tuple[tuple[By, Callable[[str, str | None], str], Iterable[str]], ...] = (
        ("limb", lambda limb, _: limb, robot.limbs),
        ("part", _part, PARTS),
        ("joint", _joint, (*joints, TRUNK)),
    )
    for by, name_of, names in kinds:
        for name in names:
            yield by, name, _false_at(takes, partial(_is, name_of, name))


def _is(name_of: Callable[[str, str | None], str], name: str, event: FalseEvent) -> bool:
    return name_of(event.limb, event.shown_by) == name


def _joint(limb: str, joint: str | None) -> str:
    """Return the name of a joint without its side, TRUNK for none."""
    if joint is None:
        return TRUNK
    return joint[1:] if limb.endswith("_arm") else joint


def _part(limb: str, joint: str | None) -> str:
    if not limb.endswith("_arm"):
        return limb
    return "wrists and hands" if _joint(limb, joint) in ("WristYaw", "Hand") else "arms"


def _false(takes: Sequence[TakeScore]) -> FalseContacts:
    whole = _false_at(takes, lambda _: True)
    idle = sum(take.idle_contact for take in takes)
    hours = whole.hours
    return replace(
        whole,
        reported_rebounds=sum(take.rebounds for take in takes),
        open_limbs=sum(take.open_limbs for take in takes),
        seconds=idle,
        seconds_per_hour=idle / hours if hours > 0.0 else None,
        fraction_of_time=idle / (3600.0 * hours) if hours > 0.0 else None,
    )


def _false_at(takes: Sequence[TakeScore], here: Callable[[FalseEvent], bool]) -> FalseContacts:
    """Count the false contacts whose limb and joint are asked for."""
    events = [e for take in takes for e in take.false if here(e)]
    hours = sum(take.hours for take in takes)
    begins = sum(not event.move for event in events)
    return FalseContacts(
        begins=begins,
        moves=len(events) - begins,
        after_release=sum(event.after_release for event in events),
        other_touched=sum(event.other_touched for event in events),
        rebounds=sum(event.rebound for event in events),
        reported_rebounds=None,
        hours=hours,
        begin_rate=Rate.counted(begins, hours),
        rate=Rate.counted(len(events), hours),
        seconds=None,
        seconds_per_hour=None,
        fraction_of_time=None,
    )


# -- reports on touches -----------------------------------------------------------------------------------------------


def _located(law: str, ones: Sequence[_One]) -> Located:
    alarms = [one.score.alarm for one in ones if one.score.alarm is not None]
    later = [one.score.later for one in ones if one.score.later is not None]

    def fraction(
        places: Sequence[LocationScore], of: Callable[[LocationScore], bool | None]
    ) -> Fraction:
        return Fraction.among(of(place) for place in places)

    return Located(
        law=law,
        first_limb=Fraction.among(one.score.first_limb for one in ones),
        limb_later=fraction(later, lambda place: place.limb),
        joint=fraction(alarms, lambda place: place.joint),
        joint_later=fraction(later, lambda place: place.joint),
        largest=fraction(alarms, lambda place: place.largest_joint),
        largest_later=fraction(later, lambda place: place.largest_joint),
        direction=fraction(alarms, lambda place: place.direction),
        direction_later=fraction(later, lambda place: place.direction),
    )


Limits = Mapping[tuple[str, str, str], float]
"""N90 by law, place and state [N]."""


def _limits(ones: Sequence[_One]) -> Limits:
    cells: dict[tuple[str, str, str], list[_One]] = {}
    for one in ones:
        cells.setdefault((one.law, one.touch.place, one.state), []).append(one)
    # Of one robot there is no interval, which takes most of the time.
    touches = {
        key: [touch._replace(robot="") for touch in _force_touches(some)]
        for key, some in cells.items()
    }
    return {key: n90(some).newtons for key, some in touches.items() if some}


def passing_time(force: float, rise: float, newtons: float) -> float:
    """Return the time from the onset until a force passes ``newtons``, along half a cosine [s].

    Args:
        force: That it rises to, at least ``newtons`` [N].
        rise: Time in which it does [s].
        newtons: [N]
    """
    return rise / math.pi * math.acos(1.0 - 2.0 * newtons / force)


def _delays(law: str, ones: Sequence[_One], limits: Limits) -> Delays:
    fast, slow, strong = _Counted(), _Counted(), _Counted()
    for one in ones:
        touch, delay = one.touch, one.score.delay
        if touch.rise is None or touch.standing_start:
            continue
        limit = limits.get((one.law, touch.place, one.state), math.inf)
        passes = touch.force is not None and touch.force >= limit
        if touch.rise <= FAST_RISE:
            fast.add(delay)
        elif touch.force is not None and passes:
            delay = None if delay is None else delay - passing_time(touch.force, touch.rise, limit)
            slow.add(delay)
        if touch.force is not None and touch.force >= STRONG * limit:
            strong.add(delay)
    return Delays(law=law, fast=fast.quantiles(), slow=slow.quantiles(), strong=strong.quantiles())


class _Counted:
    """Values of touches; None for a touch that has none."""

    def __init__(self) -> None:
        self._values: list[float] = []
        self._of = 0

    def add(self, value: float | None) -> None:
        self._of += 1
        if value is not None:
            self._values.append(value)

    def quantiles(self) -> Quantiles:
        return Quantiles.among(self._values, self._of)


def _ends(law: str, ones: Sequence[_One]) -> Ends:
    detected = [one.score for one in ones if one.alone and one.score.detected]
    errors = [score.end_error for score in detected if score.end_error is not None]
    return Ends(
        law=law,
        error=Quantiles.among(errors, len(detected)),
        early=Fraction.among(error < EARLY for error in errors),
        open=sum(score.open for score in detected),
    )


def _torques(law: str, ones: Sequence[_One]) -> Torques:
    pairs = np.array([(p.true, p.estimate) for one in ones for p in one.score.torques])
    if not len(pairs):
        return Torques(law=law, pairs=0, rmse=None, r2=None)
    true, estimate = pairs.T
    squared = float(((estimate - true) ** 2).sum())
    spread = float(((true - true.mean()) ** 2).sum())
    return Torques(
        law=law,
        pairs=len(pairs),
        rmse=math.sqrt(squared / len(pairs)),
        r2=1.0 - squared / spread if spread > 0.0 else None,
    )


def _forces(ones: Sequence[_One]) -> Iterator[Forces]:
    """Yield the forces of each law, place and group of states in which one was reported."""
    if not any(one.score.force is not None for one in ones):
        return
    pushes = [
        one
        for one in ones
        if one.touch.place in FORCE_PLACES
        and one.alone
        and one.score.detected
        and one.touch.fading is not None
        and one.touch.fading > one.touch.onset + MIN_FORCE_TIME
    ]
    # All robots of a split are identified with the same weight.
    held = {
        one.touch.limb
        for one in ones
        if one.score.force is not None and one.score.force.scale_known
    }
    cells = product(
        _laws(one.law for one in pushes),
        (ALL, *FORCE_PLACES),
        (ALL, *GROUPS),
        (ALL, WEIGHT_ARM, OTHER_ARM),
    )
    for law, place, state, arm in cells:
        some = [
            one
            for one in pushes
            if law in (ALL, one.law)
            and place in (ALL, one.touch.place)
            and state in (ALL, group_of(one.state))
            and arm in (ALL, WEIGHT_ARM if one.touch.limb in held else OTHER_ARM)
        ]
        if some:
            yield _forces_of(law, place, state, arm, some)


def _forces_of(law: str, place: str, state: str, arm: str, pushes: Sequence[_One]) -> Forces:
    estimates = [one.score.force for one in pushes if one.score.force is not None]
    strong = [one for one in pushes if (one.touch.force or 0.0) >= STRONG_FORCE]
    of_strong = [one.score.force for one in strong if one.score.force is not None]
    errors = [pair.estimate / pair.true - 1.0 for pair in of_strong]
    return Forces(
        law=law,
        place=place,
        state=state,
        arm=arm,
        known=Fraction.among(pair.scale_known for pair in estimates),
        right=Fraction.counted(sum(abs(error) <= FORCE_TOLERANCE for error in errors), len(strong)),
        covered=Fraction.among(pair.low <= pair.true <= pair.high for pair in of_strong),
        all_covered=Fraction.among(pair.low <= pair.true <= pair.high for pair in estimates),
        error=Quantiles.among(errors, len(strong)),
    )


def _kinds(scores: Sequence[TouchScore]) -> Iterator[Kinds]:
    """Yield the kinds that were reported of touches of each true kind, for an observer that sharpens them."""
    if all(score.kind in (None, *UNSHARPENED) for score in scores):
        return
    for true in get_args(Kind):
        some = [score for score in scores if score.true_kind == true]
        if some:
            right = [score for score in some if score.kind == true]
            ends = [score.end_error for score in right if score.end_error is not None]
            yield Kinds(
                true=true,
                reported=dict(Counter(s.kind for s in some if s.kind is not None).most_common()),
                not_detected=sum(score.kind is None for score in some),
                right=Fraction.among(
                    None
                    if one.kind is None or (one.touch.row == LOG and one.kind in UNKNOWN_IN_LOGS)
                    else one.kind == true
                    for one in some
                ),
                end=Quantiles.among(ends, len(right)),
            )


# -- small things -----------------------------------------------------------------------------------------------------


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _mean(values: Iterable[float]) -> float | None:
    known = list(values)
    return float(np.mean(known)) if known else None


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


def _medians(parts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    by_joint: dict[str, list[float]] = {}
    for part in parts:
        for joint, value in part.items():
            by_joint.setdefault(joint, []).append(value)
    return {joint: float(np.median(values)) for joint, values in by_joint.items()}
