"""Adaptive threshold, and the envelope of the residual without touch that widens it."""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.tree import BatchedTrees, TreeNode, TreeRoot, evaluate_tree
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


class Envelope:
    """Residual envelope of one joint.

    Attributes:
        identified: Threshold [rad].
        start: Factor on it at the start, 1 or more.
        motion_ticks: Samples in motion so far.
        known: 0..1, completed fraction of the first motion.
        block: Largest residual of the present block [rad].
        samples: Samples in motion in it.
        previous_block: Largest residual of the block before, which is not stored yet [rad]; NaN without one.
        block_count: Blocks stored so far.
        median: Of the stored blocks [rad].
        bound: [rad]
        factor: 1 or more, present factor on the identified threshold.
    """

    identified: float
    start: float
    motion_ticks: int
    known: float
    block: float
    samples: int
    previous_block: float
    block_count: int
    median: float
    bound: float
    factor: float


@kernel
def _widen(envelopes: Out[Records[Envelope]], j: int) -> None:
    """Update the factor."""
    e = envelopes[j]
    factor = np.maximum(e.start * (1.0 - e.known), e.bound / e.identified)
    max_factor = MAX_ENVELOPE_FACTOR
    if e.block_count < BLOCKS_PER_RANK:
        few_blocks_factor = np.maximum(e.start, FEW_BLOCKS_FACTOR * e.median / e.identified)
        max_factor = np.minimum(few_blocks_factor, MAX_ENVELOPE_FACTOR)
    e.factor = np.minimum(np.maximum(factor, 1.0), max_factor)


