"""Thresholds of residuals: a multiple of the spread that each joint shows without touch, by phase of its motion.

The spread of a residual in free motion differs between joints by a factor of ten, between days by less than two. It
starts as identified, and follows the robot of today slowly. How large a multiple is needed depends on the number of
false contacts that are allowed: the tail of the spread is exponential. It is long at rest and while a joint breaks
away, and short in motion that lasts. A joint that is commanded to move and does not slide yet breaks away sooner or
later than its model: its threshold is HELD_FACTOR times as high, until its model has followed it at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    EXCURSIONS,
    HELD_FACTOR,
    MAX_CHANGE,
    MIN_SPREAD,
    MIN_TORQUE,
    PUSH_TICKS,
    REST_SPEED,
    RISE,
    SETTLING_TICKS,
    SLIDING_TAIL,
    TAIL,
    UNSURE_FACTOR,
)
from pepper_driver.observer.running_filters import RunningMaximum

SPREAD_QUANTILE = 0.99
"""The spread is this quantile of the size of a residual in free motion."""

MIN_SAMPLES = 500
"""Six seconds in a phase of the motion, from which a spread is found; with fewer it is that of another phase."""

REST, BREAKAWAY, SLIDING = range(3)
"""Phases of the motion of a joint without touch: at rest; just after it broke away; sliding for SETTLING_TICKS."""


def threshold_factor(false_contacts: float, tail: float) -> float:
    """Return the threshold in spreads at which so many contacts an hour are false."""
    return 1.0 + tail * max(math.log(EXCURSIONS / false_contacts), 0.0)


def phase_factors(false_contacts: float) -> FloatArray:
    """Return (3,) thresholds in spreads by phase."""
    return np.array([threshold_factor(false_contacts, t) for t in (TAIL, TAIL, SLIDING_TAIL)])


def spread_thresholds(
    spread: Sequence[float], load_gain: float, false_contacts: float
) -> FloatArray:
    """Return (3,) thresholds of a joint with these spreads, by phase [rad].

    Args:
        spread: By phase [rad].
        load_gain: g = 1 / K [rad/(N m)].
        false_contacts: That are allowed in an hour.
    """
    factors = phase_factors(false_contacts)
    thresholds: FloatArray = np.maximum(
        factors * np.maximum(spread, MIN_SPREAD), MIN_TORQUE * load_gain
    )
    return thresholds


class SpreadState:
    """Spread of one signal in one phase.

    Attributes:
        identified: As identified.
        today: At present.
        ticks: For which the signal has been beyond it, on one side.
        side: Sign of the signal when it was beyond it last.
    """

    identified: float
    today: float
    ticks: int
    side: float


@kernel
def learn_spread(
    spreads: Out[Records[SpreadState]], j: int, residual: float, smallest: float
) -> None:
    """Take in a residual without touch; ``smallest`` is the smallest spread that it may have."""
    spread = spreads[j]
    if abs(residual) > spread.today:
        # Friction pulls to the other side when a joint turns; a hand that nothing reports does not.
        side = math.copysign(1.0, residual)
        spread.ticks = spread.ticks + 1 if side == spread.side else 1
        spread.side = side
        if spread.ticks <= PUSH_TICKS:
            spread.today *= 1.0 + RISE
    else:
        spread.ticks = 0
        spread.today *= 1.0 - RISE * (1.0 - SPREAD_QUANTILE)
    lowest = max(spread.identified / MAX_CHANGE, min(smallest, spread.identified))
    spread.today = min(max(spread.today, lowest), spread.identified * MAX_CHANGE)


@kernel
def _threshold(
    spreads: Out[Records[SpreadState]],
    factors: FloatArray,
    lowest: FloatArray,
    fastest: FloatArray,
    speed: FloatArray,
    desired: FloatArray,
    limited: BoolArray,
    touched: BoolArray,
    rest_ticks: int,
    sliding_ticks: Out[IntArray],
    still_ticks: Out[IntArray],
    moving: Out[BoolArray],
    phase: Out[IntArray],
    held: Out[FloatArray],
    threshold: Out[FloatArray],
) -> None:
    n = len(threshold)
    for j in range(n):
        moving[j] = fastest[j] > REST_SPEED
        sliding_ticks[j] = sliding_ticks[j] + 1 if abs(speed[j]) > REST_SPEED else 0
        if not moving[j]:
            phase[j] = REST
        elif sliding_ticks[j] <= SETTLING_TICKS:
            phase[j] = BREAKAWAY
        else:
            phase[j] = SLIDING
        spread, factor = spreads[phase[j] * n + j], factors[phase[j]]
        still_ticks[j] = still_ticks[j] + 1 if abs(desired[j]) <= REST_SPEED else 0
        if phase[j] != SLIDING and still_ticks[j] <= rest_ticks:
            factor *= HELD_FACTOR
        threshold[j] = np.maximum(spread.today * factor, lowest[j])
        if touched[j]:
            # A hand holds on while a joint turns or stops: its touch is over when it is.
            threshold[j] = min(threshold[j], held[j])
        held[j] = threshold[j]
        if limited[j]:
            threshold[j] *= UNSURE_FACTOR


@kernel
def _learn(
    spreads: Out[Records[SpreadState]], phase: IntArray, residual: FloatArray, seen: BoolArray
) -> None:
    n = len(seen)
    for j in range(n):
        if seen[j]:
            learn_spread(spreads, phase[j] * n + j, residual[j], MIN_SPREAD)


class SpreadThreshold:
    """Thresholds of joints.

    Args:
        spread: (n, 3) as identified, by phase [rad]; NaN for joints without a model.
        load_gain: (n,) g = 1 / K [rad/(N m)].
        cycle: Period of the ticks [s].
        false_contacts: That are allowed in an hour.
        adapt: False to keep the spreads as identified.

    Attributes:
        factors: (3,) of a threshold over the spread, by phase.
        moving: (n,) joints that slide without touch, or did just before.
        phase: (n,) phase of their motion.
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
        self.factors, self._lowest = phase_factors(false_contacts), MIN_TORQUE * load_gain
        self._rest_ticks = round(CORRECTION_TIME / cycle)
        self._step, self._learn = _threshold.load(), _learn.load()
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        n, by_phase = len(self._identified), self._identified.T.ravel()
        self._spreads = make_records(
            SpreadState, len(by_phase), identified=by_phase, today=by_phase
        )
        self._speeds = RunningMaximum(PUSH_TICKS * self._cycle, self._cycle, n)
        self._sliding_ticks = np.zeros(n, dtype=np.int64)
        self._still_ticks = np.full(n, self._rest_ticks)
        self._touched, self._held = np.zeros(n, dtype=np.bool_), np.full(n, np.inf)
        self.moving, self.phase = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.int64)

    @property
    def bounds(self) -> FloatArray:
        """(n,) largest threshold of each joint, as identified [rad]."""
        largest = (self.factors * self._identified).max(axis=1)
        bounds: FloatArray = np.maximum(largest, self._lowest)
        return bounds

    @property
    def change(self) -> FloatArray:
        """(n,) spread while sliding over that identified."""
        n = len(self._identified)
        change: FloatArray = (self._spreads["today"] / self._spreads["identified"])[SLIDING * n :]
        return change

    def step(self, speed: FloatArray, desired: FloatArray, limited: BoolArray) -> FloatArray:
        """Take in one tick; return (n,) thresholds [rad].

        Args:
            speed: (n,) without touch [rad/s]: of the stick-slip models, which friction holds as it does the joints.
            desired: (n,) velocity that is commanded [rad/s].
            limited: (n,) where the safety gate altered the command.
        """
        threshold = np.empty(len(speed))
        self._step(
            self._spreads,
            self.factors,
            self._lowest,
            self._speeds.push(speed),
            speed,
            desired,
            limited,
            self._touched,
            self._rest_ticks,
            self._sliding_ticks,
            self._still_ticks,
            self.moving,
            self.phase,
            self._held,
            threshold,
        )
        return threshold

    def hold(self, touched: BoolArray) -> None:
        """Keep thresholds of joints (n,) from rising with the phase of the motion until they are touched no more."""
        self._touched = touched

    def learn(self, residual: FloatArray, seen: BoolArray) -> None:
        """Take in residuals (n,) [rad] of joints without touch that can be judged (n,)."""
        if self._adapt:
            self._learn(self._spreads, self.phase, residual, seen)
