"""Adaptive threshold, and the envelope of the residual without touch that it follows."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.tree import FEATURES, BatchedTrees
from pepper_driver.observer.running_filters import RunningMaximum

BLOCK_TICKS = 42
"""Samples in motion, half a second, of which the largest residual is kept."""

MAX_BLOCKS = 60
"""That are remembered: half a minute of a joint's own motion."""

RANK = 3
"""The largest, second largest... of the blocks that counts: two touches that were not felt leave no trace."""

FIRST_BLOCKS = 15
"""Of so many the largest counts, of twice as many the second largest."""

FEW_BLOCKS_FACTOR = 4.0
"""Over the median of fewer blocks, and no more: the largest of them may be a touch, or how a joint set off."""

ENVELOPE_FACTOR = 3.0
"""Over it: how much larger the residual may still get."""

MEDIAN_FACTOR = 16.0
"""Over the median of the blocks, and no more: where every fourth one holds a touch, the largest are all touches."""

START_FACTOR = 2.0
"""Factor on identified thresholds when nothing is known of how the robot is today."""

FIRST_MOTION = FIRST_BLOCKS * BLOCK_TICKS
"""Samples in motion until something is known of how the robot is today. Touches do not make it longer."""

MAX_FACTOR = 10.0
"""Factor that no stray raises a threshold beyond: a push that grows slowly enough looks like one."""

TOUCH_RATIO = 0.6
"""Of the threshold of today: among touches, a block with more may well be one that was too light to be felt."""

SUSPECT_TICKS = 5000
"""Ticks, a minute, for which that is suspected after a touch."""

POST_CONTACT_TICKS = 170
"""Ticks after a touch, two seconds, in which friction may still hold a joint where the touch has left it."""


