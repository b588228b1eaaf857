"""Page of results of the judge of touch, as Markdown: from results that are ready, without reading or writing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, get_args

from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.robot import TRUNK
from pepper_driver.evaluation.report import number, section, table
from pepper_driver.evaluation.touch.comparison import Difference, paired
from pepper_driver.evaluation.touch.kinds import MAX_PUSH_TIME, MAX_TAP_PAUSE, MAX_TAP_TIME
from pepper_driver.evaluation.touch.map import law_in_words
from pepper_driver.evaluation.touch.n90 import MAX_FORCE, N90
from pepper_driver.evaluation.touch.observers import ABLATIONS, FUSION
from pepper_driver.evaluation.touch.scoring import (
    AFTER_RELEASE,
    DETECTION_GRACE,
    REBOUND_TIME,
)
from pepper_driver.evaluation.touch.summary import LOWERED
from pepper_driver.evaluation.touch.summary_data import (
    ALL,
    FAST_RISE,
    FORCE_TOLERANCE,
    GROUPS,
    OTHER_ARM,
    PARTS,
    STRONG,
    STRONG_FORCE,
    WEIGHT_ARM,
    By,
    Cell,
    Delays,
    Ends,
    FalseContacts,
    ForceFraction,
    Forces,
    Fraction,
    Located,
    ObserverSummary,
    Quantiles,
    Rate,
    RowFraction,
    Suite,
    Torques,
    TouchSummary,
)
from pepper_driver.observer.scoring import JOINT_FRACTION

HEADLINE_PLACES = ("hand", "forearm", "upper arm", "head", "trunk")
"""Places of the first table."""

FEW_ROBOTS = 8
"""Robots of a law: with fewer, an interval by bootstrap over robots is too short."""

SUITES: dict[Suite, str] = {
    "free": "the robot is left alone",
    "touch": "people touch it",
    ALL: "together",
}
"""By name of a suite, its human-readable name."""

_DIGEST = 10
"""Characters of a hash on the page."""

RULES = (
    "A program receives each begin of a contact, and each move of one to another limb or joint. It is *right* from "
    f"the onset of a touch on its limb to {DETECTION_GRACE:g} s after the release, a *rebound* if it calls itself one "
    f"and comes until {REBOUND_TIME:g} s after a release on its limb, and *false* otherwise: on another limb, on the "
    "trunk, after a release, in place of a rebound.",
    "A touch is *detected* by the first right begin on its limb, or by the first contact that moves there; one such "
    "event detects one touch. Hours are those in which a contact could have been false, a mean over the limbs.",
    "*N90* is the force at which nine touches in ten are detected: a logistic curve in the logarithm of the force, "
    "with a fraction of touches that are not detected at any force, is fitted to touches of 1 s (rise 0.1 s) from all "
    "sides, without those along the axis of the limb. Robots of one law are pooled. Of equally likely curves the one "
    "with the largest N90 counts. In brackets a 95 % interval by bootstrap over robots; *worst* is the N90 of the "
    "worst robot. Other touches of several forces have an N90 in a table of their own.",
    "Forces are those that acted: a touch that would tip the robot is planned lower, and counts as what it is.",
    "The *friction bound* of a touch is the minimum over the joints of its limb of 2 F / |J^T u|: friction may hide a "
    "smaller force from a limb at rest, whatever the observer. The tables have its median.",
    f"The *joint* is right if it has at least {JOINT_FRACTION:g} of the largest torque on the joints of the limb; a "
    "stricter rule has its own row: the joint has the largest. Limb, joint and direction are of touches of the row "
    "`even`.",
    f"Delays count from the onset where the force rises within {1e3 * FAST_RISE:.0f} ms; for slower touches from the "
    "moment at which the force passes the N90 of its law, place and state, and only where it passes it. A negative "
    "delay is a touch that was detected before.",
    f"*Force* is of detected pushes of {STRONG_FORCE:g} N and more at hand and forearm, as it was reported last before "
    "the push faded, against the largest that acted. A push without a reported force counts as wrong.",
    "Touches of a robot whose identification failed are not detected. Fractions have Wilson's 95 % interval, rates the "
    "exact Poisson one.",
)
"""Scoring in short."""


def touch_page(
    summary: TouchSummary,
    pictures: Mapping[str, str],
    *,
    ledger: Sequence[Mapping[str, str]] = (),
    looks: int | None = None,
    development: bool = False,
    simulated: bool = True,
    simulated_robots: SimulatedRobots | None = None,
    ours: str = FUSION,
) -> list[str]:
    """Return the sections of the page.

    Args:
        summary: All results.
        pictures: Caption of each picture by its path, as
            :func:`pepper_driver.evaluation.touch.recall.write_touch_pictures` names them.
        ledger: Lines of the ledger, by column.
        looks: Number of looks at the test split so far; None for the number of lines.
        development: True for robots of the development split.
        simulated: False for real robots.
        simulated_robots: Those whose results are compared with these; None for none.
        ours: Name of the project's own observer.
    """
    observer = summary.observer(ours)
    parts: list[str] = []
    if observer is None:
        parts += section("Touch", f"The observer `{ours}` was judged on no robot.")
    else:
        parts += headline(summary, observer)
        if simulated_robots is not None:
            parts += comparison_table(summary, observer, simulated_robots, ours)
        parts += pictures_of(pictures)
        parts += n90_table(summary, observer)
        parts += detection_table(summary, observer)
        parts += recall_table(summary, observer)
        parts += rows_table(summary, observer)
        parts += kinds_table(observer)
        parts += false_contacts(summary, observer)
        parts += baselines(summary, observer)
        parts += ablations(summary, observer)
        parts += models(summary)
    parts += failures(summary)
    parts += section("How touches are scored", "\n".join(f"- {rule}" for rule in RULES))
    parts += ledger_table(ledger, looks)
    parts += limits(summary, development=development, simulated=simulated)
    return parts


# -- headline ---------------------------------------------------------------------------------------------------------


def headline(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write the first section: N90 by place and group of states, and the other main results by law."""
    laws = summary.laws
    rows = []
    for place in HEADLINE_PLACES:
        for law in laws:
            cells = [observer.group(law, place, group) for group in GROUPS]
            if any(cell is not None for cell in cells):
                rows.append([f"{place}, `{law}`", *(_n90_and_worst(cell) for cell in cells)])
    results = table(
        ("result", *(f"`{law}`" for law in laws), *(("all robots",) if len(laws) > 1 else ())),
        [
            [name, *(value(law) for law in (*laws, *((ALL,) if len(laws) > 1 else ())))]
            for name, value in _results(observer).items()
        ],
    )
    about = "; ".join(f"`{law}`: {law_in_words(law).split(chr(10))[0]}" for law in laws)
    return section(
        "Touch at a glance",
        f"Observer `{observer.name}`, {_robots(summary)}; {about}.",
        table(("N90 [N]", *GROUPS), rows),
        results,
    )


