"""Adaptive threshold, and the envelope of the residual without touch that widens it."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.tree import FEATURES, BatchedTrees
from pepper_driver.observer.running_filters import RunningMaximum

BLOCK_TICKS = 42
"""Samples in motion, half a second, of which the largest residual is stored."""

MAX_BLOCKS = 60
"""Stored blocks: half a minute of a joint's own motion."""

ENVELOPE_RANK = 3
"""Rank of the block that counts, from the largest: two touches that were not detected have no effect."""

BLOCKS_PER_RANK = 15
"""With this many blocks the largest counts, with twice as many the second largest."""

FEW_BLOCKS_FACTOR = 4.0
"""Upper limit over the median of fewer blocks: the largest of them may be a touch, or the start of a motion."""

ENVELOPE_FACTOR = 3.0
"""Factor over the block that counts: the residual may still become larger."""

MEDIAN_FACTOR = 16.0
"""Upper limit over the median of the blocks: if every fourth block has a touch, the largest ones are all touches."""

START_FACTOR = 2.0
"""Factor on the identified thresholds at the start, when the state of the robot is unknown."""

FIRST_MOTION_TICKS = BLOCKS_PER_RANK * BLOCK_TICKS
"""Samples in motion until the state of the robot is known. Touches do not extend it."""

MAX_ENVELOPE_FACTOR = 10.0
"""Largest factor by which the envelope raises a threshold: a push that grows slowly looks like residual drift."""

SUSPECT_RATIO = 0.6
"""Fraction of the present threshold: shortly after touches, a larger block may be a touch too light to be detected."""

SUSPECT_TICKS = 5000
"""Ticks after a touch in which such blocks are ignored: one minute."""

POST_CONTACT_TICKS = 170
"""Ticks after a touch, two seconds, in which friction may still hold a joint away from its target."""


