"""Results of the judge of touch as plain data: fractions, rates, N90 and delays of each observer on a split."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from pepper_driver.config.contact_selector import Kind
from pepper_driver.evaluation.touch.n90 import N90, poisson_interval, wilson_interval
from pepper_driver.evaluation.touch.states import STANDING, STATES

T = TypeVar("T")

ALL: Literal["all"] = "all"
"""In place of a law, a place, a state or a suite: all of them together."""

UNKNOWN = "unknown"
"""Law of a robot of which none is known, as in a log."""

GROUPS: dict[str, tuple[str, ...]] = {
    "standing": ("standing", "after-motion"),
    "attentive": ("attentive",),
    "in motion": tuple(state for state in STATES if state not in STANDING),
}
"""States that are pooled. A robot whose reflexes act or whose stiffness is lowered is in none of them."""

FAST_RISE = 0.05
"""[s] Delays count from the onset where the force rises within this time."""

STRONG = 2.0
"""Times N90: a strong touch."""

EARLY = -0.1
"""[s] A contact that ends longer than this before the release ended early."""

STRONG_FORCE = 15.0
"""[N] A force from which the error of its estimate counts."""

FORCE_TOLERANCE = 0.3
"""Error of a force over its size, within which its estimate is right."""

FORCE_PLACES = ("hand", "forearm")
"""Places whose forces are asked for; the joints before them show the force best."""

WEIGHT_ARM, OTHER_ARM = "arm of the weight", "other arm"
"""Arms by the known weight with which robots were identified: the one whose hand held it, and the other one."""

PARTS = ("arms", "wrists and hands", "head", "trunk")
"""Of the robot, for false contacts."""

Suite = Literal["touch", "free", "all"]
By = Literal["all", "state", "robot", "limb", "joint", "part"]


@dataclass(frozen=True, kw_only=True)
class Fraction:
    """``count`` of ``of``, as a fraction with its interval (Wilson); the fraction is None of nothing."""

    count: int
    of: int
    fraction: float | None
    low: float
    high: float

    @classmethod
    def counted(cls, count: int, of: int) -> Fraction:
        """Return the fraction of a count."""
        low, high = wilson_interval(count, of)
        return cls(count=count, of=of, fraction=count / of if of else None, low=low, high=high)

    @classmethod
    def among(cls, answers: Iterable[bool | None]) -> Fraction:
        """Return the fraction of true answers; None is no answer."""
        given = [answer for answer in answers if answer is not None]
        return cls.counted(sum(given), len(given))


@dataclass(frozen=True, kw_only=True)
class Rate:
    """``count`` in ``hours``, as a rate with its interval (Poisson) [1/h]; the rate is None in no time."""

    count: int
    hours: float
    per_hour: float | None
    low: float
    high: float

    @classmethod
    def counted(cls, count: int, hours: float) -> Rate:
        """Return the rate of a count."""
        low, high = poisson_interval(count, hours)
        rate = count / hours if hours > 0.0 else None
        return cls(count=count, hours=hours, per_hour=rate, low=low, high=high)


@dataclass(frozen=True, kw_only=True)
class Quantiles:
    """Quantiles of ``count`` values, None of none. ``of``: touches that could have had one, detected or not."""

    count: int
    of: int
    p10: float | None
    median: float | None
    p90: float | None

    @classmethod
    def among(cls, values: Sequence[float], of: int) -> Quantiles:
        """Return the quantiles of some values."""
        if not values:
            return cls(count=0, of=of, p10=None, median=None, p90=None)
        p10, median, p90 = (float(value) for value in np.percentile(values, (10, 50, 90)))
        return cls(count=len(values), of=of, p10=p10, median=median, p90=p90)


@dataclass(frozen=True, kw_only=True)
class ForceFraction:
    """Touches for which the suite asked this force [N]: the median that acted [N], and how many were detected."""

    asked: float
    acted: float
    detected: Fraction


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Touches of the row of N90 at one place in one state, or in one group of states.

    Attributes:
        law, place, state: Which ones. Both arms are one place.
        n90: None if no force is known.
        detected: Of all of them.
        forces: By the force asked for, from the smallest up.
        bound: Median friction bound [N]; None where it is unknown.
    """

    law: str
    place: str
    state: str
    n90: N90 | None
    detected: Fraction
    forces: tuple[ForceFraction, ...]
    bound: float | None


