"""Which events a callback wants. Names are checked when a filter is made, not when the event comes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from numbers import Real
from typing import TypedDict, get_args

from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.events import (
    CueEvent,
    CueKind,
    ReflexEvent,
    ReflexPhase,
    SensorEvent,
    SensorKind,
    TickEvent,
)
from pepper_driver.observer.contact import Contact, Kind, Phase

ContactFilter = Callable[[Contact], bool]


class ListeningError(PepperError, ValueError):
    """What was asked for can never be heard; nothing was registered."""


class ContactChoice(TypedDict, total=False):
    """What :func:`contact_filter` picks by."""

    link: str | None
    joint: str | None
    kind: Kind | None
    phase: Phase | None
    min_intensity: float


def contact_filter(
    robot: RobotConfig,
    *,
    link: str | None = None,
    joint: str | None = None,
    kind: Kind | None = None,
    phase: Phase | None = "begin",
    min_intensity: float = 0.0,
) -> ContactFilter:
    """Picks contacts.

    A contact begins weak, and where it is turns out within 150 ms. ``phase="begin"`` therefore means the first event in
    which a contact that has begun is as described, once for each: its begin, or an update.

    Args:
        robot: Whose links and joints are meant.
        link: Only contacts on this link.
        joint: Only contacts felt by this joint.
        kind: Only this kind. None takes contacts and collisions: a rebound is no touch.
        phase: ``begin``, ``update``, ``end``. None takes every event.
        min_intensity: Only contacts of at least this intensity [deg].

    Raises:
        UnknownNameError: No such link, joint, kind or phase.
        ListeningError: An intensity that is negative or not a number.
    """
    _check("link", link, robot.links)
    _check("joint", joint, robot.joint_names)
    _check("kind of contact", kind, get_args(Kind))
    _check("phase of a contact", phase, get_args(Phase))
    if not (isinstance(min_intensity, Real) and min_intensity >= 0):  # NaN is neither
        raise ListeningError(
            f"min_intensity must be an angle [deg] of 0 or more, got {min_intensity!r}"
        )

    def fits(contact: Contact) -> bool:
        return (
            (link is None or contact.link == link)
            and (joint is None or contact.joint == joint)
            and (contact.kind == kind if kind is not None else contact.kind != "rebound")
            and contact.intensity >= min_intensity
        )

    if phase == "begin":
        return _once(fits)
    return lambda contact: (phase is None or contact.phase == phase) and fits(contact)


def _once(fits: ContactFilter) -> ContactFilter:
    """Takes the first event of each contact that fits, of those whose begin it has seen."""
    waiting: set[int] = set()

    def wanted(contact: Contact) -> bool:
        if contact.phase == "begin":
            waiting.add(contact.id)
        elif contact.phase == "end":
            waiting.discard(contact.id)
        if contact.id not in waiting or not fits(contact):
            return False
        waiting.discard(contact.id)
        return True

    return wanted


def tick_filter(every: int) -> Callable[[TickEvent], bool]:
    """Picks the first tick of each run, and each that is ``every`` cycles or more behind the last one picked.

    Raises:
        ListeningError: That is no number of ticks.
    """
    check_count("every", every)
    last = due = 0

    def wanted(event: TickEvent) -> bool:
        nonlocal last, due
        before, last = last, event.tick.measurement.tick
        if before < last < due:
            return False
        due = last + every
        return True

    return wanted


def sensor_filter(
    kind: SensorKind, name: str | None, known: Iterable[str], pressed: bool | None
) -> Callable[[SensorEvent], bool]:
    """Picks edges of touch sensors, bumpers or buttons.

    Args:
        kind: Which sort of sensor.
        name: Only this sensor; None for all of the sort.
        known: What sensors of the sort there are.
        pressed: True for presses, False for releases, None for both.

    Raises:
        UnknownNameError: No such sensor.
        ListeningError: ``pressed`` is none of the three.
    """
    _check("touch sensor" if kind == "touch" else kind, name, known)
    if pressed is not None and not isinstance(pressed, bool):
        raise ListeningError(f"pressed must be True, False, or None for both, got {pressed!r}")
    return lambda event: (
        event.kind == kind
        and (name is None or event.name == name)
        and (pressed is None or event.pressed == pressed)
    )


def reflex_filter(
    name: str | None, known: Iterable[str], phase: ReflexPhase | None
) -> Callable[[ReflexEvent], bool]:
    """Picks events of reflexes.

    Args:
        name: Only this reflex; None for all.
        known: Names of the reflexes there are.
        phase: Only this phase; None for both.

    Raises:
        UnknownNameError: No such reflex or phase.
        ListeningError: There are no reflexes at all.
    """
    names = tuple(known)
    if name is not None and not names:
        raise ListeningError(
            f"there is no reflex '{name}': this robot has none; give it some with Pepper(reflexes=[...])"
        )
    _check("reflex", name, names)
    _check("phase of a reflex", phase, get_args(ReflexPhase))
    return lambda event: (
        (name is None or event.reflex == name) and (phase is None or event.phase == phase)
    )


def cue_filter(kind: CueKind | None) -> Callable[[CueEvent], bool]:
    """Picks cues of a kind; None takes all.

    Raises:
        UnknownNameError: No such kind.
    """
    _check("kind of cue", kind, get_args(CueKind))
    return lambda event: kind is None or event.kind == kind


def check_count(what: str, number: int) -> None:
    """Refuse what is no whole number from 1 up.

    Raises:
        ListeningError: It is none.
    """
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        raise ListeningError(f"{what} must be a whole number from 1 up, got {number!r}")


def _check(what: str, name: str | None, known: Iterable[str]) -> None:
    choices = tuple(known)
    if name is not None and name not in choices:
        raise UnknownNameError(what, name, choices)
