"""Predicates that pick events. Names are checked when a predicate is made, not when the event comes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from numbers import Real
from typing import Any, TypedDict, get_args

from pepper_driver.callbacks.events import TickEvent
from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.observer.contact import Contact, Kind, Phase

ContactPredicate = Callable[[Contact], bool]


class SubscriptionError(PepperError, ValueError):
    """Events were asked for that can never come; nothing was registered."""


class ContactSelector(TypedDict, total=False):
    """Choice of contacts.

    A contact begins weak, and where it is turns out within 150 ms. ``phase="begin"`` therefore means the first event in
    which a contact that has begun is as described, once for each: its begin, or an update.

    Attributes:
        link: Only contacts on this link.
        joint: Only contacts felt by this joint.
        kind: Only this kind. None, the default, takes contacts and collisions: a rebound is no touch.
        phase: ``begin``, the default; ``update``; ``end``; None for every event.
        min_intensity: Only contacts of at least this intensity [deg].
    """

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
) -> ContactPredicate:
    """Return a predicate that picks contacts of a ``robot``; the other arguments are those of :class:`ContactSelector`.

    Raises:
        UnknownNameError: No such link, joint, kind or phase.
        SubscriptionError: An intensity that is negative or not a number.
    """
    named = match(
        link=("link", link, robot.links),
        joint=("joint", joint, robot.joint_names),
        kind=("kind of contact", kind, get_args(Kind)),
    )
    in_phase = match(phase=("phase of a contact", phase, get_args(Phase)))
    if not (isinstance(min_intensity, Real) and min_intensity >= 0):  # NaN is neither
        raise SubscriptionError(f"min_intensity must be degrees from 0 up, got {min_intensity!r}")
    begun: set[int] = set()  # and not picked yet

    def predicate(contact: Contact) -> bool:
        if contact.phase == "begin":
            begun.add(contact.id)
        elif contact.phase == "end":
            begun.discard(contact.id)
        picked = (
            (contact.id in begun if phase == "begin" else in_phase(contact))
            and named(contact)
            and (kind is not None or contact.kind != "rebound")
            and contact.intensity >= min_intensity
        )
        if picked:
            begun.discard(contact.id)
        return picked

    return predicate


def tick_filter(every: int) -> Callable[[TickEvent], bool]:
    """Return a predicate that picks the first tick of a run, and each that is ``every`` cycles or more behind the last.

    Raises:
        SubscriptionError: That is no number of ticks.
    """
    check_count("every", every)
    due = 0

    def predicate(event: TickEvent) -> bool:
        nonlocal due
        tick = event.tick.measurement.tick
        picked = not due - every < tick < due  # a lower number is that of a new run
        due = tick + every if picked else due
        return picked

    return predicate


def match(**fields: tuple[str, Any, Iterable[Any]]) -> Callable[[Any], bool]:
    """Return a predicate that picks events by their fields.

    Args:
        **fields: Name of the field for people; its value, or None for any; possible values.

    Raises:
        UnknownNameError: A value is not possible.
    """
    for name, value, known in fields.values():
        if value is not None and value not in (choices := tuple(known)):
            raise UnknownNameError(name, value, choices)
    chosen = [(field, value) for field, (_, value, _) in fields.items() if value is not None]
    return lambda event: all([getattr(event, field) == value for field, value in chosen])


def check_count(name: str, number: int) -> None:
    """Refuse what is no whole number from 1 up.

    Raises:
        SubscriptionError: It is none.
    """
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        raise SubscriptionError(f"{name} must be a whole number from 1 up, got {number!r}")
