"""Thresholds of residuals: a multiple of the spread that each joint shows without touch, by phase of its motion.

The spread of a residual in free motion differs between joints by a factor of ten, between days by less than two. It
starts as identified, and follows the robot of today slowly. How large a multiple is needed depends on the number of
false contacts that are allowed: the tail of the spread is exponential. It is long at rest, while a joint breaks away,
and for joints of the trunk; it is short in motion of a limb that lasts. A joint that is commanded to move and does not
slide yet breaks away sooner or later than its model: its threshold is HELD_FACTOR times as high, until its model has
followed it at rest. In slow motion, friction lets go of a joint and holds it again: a threshold while sliding is at
least FRICTION_RATIO of it. A joint that swings around its target settles later than others.
"""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    EXCURSIONS,
    FRICTION_RATIO,
    HELD_FACTOR,
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
from pepper_driver.observer.models.fusion_model import FusionModel

SPREAD_QUANTILE = 0.99
"""The spread is this quantile of the size of a residual in free motion."""

MIN_SAMPLES = 500
"""Six seconds in a phase of the motion, from which a spread is found; with fewer it is that of another phase."""

REST, BREAKAWAY, SLIDING = range(3)
"""Phases of the motion of a joint without touch: at rest; just after it broke away; sliding since it has settled."""


def threshold_factor(false_contacts: float, tail: float) -> float:
    """Return the threshold in spreads at which so many contacts an hour are false."""
    return 1.0 + tail * max(math.log(EXCURSIONS / false_contacts), 0.0)


def phase_factors(false_contacts: float, *, trunk: bool = False) -> FloatArray:
    """Return (3,) thresholds in spreads by phase, of a joint of the trunk or of a limb.

    Joints of the trunk have a long tail in motion that lasts too: as they slow down, the weight on them sways.
    """
    tails = (TAIL, TAIL, TAIL if trunk else SLIDING_TAIL)
    return np.array([threshold_factor(false_contacts, tail) for tail in tails])


def min_thresholds(load_gain: FloatArray | float, friction: FloatArray | float) -> FloatArray:
    """Return the smallest thresholds by phase, (3,) of a joint or (3, n) of joints [rad].

    Args:
        load_gain: g = 1 / K [rad/(N m)].
        friction: F / K [rad].
    """
    torque = MIN_TORQUE * load_gain
    return np.array([torque, torque, np.maximum(torque, FRICTION_RATIO * friction)])


def identified_thresholds(
    model: FusionModel, false_contacts: float, *, trunk: bool = False
) -> FloatArray:
    """Return (3,) thresholds of a joint as identified, by phase [rad].

    Args:
        model: Of the joint.
        false_contacts: That are allowed in an hour.
        trunk: True for a joint of the trunk.
    """
    factors = phase_factors(false_contacts, trunk=trunk)
    thresholds: FloatArray = np.maximum(
        factors * np.maximum(model.spread, MIN_SPREAD),
        min_thresholds(model.twin.load_gain, model.twin.friction),
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
    spreads: Out[Records[SpreadState]], j: int, residual: float, min_spread: float
) -> None:
    """Take in a residual without touch; ``min_spread`` is the smallest spread that it may have."""
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
    lowest = max(spread.identified / UNSURE_FACTOR, min(min_spread, spread.identified))
    spread.today = min(max(spread.today, lowest), spread.identified * UNSURE_FACTOR)


class ThresholdState:
    """Threshold of one joint, and the motion without touch on which it depends.

    Attributes:
        settling_ticks: In which it settles after it broke away.
        held_ticks: For which its model has been at rest.
        sliding_ticks: For which it has slid.
        still_ticks: For which its command has been at rest.
        moving: True if it slides, or did in the last PUSH_TICKS.
        phase: REST, BREAKAWAY or SLIDING.
        touched: True from when it is touched until it is let go; set by the caller.
        last: Threshold of the last tick, if the gate did not alter the command [rad].
    """

    settling_ticks: int
    held_ticks: int
    sliding_ticks: int
    still_ticks: int
    moving: bool
    phase: int
    touched: bool
    last: float


