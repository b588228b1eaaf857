"""Excursions of one joint's residual beyond its threshold, and when they began."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import ObserverSettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.observer.interface import JointState

ONSET_LEVEL = 1.0 / 3.0
"""Share of the threshold below which the residual counts as not yet touched."""


class ResidualHistory:
    """Unfiltered residuals of the last ticks.

    The median raises the alarm several ticks late; the samples it was taken from still show the beginning.

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

    def append(self, time: float, residual: FloatArray, base: float) -> None:
        """Take in one tick.

        Args:
            time: Clock [s].
            residual: (width,) unfiltered [rad], NaN where there is none.
            base: That of the base, likewise.
        """
        row = self._count % len(self._time)
        self._time[row] = time
        self._residual[row, :-1] = residual
        self._residual[row, -1] = base
        self._count += 1

    def onset(self, joint: int, sign: int, threshold: float) -> float:
        """Clock at which the residual began to leave its free-motion band [s].

        From the oldest sample of the median window that is over the threshold, back to the first of the unbroken run
        of samples that lie at ONSET_LEVEL of the threshold or more on the same side. A contact that has grown for
        longer than the history is put at the history's beginning.

        Args:
            joint: Index of the joint.
            sign: Side of the excursion: sign of the residual.
            threshold: That it has crossed in this tick [rad].
        """
        filled = min(self._count, len(self._time))
        rows = np.arange(self._count - filled, self._count) % len(self._time)
        rising = sign * self._residual[rows, joint]
        newest = max(filled - self._window, 0)
        over = np.flatnonzero(rising[newest:] > threshold)
        start = newest + int(over[0]) if len(over) else filled - 1
        # Written so that NaN ends the run.
        outside = np.flatnonzero(~(rising[:start] >= ONSET_LEVEL * threshold))
        first = int(outside[-1]) + 1 if len(outside) else 0
        return float(self._time[rows[first]])

    def reset(self) -> None:
        """Forget all samples."""
        self._count = 0


TIME_TOLERANCE = 1e-6
"""[s] Clocks count in 12 ms steps that are no exact floats; spans are compared with this much grace."""

STUCK_RATIO = 0.85
"""Of its peak: a residual that has fallen below it, then stands still, and is no larger than friction can hold, is no
hand, but friction that holds the joint off its place after the hand has gone."""

STUCK_TIME = 0.25
"""[s] For which it stands still then."""

MAX_STUCK_TIME = 1.0
"""[s] After which one that stands still without having fallen counts as well: a hand no stronger than friction may
have gone without the joint's moving."""

STUCK_SPREAD = 0.25
"""Of the threshold: by how much a residual that stands still may vary."""

SETTLING_TIME = 0.3
"""[s] After a contact, for which the threshold is SETTLING_FACTOR times as high: the joint has just been let go."""

SETTLING_FACTOR = 1.5

Onset = Callable[[int, int, float], float]
"""Clock [s] at which the residual of a joint began to leave its band, from joint index, sign and threshold."""