class ResidualEnvelope:
    """ENVELOPE_FACTOR times the RANK-th largest residual of a joint's last MAX_BLOCKS, within MEDIAN_FACTOR medians.

    The residual of a worn or loaded robot differs from joint to joint and from day to day; that it will be as large
    in the next minute as in the last is a better guess than any made at its identification. It learns most in the
    first half minute of a session, when nobody should touch the robot.

    Args:
        identified: (n,) thresholds [rad].
        start: (n,) factor on them at the start, 1 or more.

    Attributes:
        bound: (n,) [rad].
        known: (n,) 0..1, how much of the first motion has been seen.
        factor: (n,) 1 or more, on the identified thresholds as things stand.
    """

    def __init__(self, identified: FloatArray, start: FloatArray) -> None:
        self._identified, self._start = identified, start
        self._largest = np.zeros((len(identified), MAX_BLOCKS))
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        width = len(self._identified)
        self._largest[:] = 0.0
        self._blocks = np.zeros(width, dtype=np.int64)
        self._motion = np.zeros(width, dtype=np.int64)
        self.bound, self.known = np.zeros(width), np.zeros(width)
        self._usual = np.zeros(width)
        self.factor = self._start
        self._pause, self._untouched = 0, SUSPECT_TICKS
        self._drop()

    def _drop(self) -> None:
        """Forget the blocks that may hold the beginning of a touch."""
        width = len(self._largest)
        self._now, self._before = np.zeros(width), np.full(width, np.nan)
        self._samples = np.zeros(width, dtype=np.int64)

    def touched(self) -> None:
        """Take in one tick in which something touches the robot: what was seen just before may be its beginning."""
        self._untouched = 0
        if self._pause < POST_CONTACT_TICKS:
            self._pause = POST_CONTACT_TICKS
            self._drop()

    def learn(self, residual: FloatArray, seen: BoolArray, moving: BoolArray) -> None:
        """Take in one tick without touch.

        A block takes in all samples, and is full when enough of them were in motion: rest alone proves nothing.

        Args:
            residual: (n,) [rad].
            seen: (n,) joints that can be judged.
            moving: (n,) joints that are to move.
        """
        self._untouched += 1
        counts = seen & moving
        if np.count_nonzero(counts & (self.known < 1.0)):
            self._motion += counts
            self.known = np.minimum(self._motion / FIRST_MOTION, 1.0)
            self._widen()
        if self._pause:
            self._pause -= 1
            return
        self._now = np.maximum(self._now, np.where(seen, np.abs(residual), 0.0))
        self._samples += counts
        over = self._samples >= BLOCK_TICKS
        if not np.count_nonzero(over):
            return
        keep = over & ~np.isnan(self._before)
        if self._untouched < SUSPECT_TICKS:
            suspect = self._before > TOUCH_RATIO * self.factor * self._identified
            keep &= ~(suspect & (self.known == 1.0))
        for joint in np.flatnonzero(keep).tolist():
            self._keep(joint)
        self._before[over], self._now[over], self._samples[over] = self._now[over], 0.0, 0
        self._widen()

    def _widen(self) -> None:
        """Bring the factor up to date."""
        few = np.maximum(self._start, FEW_BLOCKS_FACTOR * self._usual / self._identified)
        most = np.where(self._blocks < FIRST_BLOCKS, np.minimum(few, MAX_FACTOR), MAX_FACTOR)
        today = np.maximum(self._start * (1.0 - self.known), self.bound / self._identified)
        self.factor = np.minimum(np.maximum(today, 1.0), most)

    def _keep(self, joint: int) -> None:
        """Remember the block before this one: no touch has followed it."""
        self._largest[joint, self._blocks[joint] % MAX_BLOCKS] = self._before[joint]
        self._blocks[joint] += 1
        blocks = min(int(self._blocks[joint]), MAX_BLOCKS)
        seen = np.sort(self._largest[joint, :blocks])
        rank = min(RANK, max(blocks // FIRST_BLOCKS, 1))
        self._usual[joint] = seen[blocks // 2]
        self.bound[joint] = min(ENVELOPE_FACTOR * seen[-rank], MEDIAN_FACTOR * self._usual[joint])


REST_SPEED = 0.05
"""[rad/s] Desired; a joint that shall move no faster can be held by its friction."""

SPEED_MEMORY = 0.5
"""[s] For which the largest desired speed is kept."""

THRESHOLD_MEMORY = 0.25
"""[s] For which a raised threshold stays."""

CHANGED_FACTOR = 2.0
"""While the safety gate alters a command: the load torque belongs to the command that was wanted."""

UNSETTLED_RATIO = 0.5
"""By this share a threshold is higher just after a touch where a board sums errors up: it lets go of them later."""

UNCERTAINTY_FACTOR = 2.0
"""Standard deviations, of not knowing the constants better, that a threshold rises by."""

MIN_START_THRESHOLD = np.radians(1.8)
"""[rad] Thresholds begin here at least: a worn joint strays so far, however quiet it was when it was identified."""

QUIET_RATIO = 0.5
"""Share of a threshold below which a residual may teach something."""


class FusionThreshold:
    """Bounds of the models, times what the session so far says, plus the uncertainty of the constants.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        adapt: Whether anything but the bounds of the models counts.

    Attributes:
        bounds: (n,) largest bound of each model [rad].
        speed: (n,) desired, of the last tick [rad/s].
        quiet_bound: (n,) size of a residual that may teach how a joint is today [rad].
        learning_bound: (n,) size of one that may teach what the hands hold: as large as joints stray today [rad].
    """

    def __init__(self, models: list[FusionModel | None], cycle: float, *, adapt: bool) -> None:
        self._cycle, self._adapt = cycle, adapt
        self._bounds = BatchedTrees([None if m is None else m.bound for m in models])
        self._phase = np.zeros((FEATURES, len(models)))
        self.bounds = np.array([np.nan if m is None else m.largest_bound for m in models])
        start = np.fmax(START_FACTOR, MIN_START_THRESHOLD / self.bounds)
        self._strays = ResidualEnvelope(self.bounds, start)
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        n = len(self.bounds)
        self._strays.reset()
        self._speeds = RunningMaximum(SPEED_MEMORY, self._cycle, n)
        self._recent = RunningMaximum(THRESHOLD_MEMORY, self._cycle, n)
        self.speed, self.quiet_bound, self.learning_bound = np.zeros(n), np.zeros(n), np.zeros(n)

    def step(
        self,
        velocity: FloatArray,
        acceleration: FloatArray,
        limited: BoolArray,
        uncertainty: FloatArray,
        unsettled: FloatArray | None = None,
    ) -> FloatArray:
        """Take in one tick; returns (n,) thresholds [rad].

        Args:
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
            limited: (n,) where the safety gate altered the command.
            uncertainty: (n,) standard deviation of the expected error [rad].
            unsettled: (n,) 0..1, how lately the robot was let go; None for nowhere.
        """
        speed, size, largest = self._phase
        np.abs(velocity, out=speed)
        np.abs(acceleration, out=size)
        largest[:] = self._speeds.push(speed)
        self.speed = speed
        bound = self._bounds.predict(self._phase)
        self.quiet_bound = QUIET_RATIO * bound
        if self._adapt:
            doubt = UNCERTAINTY_FACTOR * uncertainty
            self.quiet_bound = QUIET_RATIO * (bound + doubt)
            bound = bound * self._strays.factor + doubt
        self.learning_bound = QUIET_RATIO * bound
        if np.count_nonzero(limited):
            bound = np.where(limited, CHANGED_FACTOR * bound, bound)
        if unsettled is not None:
            bound = bound * (1.0 + UNSETTLED_RATIO * unsettled)
        return self._recent.push(bound)

    def learn(self, residual: FloatArray, seen: BoolArray | None) -> None:
        """Take in the residual (n,) [rad] of joints that can be judged (n,); None while something touches the robot."""
        if not self._adapt:
            return
        if seen is None:
            self._strays.touched()
        else:
            self._strays.learn(residual, seen, self.speed > REST_SPEED)