@dataclass(frozen=True, kw_only=True)
class RowFraction:
    """Touches of another row that were detected; ALL where a law, a place or a group of states is not separated.

    Attributes:
        row, law, place, state: Which ones; ``state`` is a group, or a state that is in none.
        detected: How many of them.
        force: Median force that really acted [N]; None where it is unknown.
        n90: Of one law and place in all states of the row; None where its forces are too few for a curve.
    """

    row: str
    law: str
    place: str
    state: str
    detected: Fraction
    force: float | None
    n90: N90 | None = None


@dataclass(frozen=True, kw_only=True)
class FalseContacts:
    """False contacts of some takes.

    Attributes:
        begins, moves: Contacts that began, and that moved, where nothing touched.
        after_release, other_touched, rebounds: Those of them that came late after a release on the limb, while another
            limb was touched, and that called themselves a rebound.
        reported_rebounds: Rebounds that were reported as such; they are not false.
        open_limbs: Contacts that left their limb open while another one was touched; they are neither right nor false.
        hours: In which a contact could have been false [h].
        begin_rate, rate: Of begins, and of begins and moves together.
        seconds: Time in contacts that were none [s]; None where it is not known apart.
        seconds_per_hour, fraction_of_time: The same, per hour and as a fraction.
    """

    begins: int
    moves: int
    after_release: int
    other_touched: int
    rebounds: int
    reported_rebounds: int | None
    open_limbs: int | None = None
    hours: float
    begin_rate: Rate
    rate: Rate
    seconds: float | None
    seconds_per_hour: float | None
    fraction_of_time: float | None

    @property
    def events(self) -> int:
        """Number of begins and moves."""
        return self.begins + self.moves


@dataclass(frozen=True, kw_only=True)
class FalseGroup:
    """False contacts of one kind of takes and one law, of all, or ``by`` something the one with this ``name``.

    Joints are called without their side; ``trunk`` stands for contacts that name none. For limbs, joints and parts the
    hours are those of the whole robot.
    """

    suite: Suite
    law: str
    by: By
    name: str
    contacts: FalseContacts


@dataclass(frozen=True, kw_only=True)
class Located:
    """Limb, joint and direction of detected touches of the row of N90: at the alarm, and 150 ms later.

    Attributes:
        law: Of the robots.
        first_limb: Touches of which the first report was on their limb, among those of which anything was reported.
        limb_later: Contacts that are still on the limb.
        joint, joint_later: Joints with at least JOINT_FRACTION of the largest torque.
        largest, largest_later: Joints with the largest.
        direction, direction_later: Signs that are right, of joints that were turned.
    """

    law: str
    first_limb: Fraction
    limb_later: Fraction
    joint: Fraction
    joint_later: Fraction
    largest: Fraction
    largest_later: Fraction
    direction: Fraction
    direction_later: Fraction


@dataclass(frozen=True, kw_only=True)
class Delays:
    """Delays of alarms [s], of touches that did not begin before the first tick and whose rise is known.

    Attributes:
        law: Of the robots.
        fast: From the onset, for rises up to FAST_RISE.
        slow: For slower ones, from the moment at which the force passes the N90 of its law, place and state; without
            those that never pass it. Negative where a touch is detected before.
        strong: Both, each by its rule, where the force is STRONG times this N90 or more.
    """

    law: str
    fast: Quantiles
    slow: Quantiles
    strong: Quantiles


