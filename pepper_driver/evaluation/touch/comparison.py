"""Two observers on the same robots: differences, with intervals by bootstrap over robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.evaluation.touch.n90 import CONFIDENCE
from pepper_driver.evaluation.touch.summary_data import ALL, ObserverSummary, RobotResults

RESAMPLES = 2000
SEED = 23


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A difference, with its interval by bootstrap over robots; no interval of one robot."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class Paired:
    """Another observer minus ours, on the same robots.

    Attributes:
        law: Of the robots.
        robots: How many there are: identified, and judged for both.
        detected: In the fraction of touches of the row of N90 that are detected; None without touches.
        false_per_hour: In false contacts, begins and moves [1/h]; None without time.
    """

    law: str
    robots: int
    detected: Difference | None
    false_per_hour: Difference | None


def paired(ours: ObserverSummary, other: ObserverSummary, law: str = ALL) -> Paired:
    """Compare two observers, robot by robot: the same robots are drawn for both."""
    others = {robot.robot: robot for robot in other.robots if robot.identified}
    pairs = [
        (robot, others[robot.robot])
        for robot in ours.robots
        if robot.robot in others and law in (ALL, robot.law)
    ]
    return Paired(
        law=law,
        robots=len(pairs),
        detected=_difference([(_detected(a), _detected(b)) for a, b in pairs]),
        false_per_hour=_difference([(_alarms(a), _alarms(b)) for a, b in pairs]),
    )


Ratio = tuple[float, float]


def _detected(robot: RobotResults) -> Ratio:
    return robot.detected.count, robot.detected.of


def _alarms(robot: RobotResults) -> Ratio:
    return robot.false.events, robot.false.hours


def _difference(pairs: Sequence[tuple[Ratio, Ratio]]) -> Difference | None:
    """Return the difference of two pooled ratios, each (count, size) of a robot."""
    values = np.array([pair for pair in pairs if pair[0][1] > 0 and pair[1][1] > 0], np.float64)
    if not len(values):
        return None
    count = len(values)
    draws = np.random.default_rng(SEED).multinomial(count, np.full(count, 1 / count), RESAMPLES)
    # (1 + RESAMPLES, observer, count and size): all robots once, then those drawn.
    sums = np.tensordot(np.vstack([np.ones((1, count)), draws]), values, axes=1)
    tail = (1.0 - CONFIDENCE) / 2.0
    ratios = sums[..., 0] / sums[..., 1]
    difference = ratios[:, 1] - ratios[:, 0]
    low, high = (float(end) for end in np.quantile(difference[1:], (tail, 1.0 - tail)))
    one = count < 2
    return Difference(
        value=float(difference[0]), low=None if one else low, high=None if one else high
    )
