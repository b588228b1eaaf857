"""Thresholds of residuals: a multiple of the spread that each joint shows without touch, at rest and in motion apart.

The spread of a residual in free motion differs between joints by a factor of ten, between days by less than two. It
starts as identified, and follows the robot of today slowly. How large a multiple is needed depends on the number of
false contacts that are allowed: the tail of the spread is exponential.
"""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.observer.constants import (
    EXCURSIONS,
    MAX_CHANGE,
    MIN_SPREAD,
    MIN_TORQUE,
    PUSH_TICKS,
    REST_SPEED,
    RISE,
    TAIL,
    UNSURE_FACTOR,
)
from pepper_driver.observer.running_filters import RunningMaximum

SPREAD_QUANTILE = 0.99
"""The spread is this quantile of the size of a residual in free motion."""

MIN_SAMPLES = 500
"""Six seconds in a phase of the motion, from which a spread is found; with fewer it is that of another phase."""


def threshold_factor(false_contacts: float) -> float:
    """Return the threshold in spreads at which so many contacts an hour are false."""
    return 1.0 + TAIL * max(math.log(EXCURSIONS / false_contacts), 0.0)


def spread_threshold(spread: float, load_gain: float, false_contacts: float) -> float:
    """Return the threshold of a joint with this spread [rad]; ``load_gain`` is g = 1 / K [rad/(N m)]."""
    factor = threshold_factor(false_contacts)
    return float(max(factor * max(spread, MIN_SPREAD), MIN_TORQUE * load_gain))


class SpreadState:
    """Spread of one signal in one phase.

    Attributes:
        identified: As identified.
        today: At present.
        ticks: For which the signal has been beyond it.
    """

    identified: float
    today: float
    ticks: int


@kernel
def learn_spread(spreads: Out[Records[SpreadState]], j: int, size: float, smallest: float) -> None:
    """Take in the size of a residual without touch; ``smallest`` is the smallest spread that it may have."""
    spread = spreads[j]
    if size > spread.today:
        spread.ticks += 1
        if spread.ticks <= PUSH_TICKS:
            spread.today *= 1.0 + RISE
    else:
        spread.ticks = 0
        spread.today *= 1.0 - RISE * (1.0 - SPREAD_QUANTILE)
    lowest = max(spread.identified / MAX_CHANGE, min(smallest, spread.identified))
    spread.today = min(max(spread.today, lowest), spread.identified * MAX_CHANGE)


@kernel
def _threshold(
    at_rest: Records[SpreadState],
    in_motion: Records[SpreadState],
    factor: float,
    lowest: FloatArray,
    moving: BoolArray,
    limited: BoolArray,
    threshold: Out[FloatArray],
) -> None:
    for j in range(len(threshold)):
        spread = in_motion[j].today if moving[j] else at_rest[j].today
        threshold[j] = np.maximum(spread * factor, lowest[j])
        if limited[j]:
            threshold[j] *= UNSURE_FACTOR


@kernel
def _learn(
    at_rest: Out[Records[SpreadState]],
    in_motion: Out[Records[SpreadState]],
    moving: BoolArray,
    residual: FloatArray,
    seen: BoolArray,
) -> None:
    for j in range(len(seen)):
        if seen[j]:
            learn_spread(in_motion if moving[j] else at_rest, j, abs(residual[j]), MIN_SPREAD)


class SpreadThreshold:
    """Thresholds of joints.

    Args:
        spread: (n, 2) as identified, at rest and in motion [rad]; NaN for joints without a model.
        load_gain: (n,) g = 1 / K [rad/(N m)].
        cycle: Period of the ticks [s].
        false_contacts: That are allowed in an hour.
        adapt: False to keep the spreads as identified.

    Attributes:
        factor: Of a threshold over the spread.
        moving: (n,) joints that slide without touch, or did just before.
    """

    def __init__(
        self,
        spread: FloatArray,
        load_gain: FloatArray,
        cycle: float,
        *,
        false_contacts: float,
        adapt: bool,
    ) -> None:
        self._identified, self._cycle, self._adapt = np.fmax(spread, MIN_SPREAD), cycle, adapt
        self._identified[np.isnan(spread)] = np.nan
        self.factor, self._lowest = threshold_factor(false_contacts), MIN_TORQUE * load_gain
        self._step, self._learn = _threshold.load(), _learn.load()
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        n = len(self._identified)
        self._at_rest, self._in_motion = (
            make_records(SpreadState, n, identified=values, today=values)
            for values in self._identified.T
        )
        self._speeds = RunningMaximum(PUSH_TICKS * self._cycle, self._cycle, n)
        self.moving = np.zeros(n, dtype=np.bool_)

    @property
    def bounds(self) -> FloatArray:
        """(n,) larger threshold of each joint, as identified [rad]."""
        bounds: FloatArray = np.maximum(self.factor * self._identified.max(axis=1), self._lowest)
        return bounds

    @property
    def change(self) -> FloatArray:
        """(n,) spread in motion over that identified."""
        change: FloatArray = self._in_motion["today"] / self._in_motion["identified"]
        return change

    def step(self, speed: FloatArray, limited: BoolArray) -> FloatArray:
        """Take in one tick; return (n,) thresholds [rad].

        Args:
            speed: (n,) without touch [rad/s]: of the stick-slip models, which friction holds as it does the joints.
            limited: (n,) where the safety gate altered the command.
        """
        threshold = np.empty(len(speed))
        self.moving = self._speeds.push(np.abs(speed)) > REST_SPEED
        self._step(
            self._at_rest,
            self._in_motion,
            self.factor,
            self._lowest,
            self.moving,
            limited,
            threshold,
        )
        return threshold

    def learn(self, residual: FloatArray, seen: BoolArray) -> None:
        """Take in residuals (n,) [rad] of joints without touch that can be judged (n,)."""
        if self._adapt:
            self._learn(self._at_rest, self._in_motion, self.moving, residual, seen)
