"""Pushes that a simulation is asked for: checked, and their strength in time."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import cos, pi

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.commands import check_push
from pepper_driver.config.arrays import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ScheduledPush:
    """One push: it rises and falls along half a cosine, in ``rise`` [s] each.

    Attributes:
        link: Name of the link.
        force: (3,) largest force [N].
        point: (3,) where it acts, in the link's frame [m].
        turns_with_link: True where ``force`` is in the axes of the link, not of the world.
        start: When it begins, by the clock of the simulation [s].
        duration: Length [s].
        rise: [s]
    """

    link: str
    force: FloatArray
    point: FloatArray
    turns_with_link: bool
    start: float
    duration: float
    rise: float

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


def schedule_push(
    link: str,
    force: ArrayLike,
    point: ArrayLike,
    *,
    links: Collection[str],
    now: float,
    duration: float,
    frame: str,
    delay: float,
    rise: float,
) -> ScheduledPush:
    """Return the push that :meth:`Backend.push` was asked for.

    Args:
        link: Name of the link.
        force: (3,) largest force [N] in ``frame``.
        point: (3,) where it acts, in the link's frame [m]; the link's centre of mass where none was given.
        links: Names of the links that there are.
        now: Clock of the simulation [s].
        duration: Length of the push [s].
        frame: ``world`` or ``link``.
        delay: Time until the push begins [s].
        rise: Time in which it rises, and falls again [s]; a third of the push where that is shorter.

    Raises:
        UnknownNameError: No such link or frame.
        CommandError: A number that is not finite or out of range.
    """
    check_push(
        links,
        link,
        force=force,
        point=point,
        duration=duration,
        frame=frame,
        delay=delay,
        rise=rise,
    )
    return ScheduledPush(
        link=link,
        force=np.array(force, dtype=np.float64),
        point=np.array(point, dtype=np.float64),
        turns_with_link=frame == "link",
        start=now + delay,
        duration=float(duration),
        rise=min(float(rise), float(duration) / 3),
    )
