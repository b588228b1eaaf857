"""Excursions of the residual of one joint beyond its threshold: begin, onset and end of a contact."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import ObserverSettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.kernels import Matrix, kernel
from pepper_driver.observer.constants import CORRECTION_TIME, FRICTION_RATIO
from pepper_driver.observer.interface import JointState

ONSET_LEVEL = 1.0 / 3.0
"""Fraction of the threshold below which the residual counts as free."""


@kernel
def _onset(
    residual: Matrix[FloatArray],
    time: FloatArray,
    count: int,
    window: int,
    joint: int,
    sign: int,
    threshold: float,
) -> float:
    """Find the onset in rings of samples, of which ``count`` were taken in; see ``ResidualHistory.onset``."""
    rows = len(time)
    filled = min(count, rows)
    oldest, start = count - filled, filled - 1
    for k in range(max(filled - window, 0), filled):
        if sign * residual[(oldest + k) % rows, joint] > threshold:
            start = k
            break
    # NaN, a blind sample, ends the search.
    level = ONSET_LEVEL * threshold
    while start > 0 and sign * residual[(oldest + start - 1) % rows, joint] >= level:
        start -= 1
    return float(time[(oldest + start) % rows])


class ResidualHistory:
    """Unfiltered residuals of the last ticks.

    The median detects a contact several ticks late; the samples in its window still show the onset.

    Args:
        window: Samples of the median filter.
        lookback: Samples before that window in which the onset may lie.
        width: Number of joints; the base is one column more.
    """

    def __init__(self, window: int, lookback: int, width: int) -> None:
        self._window = window
        self._residual = np.zeros((window + lookback, width + 1))
        self._time = np.zeros(window + lookback)
        self._count = 0
        self._onset = _onset.load_unchecked()

    def append(self, time: float, residual: FloatArray, base: float) -> None:
        """Take in one tick.

        Args:
            time: Clock [s].
            residual: (width,) unfiltered [rad], NaN where it is unknown.
            base: The same of the base.
        """
        row = self._count % len(self._time)
        self._time[row] = time
        self._residual[row, :-1] = residual
        self._residual[row, -1] = base
        self._count += 1

    def onset(self, joint: int, sign: int, threshold: float) -> float:
        """Return the time at which the residual began to leave its free-motion band [s].

        The search starts at the oldest sample of the median window that exceeds the threshold. It goes back as long as
        samples are at ONSET_LEVEL of the threshold or more on the same side. The onset of a contact that has grown for
        longer than the history is the beginning of the history.

        Args:
            joint: Index of the joint.
            sign: Side of the excursion: sign of the residual.
            threshold: Threshold that it has exceeded in this tick [rad].
        """
        return self._onset(
            self._residual, self._time, self._count, self._window, joint, sign, threshold
        )

    def reset(self) -> None:
        """Forget all samples."""
        self._count = 0


TIME_TOLERANCE = 1e-6
"""[s] Tolerance of times: sums of 12 ms steps are not exact in floating point."""

Onset = Callable[[int, int, float], float]
"""Clock [s] at which the residual of a joint began to leave its band, from joint index, sign and threshold."""


@dataclass(kw_only=True, slots=True)
class Excursion:
    """Excursion of the residual of a joint beyond its threshold, on one side.

    Attributes:
        joint: Index of the joint.
        sign: Sign of the residual.
        kind: ``contact`` or ``rebound``.
        onset_time: When the residual began to leave its free-motion band [s].
        peak: Largest size of the residual so far [rad].
        begin_time: When it exceeded the threshold [s].
        fall_time: When it fell below the threshold [s]; None while it exceeds it.
    """

    joint: int
    sign: int
    kind: Kind
    onset_time: float
    peak: float
    begin_time: float
    fall_time: float | None = None

    @property
    def over(self) -> bool:
        """True while the residual exceeds the threshold."""
        return self.fall_time is None


def _tolerance(residual: float, threshold: float) -> float:
    """Return by how much a constant residual varies [rad].

    After a strong touch a joint may rest far beyond its threshold, and an integral still moves it a little.
    """
    return (1.0 - FRICTION_RATIO) * max(threshold, abs(residual))


class JointMonitor:
    """State machine of one joint.

    - FREE: the residual is within the threshold.
    - CONTACT: it exceeds the threshold.
    - RELEASE: it fell below the threshold less than ``merge_gap`` ago. If it exceeds it again on the same side, the
      excursion continues; if not, the excursion ended when it fell.
    - REBOUND: it exceeded the threshold on the other side at most ``rebound_window`` after it fell: the joint swings
      back from a strong contact. The paper does not count these as false positives. One that lasts longer than
      ``rebound_window`` becomes a contact: a person holds the joint. In simulation four of five rebounds are shorter,
      and a missed touch is worse than a reported rebound.
    - BLIND: the residual is NaN. An excursion ends at once, and the next one is no rebound.
    An excursion also ends when the residual is constant within the friction band, below FRICTION_RATIO of its peak for
    ``settling_time``, or for CORRECTION_TIME, if the observer can reset its model to the measured position. Until it
    has done so, for ``settling_time`` at most, the same residual begins nothing. Beyond the friction band a constant
    residual is a hand. A rebound that is constant and below FRICTION_RATIO of its peak is no contact, however long.

    Args:
        joint: Index of the joint.
        settings: Merge gap and rebound window.
        onset: Function that gives the time when an excursion began.
        settling_time: In which a joint that was let go settles [s]; None if the observer cannot reset its model.

    Attributes:
        excursion: The present one, or None.
        settled: True if one has ended in this tick.
        fall_time: When the previous one ended [s].
    """

    def __init__(
        self,
        joint: int,
        settings: ObserverSettings,
        onset: Onset,
        *,
        settling_time: float | None = None,
    ) -> None:
        self._joint = joint
        self._settles = settling_time is not None
        self._settling_time = settling_time or 0.0
        self._constant_since: float | None = None
        self._lowest = self._highest = 0.0
        self._left_over = 0.0
        self._left_until = -math.inf
        self.settled = False
        self._merge_gap = settings.merge_gap + TIME_TOLERANCE
        self._rebound_window = settings.rebound_window + TIME_TOLERANCE
        self._onset = onset
        self._previous_sign = 0
        self.fall_time = 0.0
        self.excursion: Excursion | None = None

    def step(self, time: float, residual: float, threshold: float, band: float = 0.0) -> JointState:
        """Take in one tick.

        Args:
            time: Clock of the robot [s], not decreasing.
            residual: Filtered r [rad]; NaN for a blind joint.
            threshold: [rad], positive.
            band: Largest residual at which friction can hold the joint [rad].
        """
        self.settled = False
        if residual != residual:  # NaN
            self.reset()
            return JointState.BLIND
        current = self.excursion
        if (
            self._settles
            and current is not None
            and self._stuck(current, time, residual, threshold, band)
        ):
            # The hand left when the residual became constant.
            self._end(current, time - self._settling_time)
            self._left_over = abs(residual) + _tolerance(residual, threshold)
            self._left_until = time + self._settling_time
            return JointState.RELEASE
        if (
            current is not None
            and current.fall_time is not None
            and time - current.fall_time > self._merge_gap
        ):
            self._end(current, current.fall_time)
            current = None
        size = abs(residual)
        if size > threshold:
            sign = 1 if residual > 0 else -1
            # Until the encoder rests, and the model is reset, the joint still shows what it was left with.
            if (
                current is None
                and time <= self._left_until
                and sign == self._previous_sign
                and size <= self._left_over
            ):
                return JointState.RELEASE
            if current is None or current.sign != sign:
                if current is not None:
                    self._end(current, time if current.fall_time is None else current.fall_time)
                current = self._begin(time, sign, threshold)
            current.fall_time = None
            current.peak = max(current.peak, size)
            outlasts = time - current.begin_time > self._rebound_window
            if current.kind == "rebound" and outlasts:
                # One that fell and is constant will end as stuck: it is no hand.
                settles = self._constant_since is not None and self._fallen(current, residual)
                current.kind = "rebound" if settles else "contact"
            return JointState.REBOUND if current.kind == "rebound" else JointState.CONTACT
        if current is None:
            return JointState.FREE
        if current.fall_time is None:
            current.fall_time = time
        return JointState.RELEASE

    @property
    def idle(self) -> bool:
        """True if a residual within its threshold would change nothing."""
        return self.excursion is None

    def _begin(self, time: float, sign: int, threshold: float) -> Excursion:
        swings_back = self._previous_sign == -sign and time - self.fall_time <= self._rebound_window
        self.excursion = Excursion(
            joint=self._joint,
            sign=sign,
            kind="rebound" if swings_back else "contact",
            onset_time=min(self._onset(self._joint, sign, threshold), time),
            peak=0.0,
            begin_time=time,
        )
        return self.excursion

    def _end(self, excursion: Excursion, fall_time: float) -> None:
        self._previous_sign, self.fall_time = excursion.sign, fall_time
        self.excursion = None
        self._constant_since = None
        self.settled = True

    def _stuck(
        self, current: Excursion, time: float, residual: float, threshold: float, band: float
    ) -> bool:
        """Return True if friction alone holds the joint away from its target."""
        # Friction alone cannot hold a larger residual: a hand does.
        if current.fall_time is not None or abs(residual) > band:
            self._constant_since = None
            return False
        if self._constant_since is None:
            self._constant_since = time
            self._lowest = self._highest = residual
        self._lowest, self._highest = min(self._lowest, residual), max(self._highest, residual)
        varies = max(self._highest - residual, residual - self._lowest)
        if varies > _tolerance(residual, threshold):
            self._constant_since = None
            return False
        constant_time = time - self._constant_since + TIME_TOLERANCE
        fallen = self._fallen(current, residual)
        return constant_time >= (self._settling_time if fallen else CORRECTION_TIME)

    @staticmethod
    def _fallen(current: Excursion, residual: float) -> bool:
        return abs(residual) < FRICTION_RATIO * current.peak

    def reset(self) -> None:
        """Forget everything."""
        self.excursion = None
        self._previous_sign = 0
        self._left_until = -math.inf
        self._constant_since = None