@kernel
def _keep(envelopes: Out[Records[Envelope]], j: int, stored: Out[Matrix[FloatArray]]) -> None:
    """Store the previous block: no touch has followed it."""
    e = envelopes[j]
    stored[j, e.block_count % MAX_BLOCKS] = e.previous_block
    e.block_count += 1
    blocks = min(e.block_count, MAX_BLOCKS)
    ordered = np.sort(stored[j, :blocks])
    rank = min(ENVELOPE_RANK, max(blocks // BLOCKS_PER_RANK, 1))
    e.median = ordered[blocks // 2]
    e.bound = min(ENVELOPE_FACTOR * ordered[blocks - rank], MEDIAN_FACTOR * e.median)


@kernel
def _learn_motion(envelopes: Out[Records[Envelope]], seen: BoolArray, moving: BoolArray) -> None:
    """Count the samples of the first motion."""
    first = False
    for j in range(len(envelopes)):
        if seen[j] and moving[j]:
            first = first or envelopes[j].known < 1.0
    if not first:
        return
    for j in range(len(envelopes)):
        e = envelopes[j]
        if seen[j] and moving[j]:
            e.motion_ticks += 1
            e.known = min(e.motion_ticks / FIRST_MOTION_TICKS, 1.0)
        _widen(envelopes, j)


@kernel
def _learn_blocks(
    envelopes: Out[Records[Envelope]],
    stored: Out[Matrix[FloatArray]],
    residual: FloatArray,
    seen: BoolArray,
    moving: BoolArray,
    suspicious: bool,
) -> None:
    """Take in residuals; ``suspicious`` shortly after a touch."""
    for j in range(len(envelopes)):
        if not seen[j]:
            continue
        e = envelopes[j]
        e.block = max(e.block, abs(residual[j]))
        if moving[j]:
            e.samples += 1
        if e.samples < BLOCK_TICKS:
            continue
        # Until the first motion is complete, large blocks are normal: they must count.
        suspect = (
            suspicious
            and e.known == 1.0
            and e.previous_block > SUSPECT_RATIO * e.factor * e.identified
        )
        # One block late: a touch that was detected in the next block would have begun in this one.
        if not math.isnan(e.previous_block) and not suspect:
            _keep(envelopes, j, stored)
            _widen(envelopes, j)
        e.previous_block, e.block, e.samples = e.block, 0.0, 0


class ResidualEnvelope:
    """Residual envelope: ENVELOPE_FACTOR times the ENVELOPE_RANK-th largest residual of the last MAX_BLOCKS blocks.

    MEDIAN_FACTOR times their median is its upper limit. The residual of a worn or loaded robot differs between joints
    and between days. Its size in the last minute predicts the next minute better than any identification. The envelope
    learns most in the first half-minute of a session, in which the robot should not be touched.

    Args:
        identified: (n,) thresholds [rad].
        start: (n,) factor on them at the start, 1 or more.

    Attributes:
        envelopes: Of each joint.
    """

    def __init__(self, identified: FloatArray, start: FloatArray) -> None:
        self._identified, self._start = identified, start
        self._stored = np.zeros((len(identified), MAX_BLOCKS))
        self._learn_motion, self._learn_blocks = _learn_motion.load(), _learn_blocks.load()
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        self._stored[:] = 0.0
        self.envelopes = make_records(
            Envelope,
            len(self._identified),
            identified=self._identified,
            start=self._start,
            factor=self._start,
            previous_block=np.nan,
        )
        self._post_contact_ticks, self._untouched_ticks = 0, SUSPECT_TICKS

    def touched(self) -> None:
        """Take in one tick with a touch: the residuals just before it may be its beginning."""
        self._untouched_ticks = 0
        if self._post_contact_ticks < POST_CONTACT_TICKS:
            self._post_contact_ticks = POST_CONTACT_TICKS
            # Forget the blocks that may contain the beginning of the touch.
            self.envelopes["block"], self.envelopes["samples"] = 0.0, 0
            self.envelopes["previous_block"] = np.nan

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
        self._learn_motion(self.envelopes, seen, moving)
        if self._post_contact_ticks:
            self._post_contact_ticks -= 1
            return
        suspicious = self._untouched_ticks < SUSPECT_TICKS
        self._learn_blocks(self.envelopes, self._stored, residual, seen, moving, suspicious)


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


@kernel
def _threshold(
    roots: Records[TreeRoot],
    nodes: Records[TreeNode],
    envelopes: Records[Envelope],
    adapt: bool,
    velocity: FloatArray,
    acceleration: FloatArray,
    fastest: FloatArray,
    limited: BoolArray,
    uncertainty: FloatArray,
    unsettled: FloatArray,
    moving: Out[BoolArray],
    quiet_bound: Out[FloatArray],
    learning_bound: Out[FloatArray],
    threshold: Out[FloatArray],
) -> None:
    for j in range(len(threshold)):
        speed = abs(velocity[j])
        moving[j] = speed > REST_SPEED
        bound = evaluate_tree(roots, nodes, j, speed, abs(acceleration[j]), fastest[j])
        quiet_bound[j] = QUIET_RATIO * bound
        if adapt:
            margin = UNCERTAINTY_FACTOR * uncertainty[j]
            quiet_bound[j] = QUIET_RATIO * (bound + margin)
            bound = bound * envelopes[j].factor + margin
        # The quiet and the learning bound stay: an altered command is no reason to learn more.
        learning_bound[j] = QUIET_RATIO * bound
        if limited[j]:
            bound *= LIMITED_FACTOR
        threshold[j] = bound * (1.0 + UNSETTLED_RATIO * unsettled[j])


class FusionThreshold:
    """Bounds of the models, times the factor of the residual envelope, plus the uncertainty of the constants.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        adapt: False to use the bounds of the models alone.

    Attributes:
        bounds: (n,) largest bound of each model [rad].
        moving: (n,) joints that are to move in the last tick: desired speed above REST_SPEED.
        quiet_bound: (n,) residual below which the constants of a joint are adapted [rad].
        learning_bound: (n,) residual below which the loads of the hands are learned [rad]; it follows the envelope.
    """

    def __init__(self, models: list[FusionModel | None], cycle: float, *, adapt: bool) -> None:
        self._cycle, self._adapt = cycle, adapt
        self._bounds = BatchedTrees([None if m is None else m.bound for m in models])
        self.bounds = np.array([np.nan if m is None else m.max_bound for m in models])
        # fmax ignores the NaN of joints without a model.
        start = np.fmax(START_FACTOR, MIN_START_THRESHOLD / self.bounds)
        self._envelope = ResidualEnvelope(self.bounds, start)
        self._settled = np.zeros(len(models))
        self._step = _threshold.load()
        self.reset()

    def reset(self) -> None:
        """Forget the session."""
        n = len(self.bounds)
        self._envelope.reset()
        self._speeds = RunningMaximum(SPEED_MEMORY, self._cycle, n)
        self._recent = RunningMaximum(THRESHOLD_MEMORY, self._cycle, n)
        self.moving = np.zeros(n, dtype=np.bool_)
        self.quiet_bound, self.learning_bound = np.zeros(n), np.zeros(n)

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
        n = len(velocity)
        self.moving = np.empty(n, np.bool_)
        self.quiet_bound, self.learning_bound, bound = np.empty(n), np.empty(n), np.empty(n)
        self._step(
            self._bounds.roots,
            self._bounds.nodes,
            self._envelope.envelopes,
            self._adapt,
            velocity,
            acceleration,
            self._speeds.push(np.abs(velocity)),
            limited,
            uncertainty,
            self._settled if unsettled is None else unsettled,
            self.moving,
            self.quiet_bound,
            self.learning_bound,
            bound,
        )
        # The filtered residual is later than the motion that raised the threshold.
        return self._recent.push(bound)

    def learn(self, residual: FloatArray, seen: BoolArray | None) -> None:
        """Take in residuals (n,) [rad] of joints that can be judged (n,); None for those while the robot is touched."""
        if not self._adapt:
            return
        if seen is None:
            self._envelope.touched()
        else:
            self._envelope.learn(residual, seen, self.moving)