def _robots(summary: TouchSummary) -> str:
    counts = [
        f"{sum(robot.law == law for robot in summary.robots)} of `{law}`" for law in summary.laws
    ]
    failed = sum(bool(robot.failure) for robot in summary.robots)
    bad = f", {failed} of them could not be identified: none of their touches is detected"
    hours = sum(robot.hours for robot in summary.robots)
    named = f" ({', '.join(counts)})" if counts else ""
    return f"{len(summary.robots)} robots{named}{bad if failed else ''}, {hours:.1f} hours in all"


def _n90_and_worst(cell: Cell | None) -> str:
    if cell is None or cell.n90 is None:
        return "-"
    worst = f"; worst {cell.n90.worst_text}" if cell.n90.robots > 1 else ""
    return f"{cell.n90.text}{worst}"


class _OfLaw(Protocol):
    @property
    def law(self) -> str: ...


L = TypeVar("L", bound=_OfLaw)


def _of(items: Sequence[L], get: Callable[[L], str]) -> Callable[[str], str]:
    """Return the function that writes a result of a law."""
    found = {item.law: item for item in items}
    return lambda law: get(found[law]) if law in found else "-"


def _results(observer: ObserverSummary) -> dict[str, Callable[[str], str]]:
    """By name of a result, the function that writes it for a law."""

    def located(get: Callable[[Located], Fraction]) -> Callable[[str], str]:
        return _of(observer.located, lambda one: fraction_text(get(one)))

    def delay(get: Callable[[Delays], Quantiles]) -> Callable[[str], str]:
        return _of(observer.delays, lambda one: delay_text(get(one)))

    def false(suite: Suite, get: Callable[[FalseContacts], str]) -> Callable[[str], str]:
        def text(law: str) -> str:
            contacts = observer.false_contacts(suite, law)
            return "-" if contacts is None or contacts.hours <= 0.0 else get(contacts)

        return text

    return {
        "false contacts an hour (begins and moves), left alone": false("free", _rate),
        "the same, left alone, worst robot": lambda law: _worst_false(observer, law, "free"),
        "the same, people touch": false("touch", _rate),
        "the same, together": false(ALL, _rate),
        "the same, together, worst robot": lambda law: _worst_false(observer, law, ALL),
        "time an hour in contacts that are none; fraction of it, left alone": false("free", _idle),
        "that time, together": false(ALL, _idle),
        "touches of row `even` that are detected": lambda law: fraction_text(
            observer.detected(law)
        ),
        "the same, of limbs at rest": _of(observer.motion, lambda one: fraction_text(one.rest)),
        "the same, of limbs in motion": _of(observer.motion, lambda one: fraction_text(one.moving)),
        f"delay, rises up to {1e3 * FAST_RISE:.0f} ms, from the onset": delay(lambda one: one.fast),
        "delay, slower rises, from passing N90": delay(lambda one: one.slow),
        f"delay, {STRONG:g} times N90 and more": delay(lambda one: one.strong),
        "first reported on the right limb": located(lambda one: one.first_limb),
        "limb right 150 ms after the alarm": located(lambda one: one.limb_later),
        "joint right at the alarm": located(lambda one: one.joint),
        "joint right 150 ms later": located(lambda one: one.joint_later),
        "joint has the largest torque, at the alarm": located(lambda one: one.largest),
        "joint has the largest torque, 150 ms later": located(lambda one: one.largest_later),
        "direction right at the alarm": located(lambda one: one.direction),
        "direction right 150 ms later": located(lambda one: one.direction_later),
        "end of the contact after the release": _of(observer.ends, _end),
        "torque on turned joints: RMSE; R2": _of(observer.torques, _torque),
        **_force_results(observer),
    }