@dataclass(frozen=True, kw_only=True)
class Ends:
    """Ends of contacts, where no other touch of the limb is near.

    Attributes:
        law: Of the robots.
        error: End of the contact minus release [s].
        early: Contacts that ended before EARLY.
        open: Contacts that lasted until the end of the take.
    """

    law: str
    error: Quantiles
    early: Fraction
    open: int


@dataclass(frozen=True, kw_only=True)
class Torques:
    """Torque estimates on joints that a touch turned: pairs, root mean square error [N m], R2 over all pairs."""

    law: str
    pairs: int
    rmse: float | None
    r2: float | None


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Forces that were reported of detected pushes alone on their limb, against those that acted.

    A push that is detected and has no force until it fades is one whose estimate is wrong.

    Attributes:
        law: Of the robots.
        place: One place, or ALL for FORCE_PLACES together.
        state: One group of states, or ALL for all states.
        arm: WEIGHT_ARM or OTHER_ARM, or ALL for both.
        known: Estimates whose scale was measured with the weight: not where the current of a joint that the weight
            hardly loads counts too, as that of some wrists.
        right: Estimates within FORCE_TOLERANCE, of pushes from STRONG_FORCE on.
        covered: Intervals that hold the force that acted, of the same pushes.
        all_covered: The same of pushes of every size.
        error: Estimate over the force that acted, minus 1, of pushes from STRONG_FORCE on.
    """

    law: str
    place: str
    state: str
    arm: str
    known: Fraction
    right: Fraction
    covered: Fraction
    all_covered: Fraction
    error: Quantiles


@dataclass(frozen=True, kw_only=True)
class Kinds:
    """Touches of one true kind, by the kind that was reported of them last.

    Attributes:
        true: The true kind.
        reported: Number of touches by kind that was reported, the frequent ones first.
        not_detected: Number of touches that were not detected: no kind was reported.
        right: Detected ones of which the true kind was reported. Those of a log whose kind the label cannot refute do
            not count.
        end: Time from the release to the event that reports the end of the contact, and a tap as such [s], where the
            kind is right. ``of`` has those without an end too.
    """

    true: Kind
    reported: dict[Kind, int]
    not_detected: int
    right: Fraction
    end: Quantiles


@dataclass(frozen=True, kw_only=True)
class RestAndMotion:
    """Touches of the row of N90 by what their limb did at the onset: how many of each were detected."""

    law: str
    rest: Fraction
    moving: Fraction


@dataclass(frozen=True, kw_only=True)
class RobotResults:
    """One robot under one observer: touches of the row of N90 that were detected, false contacts of all takes."""

    robot: str
    law: str
    identified: bool
    detected: Fraction
    false: FalseContacts


@dataclass(frozen=True, kw_only=True)
class ObserverSummary:
    """All results of one observer.

    Attributes:
        name: Of the observer.
        robots: Those that it was judged on.
        left_out: Names of robots of which it did not see every take: they are in no result.
        failures: Reasons why it has no result of a take, with the number of takes; their touches count as not
            detected.
        cells: By law, place and state; empty if they were not asked for.
        groups: By law, place and group of states.
        rows: Of the other rows.
        false: False contacts.
        located, delays, ends, torques, motion: By law, ALL first.
        forces: By law, place and group of states, ALL first; empty if it reports none.
        kinds: By true kind; empty if it reports none but those with which a contact begins.
        threshold_deg: By joint, median threshold while nothing touched the robot [deg].
    """

    name: str
    robots: tuple[RobotResults, ...]
    left_out: tuple[str, ...]
    failures: dict[str, int]
    cells: tuple[Cell, ...]
    groups: tuple[Cell, ...]
    rows: tuple[RowFraction, ...]
    false: tuple[FalseGroup, ...]
    located: tuple[Located, ...]
    delays: tuple[Delays, ...]
    ends: tuple[Ends, ...]
    torques: tuple[Torques, ...]
    forces: tuple[Forces, ...]
    kinds: tuple[Kinds, ...]
    motion: tuple[RestAndMotion, ...]
    threshold_deg: dict[str, float]

    def cell(self, law: str, place: str, state: str) -> Cell | None:
        """Return the touches at a place in a state; None if there are none."""
        found: Cell | None = _found(self.cells, law=law, place=place, state=state)
        return found

    def group(self, law: str, place: str, group: str) -> Cell | None:
        """Return the touches at a place in a group of states; None if there are none."""
        found: Cell | None = _found(self.groups, law=law, place=place, state=group)
        return found

    def false_contacts(
        self, suite: Suite = ALL, law: str = ALL, by: By = ALL, name: str = ALL
    ) -> FalseContacts | None:
        """Return the false contacts of a group; None if there is none."""
        found = _found(self.false, suite=suite, law=law, by=by, name=name)
        return None if found is None else found.contacts

    def force(
        self, law: str = ALL, place: str = ALL, state: str = ALL, arm: str = ALL
    ) -> Forces | None:
        """Return the forces at a place in a group of states; None if there are none."""
        found: Forces | None = _found(self.forces, law=law, place=place, state=state, arm=arm)
        return found

    def detected(self, law: str = ALL) -> Fraction:
        """Return the fraction of touches of the row of N90 that were detected."""
        parts = [robot.detected for robot in self.robots if law in (ALL, robot.law)]
        return Fraction.counted(sum(part.count for part in parts), sum(part.of for part in parts))


@dataclass(frozen=True, kw_only=True)
class RobotSummary:
    """One robot.

    Attributes:
        robot, draw, law, identity, failure, warnings: Of its record.
        fit: Mean over its joints [%]; None without any.
        hours: Length of the takes that were performed [h].
        takes, redrawn: How many these are, and how many of them were drawn again.
        redraws: Reasons for that, with their number.
        touches: In these takes.
        failed_takes: Takes that could not be performed, as ``touch gesturing 2``, with the reason.
        failed_touches: Touches that were planned for them.
    """

    robot: str
    draw: int | None
    law: str
    identity: str
    failure: str
    warnings: tuple[str, ...]
    fit: float | None
    hours: float
    takes: int
    redrawn: int
    redraws: dict[str, int]
    touches: int
    failed_takes: dict[str, str]
    failed_touches: int


@dataclass(frozen=True, kw_only=True)
class LoweredForces:
    """Touches of a place whose force was lowered, of those that asked for one; the largest force that acted [N]."""

    place: str
    lowered: int
    of: int
    max_force: float


@dataclass(frozen=True, kw_only=True)
class TouchSummary:
    """All results of a split.

    Attributes:
        robots: In the order of the records.
        observers: In the order in which they were asked for.
        laws, places, states, rows: Names that occur, in the order of the suites.
        lowered: By place.
    """

    robots: tuple[RobotSummary, ...]
    observers: tuple[ObserverSummary, ...]
    laws: tuple[str, ...]
    places: tuple[str, ...]
    states: tuple[str, ...]
    rows: tuple[str, ...]
    lowered: tuple[LoweredForces, ...]

    def observer(self, name: str) -> ObserverSummary | None:
        """Return the results of an observer that was judged on at least one robot; None otherwise."""
        found = _found(self.observers, name=name)
        return found if found is not None and found.robots else None

    def as_json(self) -> dict[str, Any]:
        """Return plain data: what is infinite becomes None, and N90 has its text too."""
        return {field.name: _plain(getattr(self, field.name)) for field in fields(self)}


def _found(items: Iterable[T], **keys: object) -> T | None:
    return next((i for i in items if all(getattr(i, k) == v for k, v in keys.items())), None)


def _plain(value: object) -> object:
    if is_dataclass(value):
        plain = {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
        if isinstance(value, N90):
            plain |= {"text": value.text, "worst_text": value.worst_text}
        return plain
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
