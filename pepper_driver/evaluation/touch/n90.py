"""N90: the force at which nine touches in ten are detected, with its interval; recall by force; intervals of rates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv, ndtri

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ArgumentError

CONFIDENCE = 0.95
"""Of all intervals."""

N90_FRACTION = 0.9
"""Fraction of touches that are detected at N90."""

MAX_FORCE = 30.0
"""[N] Touches of people end here; a larger N90 is none."""

MIDDLES = np.exp(np.linspace(math.log(0.5), math.log(200.0), 154))
"""[N] Forces at which half of the touches without a lapse are detected; a step is 4 %."""

SLOPES = (0.05, 0.08, 0.12, 0.2, 0.3, 0.45, 0.7, 1.0)
"""Widths of the curve in ln force."""

LAPSES = (0.0, 0.01, 0.02, 0.05, 0.08, 0.15, 0.25, 0.4)
"""Fractions of touches that are not detected at any force."""

LAPSE_PRIOR = 10.0
"""Few touches do not separate a lapse rate from a flat curve. It counts as if so many more touches, of any strength,
had been detected: a rate of a tenth then costs one unit of log likelihood, which a hundred touches outweigh."""

RESAMPLES = 400
SEED = 90
TIE = 1e-6
"""Log likelihoods that differ by less are equal: the order of a sum must not choose the result."""


class ForceTouch(NamedTuple):
    """One touch: its force [N], True if it was detected, the name of its robot."""

    force: float
    detected: bool
    robot: str


@dataclass(frozen=True, kw_only=True)
class N90:
    """Force at which the fraction N90_FRACTION of the touches is detected.

    Attributes:
        newtons: The force [N]; infinite where it is not reached until the limit.
        low, high: Its interval [N], bootstrap over robots, CONFIDENCE; None with one robot.
        worst: Largest N90 of one robot, with the slope and the lapse rate of all [N].
        worst_robot: Name of that robot.
        touches, robots: How many there are.
        lapse: Fraction of touches that are not detected at any force.
        slope: Width of the curve in ln force.
        min_force, max_force: Smallest and largest force of the touches [N].
        below: True if it is less than the smallest force; ``newtons`` is then that force.
    """

    newtons: float
    low: float | None
    high: float | None
    worst: float
    worst_robot: str
    touches: int
    robots: int
    lapse: float
    slope: float
    min_force: float
    max_force: float
    below: bool

    @property
    def text(self) -> str:
        """As ``7.4 (6.1-9.0)``, ``< 2`` or ``> 30``; ``> 13`` where no touch was stronger than 13 N."""
        if self.below:
            return f"< {self.min_force:.3g}"
        if self.low is None or self.high is None or math.isinf(self.newtons):
            return self._newtons(self.newtons)
        to = " to " if math.isinf(self.high) else "-"
        return f"{self._newtons(self.newtons)} ({self._newtons(self.low)}{to}{self._newtons(self.high)})"

    @property
    def worst_text(self) -> str:
        """N90 of the worst robot, as ``9.1`` or ``> 30``."""
        return self._newtons(self.worst)

    def _newtons(self, value: float) -> str:
        if math.isinf(value):
            return f"> {min(self.max_force, MAX_FORCE):.3g}"
        return f"{value:.1f}" if value < 10.0 else f"{value:.0f}"


@dataclass(frozen=True, kw_only=True)
class ForceRecall:
    """Touches of one force [N]: how many were detected, of how many, and the interval of the fraction."""

    force: float
    detected: int
    of: int
    low: float
    high: float

    @property
    def fraction(self) -> float:
        """Fraction that was detected."""
        return self.detected / self.of


def n90(
    touches: Sequence[ForceTouch],
    *,
    slopes: Sequence[float] = SLOPES,
    lapses: Sequence[float] = LAPSES,
    limit: float = MAX_FORCE,
) -> N90:
    """Fit P(detected | F) = (1 - lapse) / (1 + exp(-(ln F - ln middle) / slope)); return the force of N90_FRACTION.

    The likelihood is largest on a fixed grid, so the same touches give the same result in any order and on any
    machine. Of equally likely curves that with the largest N90 counts: touches that do not separate two curves must not
    make an observer look better. Nothing is known of forces below the smallest one.

    Args:
        touches: At least one; all forces above 0.
        slopes: Widths in ln force that may be.
        lapses: Lapse rates that may be, below 1.
        limit: A larger N90 is none [N].

    Raises:
        ArgumentError: No touches, or a force that is none.
    """
    if not touches:
        raise ArgumentError("N90 needs at least one touch, got none")
    wrong = [touch for touch in touches if not (0.0 < touch.force < math.inf)]
    if wrong:
        raise ArgumentError(f"forces of touches are above 0 N, got {wrong[0].force:g} N")
    robots = sorted({touch.robot for touch in touches})
    forces = sorted({touch.force for touch in touches})
    curves, likely = _log_likelihood(touches, robots, forces, slopes, lapses, limit)
    # Columns from the largest N90 down: the first of equally likely ones is the one that counts.
    order = np.lexsort((-curves[:, 0], -curves[:, 3]))
    curves, likely = curves[order], likely[:, order]

    best = int(_most_likely(likely.sum(axis=0, keepdims=True))[0])
    _, slope, lapse, found = (float(value) for value in curves[best])
    newtons = max(found, forces[0])
    low, high = _interval(curves, likely, forces[0])
    alike = np.flatnonzero((curves[:, 1] == slope) & (curves[:, 2] == lapse))
    own = alike[_most_likely(likely[:, alike])]
    # Where the lapse rate lets no robot reach N90_FRACTION, the middle of the curve decides which is the worst one.
    worst = int(np.argmax(curves[own, 0]))
    return N90(
        newtons=newtons,
        low=low,
        high=high,
        worst=max(float(curves[own[worst], 3]), forces[0]),
        worst_robot=robots[worst],
        touches=len(touches),
        robots=len(robots),
        lapse=lapse,
        slope=slope,
        min_force=forces[0],
        max_force=forces[-1],
        below=found < forces[0],
    )


def recall_by_force(touches: Iterable[ForceTouch]) -> tuple[ForceRecall, ...]:
    """Return the fraction of touches that were detected by their force, from the smallest force up."""
    groups: dict[float, list[bool]] = {}
    for touch in touches:
        groups.setdefault(touch.force, []).append(touch.detected)
    rows = []
    for force, answers in sorted(groups.items()):
        low, high = wilson_interval(sum(answers), len(answers))
        rows.append(
            ForceRecall(force=force, detected=sum(answers), of=len(answers), low=low, high=high)
        )
    return tuple(rows)


def wilson_interval(count: int, of: int) -> tuple[float, float]:
    """Interval of the probability behind ``count`` of ``of`` trials: Wilson's score, two-sided, CONFIDENCE."""
    if of == 0:
        return 0.0, 1.0
    z2 = float(ndtri((1.0 + CONFIDENCE) / 2.0)) ** 2
    centre = count + z2 / 2.0
    half = math.sqrt(z2 * (count * (of - count) / of + z2 / 4.0))
    low = 0.0 if count == 0 else (centre - half) / (of + z2)
    high = 1.0 if count == of else (centre + half) / (of + z2)
    return low, high