@kernel
def step_threshold(
    spreads: Records[SpreadState],
    states: Out[Records[ThresholdState]],
    factors: Matrix[FloatArray],
    min_thresholds: Matrix[FloatArray],
    j: int,
    speed: float,
    desired: float,
    limited: bool,
    rest_ticks: int,
) -> float:
    """Take in one tick of a joint; return its threshold [rad].

    Args:
        spreads: By phase and joint.
        states: Of the joints.
        factors: (3, n) of a threshold over the spread, by phase and joint.
        min_thresholds: (3, n) smallest threshold, by phase and joint [rad].
        j: Index of the joint.
        speed: Without touch [rad/s]: of the stick-slip model, which friction holds as it does the joint.
        desired: Velocity that is commanded [rad/s].
        limited: True if the safety gate altered the command.
        rest_ticks: In which a model follows its joint at rest.
    """
    state, slides = states[j], abs(speed) > REST_SPEED
    state.sliding_ticks = state.sliding_ticks + 1 if slides else 0
    state.held_ticks = 0 if slides else state.held_ticks + 1
    state.still_ticks = state.still_ticks + 1 if abs(desired) <= REST_SPEED else 0
    state.moving = state.held_ticks < PUSH_TICKS
    if not state.moving:
        state.phase = REST
    elif state.sliding_ticks <= state.settling_ticks:
        state.phase = BREAKAWAY
    else:
        state.phase = SLIDING
    factor = factors[state.phase, j]
    if state.phase != SLIDING and state.still_ticks <= rest_ticks:
        factor *= HELD_FACTOR
    spread = spreads[state.phase * len(states) + j]
    threshold = np.maximum(spread.today * factor, min_thresholds[state.phase, j])
    if state.touched:
        # A hand holds on while a joint turns or stops: its touch is over when it is.
        threshold = min(threshold, state.last)
    state.last = threshold
    if limited:
        threshold *= UNSURE_FACTOR
    return float(threshold)


@kernel
def load_margin(
    states: Records[ThresholdState], limbs: IntArray, j: int, load_doubt: float, rest_ticks: int
) -> float:
    """Return what a threshold is wider by, for a load in the hand that is not known [rad].

    It pulls at a joint from another side while any joint of its limb moves. Models of a limb at rest soon know what it
    has done to them.

    Args:
        states: Of the joints, after the tick.
        limbs: (n,) number of the limb of each joint.
        j: Index of the joint.
        load_doubt: Standard deviation of the error that follows from what is not known of the load [rad].
        rest_ticks: In which a model follows its joint at rest.
    """
    for i in range(len(states)):
        if limbs[i] == limbs[j] and states[i].held_ticks + 1 < PUSH_TICKS + rest_ticks:
            return UNSURE_FACTOR * load_doubt
    return 0.0


class SpreadThreshold:
    """Spreads and thresholds of joints, for :func:`step_threshold` and :func:`learn_spread`.

    Args:
        spread: (n, 3) as identified, by phase [rad]; NaN for joints without a model.
        load_gain: (n,) g = 1 / K [rad/(N m)].
        friction: (n,) F / K [rad].
        settling_time: (n,) in which a swing decays [s].
        cycle: Period of the ticks [s].
        false_contacts: That are allowed in an hour.
        trunk: (n,) joints of the trunk.

    Attributes:
        factors: (3, n) of a threshold over the spread, by phase and joint.
        min_thresholds: (3, n) smallest threshold, by phase and joint [rad].
        rest_ticks: In which a model follows its joint at rest.
        spreads: (3 n,) by phase and joint.
        states: Of the joints.
    """

    def __init__(
        self,
        spread: FloatArray,
        load_gain: FloatArray,
        friction: FloatArray,
        settling_time: FloatArray,
        cycle: float,
        *,
        false_contacts: float,
        trunk: BoolArray,
    ) -> None:
        self._identified = np.fmax(spread, MIN_SPREAD)
        self._identified[np.isnan(spread)] = np.nan
        by_joint = [phase_factors(false_contacts, trunk=bool(joint)) for joint in trunk]
        self.factors = np.array(by_joint).T.copy()
        self.min_thresholds = min_thresholds(load_gain, friction)
        self.rest_ticks = round(CORRECTION_TIME / cycle)
        # The poles of a model that is a little wrong may not decay at all.
        settling = np.rint(np.minimum(settling_time, CORRECTION_TIME) / cycle)
        self._settling_ticks = np.maximum(settling, SETTLING_TICKS).astype(np.int64)
        self.reset()

    def reset(self) -> None:
        """Forget the session: spreads are as identified, and joints have been at rest for long."""
        by_phase = self._identified.T.ravel()
        self.spreads = make_records(SpreadState, len(by_phase), identified=by_phase, today=by_phase)
        self.states = make_records(
            ThresholdState,
            len(self._settling_ticks),
            settling_ticks=self._settling_ticks,
            held_ticks=PUSH_TICKS + self.rest_ticks,
            still_ticks=self.rest_ticks,
            last=np.inf,
        )

    @property
    def bounds(self) -> FloatArray:
        """(n,) largest threshold of each joint, as identified [rad]."""
        by_phase = np.maximum(self.factors * self._identified.T, self.min_thresholds)
        bounds: FloatArray = by_phase.max(axis=0)
        return bounds

    @property
    def change(self) -> FloatArray:
        """(n,) spread while sliding over that identified."""
        sliding = self.spreads["today"] / self.spreads["identified"]
        change: FloatArray = sliding[SLIDING * len(self.states) :]
        return change
