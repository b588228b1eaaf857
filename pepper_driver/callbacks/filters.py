"""Predicates that pick events. Names are checked when a predicate is made, not when the event comes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from numbers import Integral
from typing import Any, TypedDict, get_args

from pepper_driver.callbacks.events import TickEvent
from pepper_driver.config import PepperError, RobotConfig, UnknownNameError
from pepper_driver.config.contact_selector import KNOWN_AT_END, ContactSelector, Kind, SelectorError
from pepper_driver.config.errors import shown
from pepper_driver.observer.interface import Contact, Phase

MAX_COUNT = 1_000_000
"""Of ticks and events."""

ContactPredicate = Callable[[Contact], bool]


class SubscriptionError(PepperError, ValueError):
    """Events were asked for that can never come; nothing was registered."""


class ContactArguments(TypedDict, total=False):
    """Arguments of a call that choose contacts: those of a :class:`ContactSelector`, and a phase.

    A contact grows, and where it is may be revised within 150 ms. ``phase="begin"`` therefore means the first event in
    which a contact that has begun is as described, once for each: its begin, or an update.

    Attributes:
        limb: One or several of the robot's limbs.
        link: One or several of its links.
        joint: One or several of its joints.
        kind: Kind of contact.
        min_intensity_deg: [deg]
        min_torque: [N m]
        min_force: [N]
        phase: ``begin``, the default; ``update``; ``end``; None for every event.
    """

    limb: str | Sequence[str] | None
    link: str | Sequence[str] | None
    joint: str | Sequence[str] | None
    kind: Kind | None
    min_intensity_deg: float
    min_torque: float
    min_force: float
    phase: Phase | None


def contact_filter(
    robot: RobotConfig,
    *,
    phase: Phase | None = "begin",
    **selector: Any,  # noqa: ANN401 checked by the selector
) -> ContactPredicate:
    """Return a predicate that picks contacts of a ``robot``; the arguments are those of :class:`ContactArguments`.

    Raises:
        UnknownNameError: No such limb, link, joint, kind or phase.
        SubscriptionError: A wrong argument, or a choice that no contact can meet.
    """
    try:
        return selector_filter(robot, ContactSelector.from_arguments(**selector), phase=phase)
    except SelectorError as error:
        raise SubscriptionError(str(error)) from error


def selector_filter(
    robot: RobotConfig, selector: ContactSelector, *, phase: Phase | None = "begin"
) -> ContactPredicate:
    """Return a predicate that picks contacts of a ``robot`` by a selector and a phase.

    Raises:
        UnknownNameError: No such limb, link, joint or phase.
        SelectorError: No contact can meet all conditions.
    """
    selector.check(robot)
    in_phase = match(phase=("phase of a contact", phase, get_args(Phase)))
    begun: set[int] = set()  # and not selected yet

    def predicate(contact: Contact) -> bool:
        if contact.phase == "begin":
            begun.add(contact.id)
        elif contact.phase == "end" and selector.kind not in KNOWN_AT_END:
            begun.discard(contact.id)
        picked = (contact.id in begun if phase == "begin" else in_phase(contact)) and meets(
            contact, selector
        )
        if picked or contact.phase == "end":
            begun.discard(contact.id)
        return picked

    return predicate


def meets(contact: Contact, selector: ContactSelector) -> bool:
    """Return True where a contact, as it is reported now, meets all conditions of a selector."""
    return (
        (not selector.limb or contact.limb in selector.limb)
        and (not selector.link or contact.link in selector.link)
        and (not selector.joint or contact.joint in selector.joint)
        and (contact.kind == selector.kind if selector.kind else contact.kind != "rebound")
        and contact.intensity_deg >= selector.min_intensity_deg
        and (not selector.min_torque or abs(contact.torque or 0.0) >= selector.min_torque)
        and (not selector.min_force or (contact.force_size or 0.0) >= selector.min_force)
    )


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
        **fields: Human-readable name of the field; its value, or None for any; possible values.

    Raises:
        UnknownNameError: A value is not possible.
    """
    for name, value, known in fields.values():
        if value is None:
            continue
        choices = tuple(known)
        # Only of their type: 1 equals True, and what an array equals is an array.
        if not isinstance(value, tuple({type(choice) for choice in choices})) or (
            value not in choices
        ):
            raise UnknownNameError(name, value, choices)
    chosen = [(field, value) for field, (_, value, _) in fields.items() if value is not None]
    return lambda event: all([getattr(event, field) == value for field, value in chosen])


def check_count(name: str, number: int) -> None:
    """Refuse what is no whole number from 1 to a million.

    Raises:
        SubscriptionError: It is not a duration.
    """
    if isinstance(number, bool) or not isinstance(number, Integral) or not 1 <= number <= MAX_COUNT:
        raise SubscriptionError(
            f"{name} must be a whole number from 1 to {MAX_COUNT}, got {shown(number)}"
        )