def _force_results(observer: ObserverSummary) -> dict[str, Callable[[str], str]]:
    """By name of a result of the forces at hand and forearm, the function that writes it for a law."""

    def forces(state: str, arm: str, get: Callable[[Forces], Fraction]) -> Callable[[str], str]:
        def text(law: str) -> str:
            found = observer.force(law, state=state, arm=arm)
            return "-" if found is None else fraction_text(get(found))

        return text

    return {
        f"force{where}{of}: {what}": forces(state, arm, get)
        for state, where in ((ALL, ""), ("attentive", ", attentive"), ("in motion", ", in motion"))
        for arm, of in ((ALL, ""), (WEIGHT_ARM, ", arm of the weight"), (OTHER_ARM, ", other arm"))
        for what, get in (
            (f"within {100.0 * FORCE_TOLERANCE:g} %", lambda one: one.right),
            ("in the stated interval", lambda one: one.covered),
            ("scale known", lambda one: one.known),
        )
    }


def _worst_false(observer: ObserverSummary, law: str, suite: Suite) -> str:
    rates = [
        (contacts.rate.count / contacts.rate.hours, robot.robot, contacts.rate)
        for robot in observer.robots
        if law in (ALL, robot.law)
        for contacts in [observer.false_contacts(suite, robot.law, "robot", robot.robot)]
        if contacts is not None and contacts.rate.hours > 0.0
    ]
    if not rates:
        return "-"
    worst, name, rate = max(rates, key=lambda entry: entry[0])
    return f"{short_number(worst)}, {rate.count} in {short_number(rate.hours)} h ({name})"


def _rate(contacts: FalseContacts) -> str:
    rate = contacts.rate
    return f"{rate_text(rate)}, {rate.count} in {short_number(rate.hours)} h"


def _idle(contacts: FalseContacts) -> str:
    if contacts.seconds_per_hour is None or contacts.fraction_of_time is None:
        return "-"
    return f"{short_number(contacts.seconds_per_hour)} s; {_percent(contacts.fraction_of_time)}"


def _end(ends: Ends) -> str:
    error = ends.error
    if error.median is None or error.p90 is None:
        return "-"
    early = f"{ends.early.count} early" if ends.early.count else "none early"
    lasting = f", {ends.open} without an end" if ends.open else ""
    return f"{_ms(error.median)} / {_ms(error.p90)} ms ({error.of}; {early}{lasting})"


def _torque(torques: Torques) -> str:
    return (
        "-"
        if torques.rmse is None
        else f"{torques.rmse:.2f} N m; {number(torques.r2)} ({torques.pairs})"
    )


# -- compared with simulated robots -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SimulatedRobots:
    """Simulated robots with which recorded ones are compared: their ``summary``, and ``what`` they are."""

    summary: TouchSummary
    what: str


