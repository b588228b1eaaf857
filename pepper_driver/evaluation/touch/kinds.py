"""True kinds of touches, as they follow from what a person did."""

from __future__ import annotations

from collections.abc import Sequence

from pepper_driver.config.contact_selector import Kind
from pepper_driver.evaluation.touch.records import LOG, Take, Touched
from pepper_driver.evaluation.touch.summary_data import FAST_RISE, STRONG_FORCE

MAX_TAP_TIME, MAX_PUSH_TIME, MAX_TAP_PAUSE = 0.35, 2.0, 0.8
"""[s] Times of `docs/observer.md`, as constants of the judge: a change of the observer does not change the truth."""

UNCLEAR_TIME = 0.1
"""[s] A touch whose time is so near to one of them has no true kind."""

LABEL_EXCESS = 0.3
"""[s] A person marks a touch before it begins and after it ends: the label may be longer by so much."""

HANDSHAKE, OBJECT_IN_HAND = "handshake", "object handed over and taken away"
"""Rows whose kind does not follow from their times."""

UNSHARPENED: tuple[Kind, ...] = ("contact", "collision", "rebound")
"""Kinds of every observer. One that reports no other kind is not scored by kinds."""

UNKNOWN_IN_LOGS: tuple[Kind, ...] = ("collision", "grip")
"""Kinds that are neither right nor wrong in a log: a label does not say how fast a force rises, and to which sides."""


def true_kinds(take: Take) -> tuple[Kind | None, ...]:
    """Return the true kind of each touch of a take, None where there is none.

    - ``collision``: a force of STRONG_FORCE or more that rises within FAST_RISE, however long it lasts.
    - ``tap``, ``push`` or ``hold``: every other push, by its time. A second tap within MAX_TAP_PAUSE is a
      ``double tap``; a third one has no kind.
    - ``grip``: HANDSHAKE, where a hand pushes and pulls in turn.
    - None: other hands that hold on, an object in the hand, a touch by an object of the world, a touch during
      another one on the same limb, a touch whose label has no end, and a time that is not clear.
    """
    kinds: list[Kind | None] = []
    taps: dict[str, tuple[int, float]] = {}
    for number, touch in enumerate(take.touches):
        kind = None if _overlaps_another(take.touches, number) else _kind(touch, take.end)
        if kind == "tap":
            count, end = taps.get(touch.limb, (0, 0.0))
            count = count + 1 if touch.onset - end <= MAX_TAP_PAUSE else 1
            taps[touch.limb] = count, touch.release
            kind = "tap" if count == 1 else "double tap" if count == 2 else None
        kinds.append(kind)
    return tuple(kinds)


def _overlaps_another(touches: Sequence[Touched], number: int) -> bool:
    touch = touches[number]
    return any(
        other.limb == touch.limb and other.onset <= touch.release and other.release >= touch.onset
        for place, other in enumerate(touches)
        if place != number
    )


def _kind(touch: Touched, end: float) -> Kind | None:
    """Return the kind of a touch alone."""
    if touch.row == HANDSHAKE:
        return "grip"
    hand = touch.rise is None and touch.row != LOG
    if hand or touch.row == OBJECT_IN_HAND or touch.release >= end:
        return None
    strong = touch.force is not None and touch.force >= STRONG_FORCE
    if strong and touch.rise is not None and touch.rise <= FAST_RISE:
        return "collision"
    time = touch.release - touch.onset
    excess = LABEL_EXCESS if touch.row == LOG else UNCLEAR_TIME
    if any(
        limit - UNCLEAR_TIME <= time <= limit + excess for limit in (MAX_TAP_TIME, MAX_PUSH_TIME)
    ):
        return None
    return "tap" if time < MAX_TAP_TIME else "push" if time < MAX_PUSH_TIME else "hold"