def poisson_interval(count: int, hours: float) -> tuple[float, float]:
    """Interval of the rate behind ``count`` events in ``hours`` [1/h]: exact Poisson, two-sided, CONFIDENCE."""
    if hours <= 0.0:
        return 0.0, math.inf
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(gammaincinv(count, tail)) if count > 0 else 0.0
    return low / hours, float(gammaincinv(count + 1, 1.0 - tail)) / hours


def _log_likelihood(
    touches: Sequence[ForceTouch],
    robots: Sequence[str],
    forces: Sequence[float],
    slopes: Sequence[float],
    lapses: Sequence[float],
    limit: float,
) -> tuple[FloatArray, FloatArray]:
    """Curves (n, 4) with middle, slope, lapse, N90; log likelihood (robots, n) of the touches of each robot."""
    grid = np.meshgrid(MIDDLES, slopes, lapses, indexing="ij")
    middle, slope, lapse = (axis.ravel() for axis in grid)
    reached = N90_FRACTION / (1.0 - lapse)
    # A curve with a larger lapse rate ends below N90_FRACTION.
    odds = np.where(reached < 1.0, reached / np.where(reached < 1.0, 1.0 - reached, 1.0), np.inf)
    value = middle * odds**slope
    value[value > limit] = np.inf

    z = (np.log(forces) - np.log(middle)[:, None]) / slope[:, None]
    log_curve = -np.logaddexp(0.0, -z)
    with np.errstate(divide="ignore"):
        log_lapse = np.log(lapse)[:, None]
    log_detected = np.log1p(-lapse)[:, None] + log_curve
    log_missed = np.logaddexp(-np.logaddexp(0.0, z), log_lapse + log_curve)

    detected, missed = np.zeros((2, len(robots), len(forces)))
    row = {name: n for n, name in enumerate(robots)}
    column = {force: n for n, force in enumerate(forces)}
    for touch in touches:
        (detected if touch.detected else missed)[row[touch.robot], column[touch.force]] += 1.0
    likely = detected @ log_detected.T + missed @ log_missed.T
    likely += LAPSE_PRIOR / len(robots) * np.log1p(-lapse)
    return np.stack((middle, slope, lapse, value), axis=1), likely


def _most_likely(likely: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """First column of each row that is the largest but for TIE."""
    near: np.ndarray[tuple[int], np.dtype[np.intp]] = np.argmax(
        likely >= likely.max(axis=1, keepdims=True) - TIE, axis=1
    )
    return near


def _interval(
    curves: FloatArray, likely: FloatArray, min_force: float
) -> tuple[float, float] | tuple[None, None]:
    count = len(likely)
    if count < 2:
        return None, None
    draws = np.random.default_rng(SEED).multinomial(count, np.full(count, 1.0 / count), RESAMPLES)
    values = np.sort(np.maximum(curves[_most_likely(draws @ likely), 3], min_force))
    # Ranks, not interpolation: some of the values may be infinite.
    out = math.floor((1.0 - CONFIDENCE) / 2.0 * RESAMPLES)
    return float(values[out]), float(values[RESAMPLES - 1 - out])