def comparison_table(
    summary: TouchSummary,
    observer: ObserverSummary,
    simulated_robots: SimulatedRobots,
    ours: str = FUSION,
) -> list[str]:
    """Write the main results of recorded robots in columns next to those of simulated ones."""
    others = simulated_robots.summary.observer(ours)
    if others is None:
        return []
    laws = simulated_robots.summary.laws
    places = dict.fromkeys((*HEADLINE_PLACES, *summary.places))
    rows = []
    for place in places:
        own = [observer.group(law, place, "standing") for law in summary.laws]
        if any(own):
            parts = [cell.detected for cell in own if cell]
            detected = Fraction.counted(
                sum(part.count for part in parts), sum(part.of for part in parts)
            )
            values = [_n90_and_worst(cell) for cell in own]
            values += [_n90_and_worst(others.group(law, place, "standing")) for law in laws]
            rows.append([place, fraction_text(detected), *values])
    mine, theirs = _results(observer), _results(others)
    columns = (*laws, *((ALL,) if len(laws) > 1 else ()))
    return section(
        "Compared with simulated robots",
        f"Recorded robots of this page, and {simulated_robots.what}. A person chooses how firmly to touch, simulated "
        "people touch with 2 to 30 N from all sides: fractions of touches that are detected compare only at known "
        "forces, N90 and false contacts do.",
        table(
            (
                "place, standing",
                "recorded: detected",
                *("recorded: N90 [N]" for _ in summary.laws),
                *(f"simulated, `{law}`: N90 [N]" for law in laws),
            ),
            rows,
        ),
        table(
            ("result", "recorded", *(f"simulated, {_law_name(law)}" for law in columns)),
            [
                [name, value(ALL), *(theirs[name](law) for law in columns)]
                for name, value in mine.items()
            ],
        ),
    )


def _law_name(law: str) -> str:
    return "all" if law == ALL else f"`{law}`"


# -- N90, recall, rows ------------------------------------------------------------------------------------------------


def pictures_of(pictures: Mapping[str, str]) -> list[str]:
    """Write the pictures, each with its caption."""
    return section(
        "N90 on the robot, and touches detected by force",
        *(f"![{Path(path).stem}]({path})\n\n{caption}" for path, caption in pictures.items()),
    )