class ResidualEnvelope:
    """Residual envelope: ENVELOPE_FACTOR times the ENVELOPE_RANK-th largest residual of the last MAX_BLOCKS blocks.

    MEDIAN_FACTOR times their median is its upper limit. The residual of a worn or loaded robot differs between joints
    and between days. Its size in the last minute predicts the next minute better than any identification. The envelope
    learns most in the first half-minute of a session, in which the robot should not be touched.

    Args:
        identified: (n,) thresholds [rad].
        start: (n,) factor on them at the start, 1 or more.

    Attributes:
        bound: (n,) [rad].
        known: (n,) 0..1, completed fraction of the first motion.
        factor: (n,) 1 or more, present factor on the identified thresholds.
    """

    def __init__(self, identified: FloatArray, start: FloatArray) -> None:
        self._identified, self._start = identified, start
        self._largest = np.zeros((len(identified), MAX_BLOCKS))
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        width = len(self._identified)
        self._largest[:] = 0.0
        self._block_count = np.zeros(width, dtype=np.int64)
        self._motion_ticks = np.zeros(width, dtype=np.int64)
        self.bound, self.known = np.zeros(width), np.zeros(width)
        self._median = np.zeros(width)
        self.factor = self._start
        self._post_contact_ticks, self._untouched_ticks = 0, SUSPECT_TICKS
        self._drop()

    def _drop(self) -> None:
        """Forget the blocks that may contain the beginning of a touch."""
        width = len(self._largest)
        self._block, self._previous_block = np.zeros(width), np.full(width, np.nan)
        self._samples = np.zeros(width, dtype=np.int64)

    def touched(self) -> None:
        """Take in one tick with a touch: the residuals just before it may be its beginning."""
        self._untouched_ticks = 0
        if self._post_contact_ticks < POST_CONTACT_TICKS:
            self._post_contact_ticks = POST_CONTACT_TICKS
            self._drop()

    def learn(self, residual: FloatArray, seen: BoolArray, moving: BoolArray) -> None:
        """Take in one tick without touch.

        A block takes in all samples. It is full when enough of them were in motion: residuals at rest alone are too
        small.

        Args:
            residual: (n,) [rad].
            seen: (n,) joints that can be judged.
            moving: (n,) joints that are to move.
        """
        self._untouched_ticks += 1
        counts = seen & moving
        if np.count_nonzero(counts & (self.known < 1.0)):
            self._motion_ticks += counts
            self.known = np.minimum(self._motion_ticks / FIRST_MOTION_TICKS, 1.0)
            self._widen()
        if self._post_contact_ticks:
            self._post_contact_ticks -= 1
            return
        self._block = np.maximum(self._block, np.where(seen, np.abs(residual), 0.0))
        self._samples += counts
        over = self._samples >= BLOCK_TICKS
        if not np.count_nonzero(over):
            return
        # One block late: a touch that was detected in the next block would have begun in this one.
        keep = over & ~np.isnan(self._previous_block)
        if self._untouched_ticks < SUSPECT_TICKS:
            # Until the first motion is complete, large blocks are normal: they must count.
            suspect = self._previous_block > SUSPECT_RATIO * self.factor * self._identified
            keep &= ~(suspect & (self.known == 1.0))
        for joint in np.flatnonzero(keep).tolist():
            self._keep(joint)
        self._previous_block[over], self._block[over], self._samples[over] = (
            self._block[over],
            0.0,
            0,
        )
        self._widen()

    def _widen(self) -> None:
        """Update the factor."""
        few_blocks_factor = np.maximum(
            self._start, FEW_BLOCKS_FACTOR * self._median / self._identified
        )
        max_factor = np.where(
            self._block_count < BLOCKS_PER_RANK,
            np.minimum(few_blocks_factor, MAX_ENVELOPE_FACTOR),
            MAX_ENVELOPE_FACTOR,
        )
        factor = np.maximum(self._start * (1.0 - self.known), self.bound / self._identified)
        self.factor = np.minimum(np.maximum(factor, 1.0), max_factor)

    def _keep(self, joint: int) -> None:
        """Store the previous block: no touch has followed it."""
        self._largest[joint, self._block_count[joint] % MAX_BLOCKS] = self._previous_block[joint]
        self._block_count[joint] += 1
        blocks = min(int(self._block_count[joint]), MAX_BLOCKS)
        seen = np.sort(self._largest[joint, :blocks])
        rank = min(ENVELOPE_RANK, max(blocks // BLOCKS_PER_RANK, 1))
        self._median[joint] = seen[blocks // 2]
        self.bound[joint] = min(ENVELOPE_FACTOR * seen[-rank], MEDIAN_FACTOR * self._median[joint])


REST_SPEED = 0.05
"""[rad/s] Desired speed below which friction can hold a joint."""

SPEED_MEMORY = 0.5
"""[s] Window of the largest desired speed."""

THRESHOLD_MEMORY = 0.25
"""[s] For which a threshold stays raised."""

LIMITED_FACTOR = 2.0
"""Factor while the safety gate alters a command: the load torque belongs to the command before the gate."""

UNSETTLED_RATIO = 0.5
"""Relative increase just after a touch where a motor board integrates errors, which it releases later."""

UNCERTAINTY_FACTOR = 2.0
"""Standard deviations of the prediction, from unknown constants, by which a threshold rises."""

MIN_START_THRESHOLD = np.radians(1.8)
"""[rad] Smallest threshold at the start: the residual of a worn joint, however small it was at identification."""

QUIET_RATIO = 0.5
"""Fraction of a threshold below which a residual is used for learning."""


class FusionThreshold:
    """Bounds of the models, times the factor of the residual envelope, plus the uncertainty of the constants.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        adapt: False to use the bounds of the models alone.

    Attributes:
        bounds: (n,) largest bound of each model [rad].
        speed: (n,) desired speed of the last tick [rad/s].
        quiet_bound: (n,) residual below which the constants of a joint are adapted [rad].
        learning_bound: (n,) residual below which the loads of the hands are learned [rad]; it follows the envelope.
    """

    def __init__(self, models: list[FusionModel | None], cycle: float, *, adapt: bool) -> None:
        self._cycle, self._adapt = cycle, adapt
        self._bounds = BatchedTrees([None if m is None else m.bound for m in models])
        self._phase = np.zeros((FEATURES, len(models)))
        self.bounds = np.array([np.nan if m is None else m.max_bound for m in models])
        # fmax ignores the NaN of joints without a model.
        start = np.fmax(START_FACTOR, MIN_START_THRESHOLD / self.bounds)
        self._envelope = ResidualEnvelope(self.bounds, start)
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        n = len(self.bounds)
        self._envelope.reset()
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
        """Take in one tick; return (n,) thresholds [rad].

        Args:
            velocity: (n,) desired [rad/s].
            acceleration: (n,) desired [rad/s2].
            limited: (n,) where the safety gate altered the command.
            uncertainty: (n,) standard deviation of the expected error [rad].
            unsettled: (n,) 0..1, 1 just after the robot was released; None where all joints have settled.
        """
        speed, size, largest = self._phase
        np.abs(velocity, out=speed)
        np.abs(acceleration, out=size)
        largest[:] = self._speeds.push(speed)
        self.speed = speed
        bound = self._bounds.predict(self._phase)
        self.quiet_bound = QUIET_RATIO * bound
        if self._adapt:
            margin = UNCERTAINTY_FACTOR * uncertainty
            self.quiet_bound = QUIET_RATIO * (bound + margin)
            bound = bound * self._envelope.factor + margin
        self.learning_bound = QUIET_RATIO * bound
        # The quiet and the learning bound stay: an altered command is no reason to learn more.
        if np.count_nonzero(limited):
            bound = np.where(limited, LIMITED_FACTOR * bound, bound)
        if unsettled is not None:
            bound = bound * (1.0 + UNSETTLED_RATIO * unsettled)
        # The filtered residual is later than the motion that raised the threshold.
        return self._recent.push(bound)

    def learn(self, residual: FloatArray, seen: BoolArray | None) -> None:
        """Take in residuals (n,) [rad] of joints that can be judged (n,); None for those while the robot is touched."""
        if not self._adapt:
            return
        if seen is None:
            self._envelope.touched()
        else:
            self._envelope.learn(residual, seen, self.speed > REST_SPEED)
