"""Requests of pushes and grabs in a simulation: checks, and the force over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import cos, isfinite, pi
from typing import Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.interface import CommandError, finite_numbers
from pepper_driver.backends.simulated import Grab, Push
from pepper_driver.config.arguments import is_number
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import FARTHEST_PULL, SOFTEST_HAND, STIFFEST_HAND, Axes
from pepper_driver.config.errors import check_name, shown

MAX_PUSH_FORCE = 10_000.0
"""[N] Far beyond anything a robot survives; more would only break the simulation."""

MAX_POINT_DISTANCE = 1.0
"""[m] From the origin of a link to a point on it: no link is as large."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScheduledPush(Push):
    """Push that was checked: it rises and falls along half a cosine, in ``rise`` [s] each.

    Attributes:
        start: When it begins, by the clock of the simulation [s].
    """

    force: FloatArray
    point: FloatArray
    start: float

    @classmethod
    def of(cls, push: Push, centres: Mapping[str, ArrayLike], now: float) -> Self:
        """Check a push, and date it.

        Args:
            push: As it was asked for.
            centres: (3,) centre of mass of each link in its frame [m]: where it is pushed if no point is given.
            now: Clock of the simulation [s].

        Raises:
            UnknownNameError: No such link or frame.
            CommandError: A number that is not finite or out of range.
        """
        check_push(push, centres)
        duration = float(push.duration)
        return cls(
            link=push.link,
            force=np.array(push.force, dtype=np.float64),
            point=np.array(centres[push.link] if push.point is None else push.point, np.float64),
            duration=duration,
            frame=push.frame,
            delay=float(push.delay),
            rise=min(float(push.rise), duration / 3),
            start=now + push.delay,
        )

    @property
    def end(self) -> float:
        """Time when it is over [s]."""
        return self.start + self.duration

    def strength(self, time: float) -> float:
        """Fraction of the force that acts at ``time`` [s], 0..1."""
        since, until = time - self.start, self.end - time
        if since <= 0.0 or until <= 0.0:
            return 0.0
        edge = min(since, until)
        return 1.0 if edge >= self.rise else 0.5 - 0.5 * cos(pi * edge / self.rise)


def check_push(push: Push, links: Iterable[str]) -> None:
    """Refuse a push that no simulated robot with these links could take.

    Raises:
        UnknownNameError: No such link or frame.
        CommandError: A number that is not finite or out of range.
    """
    _check_place("push", push, links)
    _check_vector("push: force", push.force, MAX_PUSH_FORCE, "N")
    _check_number("push: duration", push.duration, above_zero=True)
    _check_number("push: rise", push.rise, above_zero=True)
    _check_number("push: delay", push.delay)


def check_grab(grab: Grab, links: Iterable[str]) -> None:
    """Refuse a hand that no simulated robot with these links could take, as :func:`check_push` a push."""
    _check_place("grab", grab, links)
    _check_vector("grab: pull", grab.pull, FARTHEST_PULL, "m")
    _check_number("grab: stiffness", grab.stiffness)
    if not SOFTEST_HAND <= grab.stiffness <= STIFFEST_HAND:
        raise CommandError(
            f"grab: stiffness must be {SOFTEST_HAND:g} to {STIFFEST_HAND:g} N/m, got {grab.stiffness:g}"
        )
    _check_number("grab: rise", grab.rise, above_zero=True)
    _check_number("grab: release", grab.release, above_zero=True)
    _check_number("grab: max_force", grab.max_force, above_zero=True)
    _check_number("grab: hold", grab.hold)
    _check_number("grab: delay", grab.delay)


def _check_place(what: str, contact: Push | Grab, links: Iterable[str]) -> None:
    check_name("link", contact.link, links)
    check_name("frame", contact.frame, get_args(Axes))
    if contact.point is not None:
        _check_vector(f"{what}: point", contact.point, MAX_POINT_DISTANCE, "m")


def _check_vector(name: str, value: ArrayLike, most: float, unit: str) -> None:
    size = float(np.linalg.norm(finite_numbers(name, value, 3)))
    if size > most:
        raise CommandError(f"{name}: at most {most:g} {unit}, got {size:.4g} {unit}")


def _check_number(name: str, value: object, *, above_zero: bool = False) -> None:
    if is_number(value) and isfinite(value) and (value > 0 or (value == 0 and not above_zero)):
        return
    range_text = "above 0" if above_zero else "from 0 up"
    raise CommandError(f"{name} must be a finite number {range_text}, got {shown(value)}")