def n90_table(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write N90 of every place and state, with the worst robot, the number of touches and the friction bound."""
    laws = summary.laws
    header = ["place, state"]
    for law in laws:
        header += [f"N90 [N], `{law}`", "worst", "touches", "friction bound [N]"]
    rows = []
    for place in summary.places:
        for title, cells in _cells(summary, observer, place):
            columns = [cells.get(law) for law in laws]
            if any(columns):
                rows.append([f"{place}, {title}", *(c for cell in columns for c in _n90(cell))])
    return section(
        "N90 by place and state",
        table(header, rows),
        "States in capitals are pooled. An N90 below the friction bound is no mistake: a joint may rest anywhere in "
        "the band of its friction, and one that moves has none to hide in.",
    )


def _cells(
    summary: TouchSummary, observer: ObserverSummary, place: str
) -> Iterator[tuple[str, dict[str, Cell | None]]]:
    """Yield the groups of states, in capitals, then the states, each with its cells by law."""
    for group in GROUPS:
        yield group.upper(), {law: observer.group(law, place, group) for law in summary.laws}
    alone = [states[0] for states in GROUPS.values() if len(states) == 1]
    for state in summary.states:
        if state not in alone:
            yield state, {law: observer.cell(law, place, state) for law in summary.laws}


def _n90(cell: Cell | None) -> tuple[str, str, str, str]:
    if cell is None:
        return "-", "-", "-", "-"
    value = cell.n90
    worst = "-" if value is None or value.robots < 2 else value.worst_text
    return (
        "-" if value is None else value.text,
        worst,
        str(cell.detected.of),
        "-" if cell.bound is None else short_number(cell.bound),
    )


def detection_table(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write the fraction of touches that are detected at each place, where the force of some is unknown."""
    cells = observer.cells
    if all(cell.n90 is not None and cell.n90.touches == cell.detected.of for cell in cells):
        return []
    states = [state for state in summary.states if any(cell.state == state for cell in cells)]
    rows = []
    for place in summary.places:
        for state in states:
            found = [observer.cell(law, place, state) for law in summary.laws]
            if any(found):
                detected = ["-" if cell is None else fraction_text(cell.detected) for cell in found]
                rows.append([f"{place}, {state}", *detected])
    return section(
        "Touches detected by place",
        table(("place, state", *(f"detected, `{law}`" for law in summary.laws)), rows),
        "All touches, of known force or not: the fraction depends on how firmly people touched.",
    )


def recall_table(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write the fraction of touches that are detected by the force that the suite asked for."""
    forces = sorted({one.asked for cell in observer.groups for one in cell.forces})
    rows = []
    for place in summary.places:
        for group in GROUPS:
            for law in summary.laws:
                cell = observer.group(law, place, group)
                if cell is not None and cell.forces:
                    found = {one.asked: one for one in cell.forces}
                    cells = [
                        _force_fraction(found[force]) if force in found else "-" for force in forces
                    ]
                    rows.append([f"{place}, {group}, `{law}`", *cells])
    return section(
        "Touches detected by force",
        table(("place, states, boards", *(f"{force:g} N" for force in forces)), rows),
        f"Detected of how many, by the force that the suite asks for; after `at` the median of those that acted, where "
        f"it is below {LOWERED:g} of that. The pictures have the intervals.",
    )


def _force_fraction(one: ForceFraction) -> str:
    lowered = f" at {short_number(one.acted)} N" if one.acted < LOWERED * one.asked else ""
    return f"{one.detected.count}/{one.detected.of}{lowered}"


def rows_table(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write the other rows of the suites, by law, and by place and group of states where there is more than one."""
    rows = []
    for row in summary.rows:
        found = [one for one in observer.rows if one.row == row]
        for place, state in dict.fromkeys((one.place, one.state) for one in found):
            by_law = {one.law: one for one in found if (one.place, one.state) == (place, state)}
            kind = ", ".join(name for name in (place, state) if name != ALL)
            rows.append(
                [
                    f"... {kind}" if kind else f"**{row}**",
                    *(_row_fraction(by_law.get(law)) for law in summary.laws),
                    _row_force(by_law.get(ALL)),
                ]
            )
    return section(
        "Other touches",
        table(
            ("row", *(f"detected, `{law}`" for law in summary.laws), "force that acted [N]"), rows
        ),
        "The force is the median over touches of the largest force of each.",
        *_other_n90(summary, observer),
    )


def _other_n90(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write N90 of the rows that have several forces: along the axis, taps, and touches of another length."""
    found = {(one.row, one.place, one.law): one.n90 for one in observer.rows if one.n90 is not None}
    if not found:
        return []
    kinds = dict.fromkeys((row, place) for row, place, _ in found)
    header = ["row, place", *(f"N90 [N], `{law}`" for law in summary.laws)]
    rows = [
        [
            row if place == ALL else f"{row}, {place}",
            *(_n90_text(found.get((row, place, law))) for law in summary.laws),
        ]
        for row, place in kinds
    ]
    return [
        table(header, rows),
        "N90 of these touches, all states of the row pooled. Few forces were tried: between two of them it is the "
        "curve's.",
    ]


def _n90_text(value: N90 | None) -> str:
    return "-" if value is None else f"{value.text}; {value.touches} touches"


def _row_fraction(row: RowFraction | None) -> str:
    return "-" if row is None else fraction_text(row.detected)


def _row_force(row: RowFraction | None) -> str:
    return "-" if row is None or row.force is None else short_number(row.force)


def kinds_table(observer: ObserverSummary) -> list[str]:
    """Write the kinds that were reported of touches whose true kind is known."""
    found = {kind for kinds in observer.kinds for kind in kinds.reported}
    columns = [kind for kind in get_args(Kind) if kind in found]
    header = (
        "true kind",
        *columns,
        "not detected",
        "right, of detected ones",
        "end after the release",
    )
    rows = [
        [
            f"**{one.true}**",
            *(str(one.reported.get(kind, 0)) for kind in columns),
            str(one.not_detected),
            fraction_text(one.right),
            delay_text(one.end),
        ]
        for one in observer.kinds
    ]
    return section(
        "Kinds of touches",
        table(header, rows),
        "Touches by their true kind and the last kind of the contact that detected them. A *tap* lasts for up to "
        f"{MAX_TAP_TIME:g} s, a *push* for up to {MAX_PUSH_TIME:g} s, a *hold* longer. A second tap within "
        f"{MAX_TAP_PAUSE:g} s is a *double tap*. A force of {STRONG_FORCE:g} N and more that rises within "
        f"{1e3 * FAST_RISE:.0f} ms is a *collision*, a handshake a *grip*. Other hands that hold on, objects in the "
        "hand, touches during another one on the limb, and times too near to a limit have no true kind. The end is "
        "that of contacts with the right kind, median / p90: it reports a tap.",
    )


# -- false contacts ---------------------------------------------------------------------------------------------------


def false_contacts(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write the false contacts by kind of take, by part and joint, by state, and by robot."""
    laws = summary.laws
    kinds = []
    for suite, title in SUITES.items():
        for law in laws:
            contacts = observer.false_contacts(suite, law)
            if contacts is not None and contacts.hours > 0.0:
                kinds.append([f"{title}, `{law}`", *_false_cells(contacts)])
    if not kinds:
        return []
    header = (
        "takes",
        "hours",
        "begins",
        "moves",
        "per hour",
        "after a release",
        "another limb touched",
        "called rebounds",
        "seconds per hour",
        "of the time",
        "rebounds reported as such",
        "limb left open",
    )
    by_law = [f"`{law}`" for law in laws]

    def joints(by: By, names: Iterable[str]) -> list[list[str]]:
        found = {
            name: [observer.false_contacts(ALL, law, by, name) for law in laws] for name in names
        }
        return [
            [_joint_name(by, name), *map(_count_and_rate, columns)]
            for name, columns in found.items()
            if by == "part" or any(c is not None and c.events for c in columns)
        ]

    names = {by: _names(observer, by) for by in ("limb", "joint", "state")}
    arms = [limb for limb in names["limb"] if limb not in PARTS]
    states = [
        [state, *(_state_rate(observer.false_contacts(ALL, law, "state", state)) for law in laws)]
        for state in names["state"]
    ]
    return section(
        "False contacts",
        table(header, kinds),
        "By part of the robot, then by joint of both sides, per hour of all takes; a joint without a row had none:",
        table(
            ("joint", *by_law),
            [
                *joints("part", PARTS),
                *joints("limb", arms),
                *joints("joint", names["joint"]),
            ],
        ),
        "By state, all takes:",
        table(("state", *by_law), states),
        "By robot:",
        _robots_table(summary, observer),
    )


def _joint_name(by: By, name: str) -> str:
    if by == "part":
        return f"**{name}**"
    return "no joint named (trunk)" if name == TRUNK else name


def _names(observer: ObserverSummary, by: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(group.name for group in observer.false if group.by == by))


def _false_cells(contacts: FalseContacts) -> list[str]:
    of_time = contacts.fraction_of_time
    return [
        short_number(contacts.hours),
        str(contacts.begins),
        str(contacts.moves),
        rate_text(contacts.rate),
        str(contacts.after_release),
        str(contacts.other_touched),
        str(contacts.rebounds),
        "-" if contacts.seconds_per_hour is None else short_number(contacts.seconds_per_hour),
        "-" if of_time is None else _percent(of_time),
        "-" if contacts.reported_rebounds is None else str(contacts.reported_rebounds),
        "-" if contacts.open_limbs is None else str(contacts.open_limbs),
    ]


def _count_and_rate(contacts: FalseContacts | None) -> str:
    if contacts is None or contacts.rate.per_hour is None:
        return "-"
    return f"{contacts.events}, {rate_text(contacts.rate)}/h" if contacts.events else "0"


def _state_rate(contacts: FalseContacts | None) -> str:
    return "-" if contacts is None or contacts.hours <= 0.0 else _rate(contacts)


def _robots_table(summary: TouchSummary, observer: ObserverSummary) -> str:
    found = {robot.robot: robot for robot in observer.robots}
    rows = []
    for robot in summary.robots:
        one = found.get(robot.robot)
        free, touch = (
            observer.false_contacts(suite, robot.law, "robot", robot.robot)
            for suite in ("free", "touch")
        )
        rows.append(
            [
                f"{robot.robot}, `{robot.law}`" + (", not identified" if robot.failure else ""),
                "-" if one is None else fraction_text(one.detected),
                _state_rate(free),
                _state_rate(touch),
                number(robot.fit, 1),
            ]
        )
    return table(
        ("robot", "detected of row `even`", "false, left alone", "false, people touch", "fit [%]"),
        rows,
    )


# -- other observers --------------------------------------------------------------------------------------------------


def baselines(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write a row for each observer that is no ablation: ours first, each baseline as published and as matched."""
    laws = summary.laws
    others = [
        other
        for other in summary.observers
        if other.robots and other.name not in ABLATIONS and other.name != observer.name
    ]
    if not others:
        return []
    places = [(group, law) for group in ("standing", "in motion") for law in laws]
    header = [
        "observer",
        *(f"N90 hand, {group}, `{law}`" for group, law in places),
        "detected of row `even`",
        "false/h, left alone",
        "false/h, people touch",
        *(f"false/h, {part}" for part in PARTS),
        "delay [ms]",
        "joint right 150 ms later",
    ]
    rows = []
    for one in (observer, *others):
        cells = [one.group(law, "hand", group) for group, law in places]
        rows.append(
            [
                f"`{one.name}`",
                *("-" if c is None or c.n90 is None else c.n90.text for c in cells),
                fraction_text(one.detected()),
                *(_per_hour(one.false_contacts(suite)) for suite in ("free", "touch")),
                *(_per_hour(one.false_contacts(ALL, ALL, "part", part)) for part in PARTS),
                delay_text(one.delays[0].fast, unit="") if one.delays else "-",
                fraction_text(one.located[0].joint_later, counts=False) if one.located else "-",
            ]
        )
    return section(
        "Compared with other observers",
        table(header, rows),
        "All see the same ticks of the same robots, with models of each robot. `NAME` has the threshold that was "
        "published; `NAME@matched` the lowest of those tried that gives at most the false contacts of ours on the "
        "development robots, chosen once. The paper moved and watched shoulders and elbows alone, hence the parts of "
        "the robot.",
    )


def _per_hour(contacts: FalseContacts | None) -> str:
    rate = None if contacts is None else contacts.rate.per_hour
    return "-" if rate is None else short_number(rate)


def ablations(summary: TouchSummary, observer: ObserverSummary) -> list[str]:
    """Write what each ablation changes, robot by robot."""
    rows = []
    for name in ABLATIONS:
        other = summary.observer(name)
        if other is not None:
            pairs = [paired(observer, other, law) for law in summary.laws]
            rows.append(
                [
                    f"`{name}`",
                    *(_difference(pair.detected, 100.0) for pair in pairs),
                    *(_difference(pair.false_per_hour, 1.0) for pair in pairs),
                    " / ".join(str(pair.robots) for pair in pairs),
                ]
            )
    header = (
        "observer",
        *(f"detected [points], `{law}`" for law in summary.laws),
        *(f"false contacts [1/h], `{law}`" for law in summary.laws),
        "robots",
    )
    return section(
        "Without each part",
        table(header, rows),
        f"Difference to `{observer.name}` on the same robots and touches (row `even`; all takes), with 95 % intervals "
        "by bootstrap over robots. A part that helps has *detected* below 0 or false contacts above 0. Robots whose "
        "identification failed are left out.",
    )


def _difference(difference: Difference | None, scale: float) -> str:
    if difference is None:
        return "-"
    value, low, high = difference.value, difference.low, difference.high
    if low is None or high is None:
        return f"{scale * value:+.1f}"
    return f"{scale * value:+.1f} ({scale * low:+.1f} to {scale * high:+.1f})"


def models(summary: TouchSummary) -> list[str]:
    """Write the fit of the models of each robot, and the thresholds of each observer."""
    fits = [(robot.fit, robot.robot) for robot in summary.robots if robot.fit is not None]
    text = ""
    if fits:
        worst, name = min(fits)
        mean = sum(fit for fit, _ in fits) / len(fits)
        text = (
            f"Fit of the expected tracking error on a test run, mean of all joints: {mean:.1f} % over {len(fits)} "
            f"robots; the worst one is {name} with {worst:.1f} %."
        )
    observers = [one for one in summary.observers if one.threshold_deg]
    joints = dict.fromkeys(joint for one in observers for joint in one.threshold_deg)
    thresholds = table(
        ("median threshold [deg]", *(f"`{one.name}`" for one in observers)),
        [[joint, *(number(one.threshold_deg.get(joint)) for one in observers)] for joint in joints],
    )
    return section("Models and thresholds", text or thresholds, thresholds if text else "")


# -- what failed, ledger, limits --------------------------------------------------------------------------------------


def failures(summary: TouchSummary) -> list[str]:
    """Write what failed, what was drawn again or lowered, and who did not take part."""
    lines = []
    for robot in summary.robots:
        if robot.failure:
            lines.append(
                f"{robot.robot} (`{robot.law}`) could not be identified: {robot.failure}. Its {robot.touches} touches "
                "count as not detected by any observer; it has no hours."
            )
    for robot in summary.robots:
        for take, reason in robot.failed_takes.items():
            lines.append(f"{robot.robot}, take {take} could not be performed: {reason}")
    planned = sum(robot.failed_touches for robot in summary.robots)
    if planned:
        lines.append(f"{planned} touches planned for these takes are in no result.")
    redrawn, takes = (sum(getattr(r, n) for r in summary.robots) for n in ("redrawn", "takes"))
    reasons = Counter[str]()
    for robot in summary.robots:
        reasons.update(robot.redraws)
    why = "; ".join(f"{count} times {reason}" for reason, count in reasons.most_common(5))
    if takes:
        lines.append(f"{redrawn} of {takes} takes were drawn again{f' ({why})' if why else ''}.")
    for one in summary.observers:
        for reason, count in one.failures.items():
            lines.append(
                f"`{one.name}` has no result of {count} takes, whose touches count as not detected: {reason}"
            )
        if not one.robots:
            lines.append(f"`{one.name}` was judged on no robot.")
        elif one.left_out:
            lines.append(
                f"`{one.name}` did not see every take of {', '.join(one.left_out)}: left out of all its results."
            )
    warned = [robot.robot for robot in summary.robots if robot.warnings]
    if warned:
        lines.append(f"The identification warned of {len(warned)} robots: {', '.join(warned)}.")
    lowered = table(
        ("place", "lowered", "of touches", "largest force [N]"),
        [
            [one.place, str(one.lowered), str(one.of), short_number(one.max_force)]
            for one in summary.lowered
            if one.lowered
        ],
    )
    return section(
        "What failed, was drawn again or lowered",
        "\n".join(f"- {line}" for line in lines),
        f"Forces that were lowered because they would tip the robot (below {LOWERED:g} of what was asked):"
        if lowered
        else "",
        lowered,
    )


def ledger_table(ledger: Sequence[Mapping[str, str]], looks: int | None = None) -> list[str]:
    """Write the looks at the test split; ``looks`` is their number, None for that of the lines."""
    count = len(ledger) if looks is None else looks
    columns = list(dict.fromkeys(column for line in ledger for column in line))
    rows = [[_ledger_cell(column, line.get(column, "")) for column in columns] for line in ledger]
    said = {0: "No look at the test robots yet.", 1: "One look at test robots so far."}.get(
        count, f"{count} looks at test robots so far."
    )
    return section(
        "Looks at the test robots",
        f"{said} A look is written down when it begins; after one that led to a change the next hundred of draws is "
        "used.",
        table([column.replace("_", " ") for column in columns], rows),
    )


def _ledger_cell(column: str, value: str) -> str:
    if column in ("commit", "code", "constants", "suites"):
        value = value[:_DIGEST]
    return value.replace("|", "/").replace("\n", " ") or "-"


def limits(
    summary: TouchSummary, *, development: bool = False, simulated: bool = True
) -> list[str]:
    """Write what the results do not say."""
    lines = []
    if simulated:
        lines.append(
            "In simulation: no result here is of a real robot. Masses, friction, boards and people are models."
        )
    if development:
        lines.append(
            "Development robots: constants may have been chosen on them. Only the test split counts."
        )
    counts = {law: sum(r.law == law for r in summary.robots) for law in summary.laws}
    few = [f"{count} of `{law}`" for law, count in counts.items() if count < FEW_ROBOTS]
    if few:
        lines.append(
            f"Few robots ({', '.join(few)}): intervals by bootstrap over fewer than {FEW_ROBOTS} robots are too short."
        )
    lines += [
        "Intervals of fractions and rates take touches and false contacts as independent; those of one robot are "
        "alike, so the true intervals are wider.",
        "Cells of single states have few touches: a strong one that is missed may alone lift their N90 beyond all "
        "forces. Read the pooled rows first.",
        f"An N90 beyond {MAX_FORCE:g} N is none: stronger touches are not made. Where less acted, as on the trunk, "
        "`> 14` says that no touch was stronger than 14 N.",
        f"False contacts until {AFTER_RELEASE:g} s after a release on the limb are marked, not excused.",
    ]
    return section("Limits", "\n".join(f"- {line}" for line in lines))


# -- text -------------------------------------------------------------------------------------------------------------


def short_number(value: float) -> str:
    """Return a number with three digits at most: ``0.52``, ``7.4``, ``13``."""
    if math.isinf(value):
        return "inf"
    digits = 2 if abs(value) < 1.0 else 1 if abs(value) < 10.0 else 0
    return f"{value:.{digits}f}"


def fraction_text(fraction: Fraction, *, counts: bool = True) -> str:
    """Return a fraction, its interval and its counts: ``0.83 (0.55-0.95), 10 of 12``."""
    if fraction.fraction is None:
        return "-"
    text = f"{fraction.fraction:.2f} ({fraction.low:.2f}-{fraction.high:.2f})"
    return f"{text}, {fraction.count} of {fraction.of}" if counts else text


def rate_text(rate: Rate) -> str:
    """Return a rate and its interval: ``3.1 (1.0-7.3)``."""
    if rate.per_hour is None:
        return "-"
    return f"{short_number(rate.per_hour)} ({short_number(rate.low)}-{short_number(rate.high)})"


def delay_text(quantiles: Quantiles, unit: str = " ms") -> str:
    """Return median and p90, and the numbers detected and made: ``132 / 180 ms (40 of 60)``."""
    if quantiles.median is None or quantiles.p90 is None:
        return "-"
    values = f"{_ms(quantiles.median)} / {_ms(quantiles.p90)}{unit}"
    return f"{values} ({quantiles.count} of {quantiles.of})"


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.3f} %"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"