@dataclass(kw_only=True, slots=True)
class Excursion:
    """A joint's residual beyond its threshold, on one side.

    Attributes:
        joint: Index of the joint.
        sign: Sign of the residual.
        kind: ``contact`` or ``rebound``.
        onset_time: When the residual began to leave its free-motion band [s].
        peak: Largest size of the residual so far [rad].
        begin_time: When it crossed the threshold [s].
        fall_time: When it fell under the threshold [s]; None while it is over it.
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
        """True while the residual is over the threshold."""
        return self.fall_time is None


class JointMonitor:
    """State machine of one joint.

    - FREE: the residual is within the threshold.
    - CONTACT: it is over it.
    - RELEASE: it fell under it less than ``merge_gap`` ago. If it returns on the same side, the excursion goes on; if
      not, the excursion has ended when it fell.
    - REBOUND: it crossed the threshold on the other side at most ``rebound_window`` after it fell: the joint swings
      back from a strong contact. The paper leaves these out of its false positives. One that stays over the
      threshold for longer than ``rebound_window`` is a contact after all: somebody holds the joint. (In simulation four
      of five rebounds are shorter; and a touch that is not told is worse than a rebound that is.)
    - BLIND: the residual is NaN. Everything is forgotten: an excursion ends at once, and what follows is no rebound.
    - SETTLING, if the observer can start again from where the joint rests: a contact has ended. It also ends when the
      residual stands still, no larger than friction can hold, having fallen below STUCK_RATIO of its peak.

    Args:
        joint: Index of the joint.
        settings: Merge gap and rebound window.
        onset: Tells when an excursion began.
        settles: Whether there is a state SETTLING.

    Attributes:
        excursion: The one that goes on.
        settled: Whether one has ended in this tick.
    """

    def __init__(
        self, joint: int, settings: ObserverSettings, onset: Onset, *, settles: bool = False
    ) -> None:
        self._joint = joint
        self._settles = settles
        self._recent: deque[tuple[float, float]] = deque()
        self._settling_until = -1.0
        self.settled = False
        self._merge_gap = settings.merge_gap + TIME_TOLERANCE
        self._rebound_window = settings.rebound_window + TIME_TOLERANCE
        self._onset = onset
        self._previous_sign = 0
        self._previous_fall = 0.0
        self.excursion: Excursion | None = None

    def step(self, time: float, residual: float, threshold: float, band: float = 0.0) -> JointState:
        """Take in one tick.

        Args:
            time: Clock of the robot [s], never running back.
            residual: Filtered r [rad]; NaN for a blind joint.
            threshold: [rad], positive.
            band: By how much friction can hold the joint off its place [rad].
        """
        self.settled = False
        if residual != residual:  # NaN
            self.reset()
            return JointState.BLIND
        current = self.excursion
        if self._settles:
            if time <= self._settling_until:
                threshold *= SETTLING_FACTOR
            elif current is not None and self._stuck(current, time, residual, threshold, band):
                self._end(current, time - STUCK_TIME, time)
                return JointState.SETTLING
        if (
            current is not None
            and current.fall_time is not None
            and time - current.fall_time > self._merge_gap
        ):
            self._end(current, current.fall_time, time)
            current = None
        size = abs(residual)
        if size > threshold:
            sign = 1 if residual > 0 else -1
            if current is None or current.sign != sign:
                if current is not None:
                    self._end(
                        current, time if current.fall_time is None else current.fall_time, time
                    )
                current = self._begin(time, sign, threshold)
            current.fall_time = None
            current.peak = max(current.peak, size)
            if current.kind == "rebound" and time - current.begin_time > self._rebound_window:
                current.kind = "contact"
            return JointState.REBOUND if current.kind == "rebound" else JointState.CONTACT
        if current is None:
            return JointState.SETTLING if time <= self._settling_until else JointState.FREE
        if current.fall_time is None:
            current.fall_time = time
        return JointState.RELEASE

    def idle(self, time: float) -> bool:
        """Return true if a residual within its threshold would change nothing."""
        return self.excursion is None and time > self._settling_until

    def _begin(self, time: float, sign: int, threshold: float) -> Excursion:
        swings_back = (
            self._previous_sign == -sign and time - self._previous_fall <= self._rebound_window
        )
        self.excursion = Excursion(
            joint=self._joint,
            sign=sign,
            kind="rebound" if swings_back else "contact",
            onset_time=min(self._onset(self._joint, sign, threshold), time),
            peak=0.0,
            begin_time=time,
        )
        return self.excursion

    def _end(self, excursion: Excursion, fall_time: float, time: float) -> None:
        self._previous_sign = excursion.sign
        self._previous_fall = fall_time
        self.excursion = None
        self._recent.clear()
        self.settled = True
        if self._settles:
            self._settling_until = time + SETTLING_TIME

    def _stuck(
        self, current: Excursion, time: float, residual: float, threshold: float, band: float
    ) -> bool:
        """Return true if friction alone holds the joint away from its target."""
        recent, spread = self._recent, STUCK_SPREAD * threshold
        if current.fall_time is not None or abs(residual) > band:
            recent.clear()
            return False
        recent.append((time, residual))
        for _, value in recent:
            if abs(value - residual) > spread:
                recent.clear()
                return False
        still = time - recent[0][0] + TIME_TOLERANCE
        fallen = abs(residual) < STUCK_RATIO * current.peak
        return still >= (STUCK_TIME if fallen else MAX_STUCK_TIME)

    def reset(self) -> None:
        """Forget everything."""
        self.excursion = None
        self._previous_sign = 0
        self._recent.clear()
        self._settling_until = -1.0
