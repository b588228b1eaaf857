"""The two channels of mode ``fusion``, and their agreement: the position, and the motor current, of a free motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel
from pepper_driver.observer.constants import MIN_SPREAD, QUIET_RATIO
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import StickSlipState
from pepper_driver.observer.residuals.momentum import (
    CurrentChannel,
    DerivativeFilter,
    ErrorDerivatives,
    current_channels,
    current_residual,
    differentiate,
)
from pepper_driver.observer.residuals.prediction import (
    PredictedJoint,
    Prediction,
    update_integral,
)
from pepper_driver.observer.running_filters import RunningMedian, push_median


@dataclass(slots=True)
class Channels:
    """Residuals of one tick [rad]; arrays (n,) but for ``filtered``.

    Attributes:
        filtered: (2 n,) by the model, then by the current, after the running median.
        residual: The smaller of both, 0 where their signs differ.
        raw: The same before the median, NaN for joints that cannot be judged.
        change: Derivative of the tracking error [rad/s].
        bad: Joints that cannot be judged; None if there is none.
        falls_behind: True if a board holds its target behind the command.
    """

    filtered: FloatArray
    residual: FloatArray
    raw: FloatArray
    change: FloatArray
    bad: BoolArray | None
    falls_behind: bool


@kernel
def _exclude_behind(
    target: FloatArray,
    model: Records[StickSlipState],
    carries: Matrix[BoolArray],
    good: Out[BoolArray],
) -> bool:
    """Clear ``good`` of joints whose load depends on a board that is behind its command; return True if one is."""
    behind = False
    for i in range(len(good)):
        if abs(target[i] - model[i].target) > MIN_SPREAD:
            behind = True
            for j in range(len(good)):
                good[j] = good[j] and not carries[i, j]
    return behind


@kernel
def _agreed(model: float, current: float) -> float:
    """Return the smaller of two residuals, 0 where their signs differ."""
    size = min(abs(model), abs(current)) if model * current > 0.0 else 0.0
    return math.copysign(size, model)


@kernel
def _compare(
    joints: Out[Records[PredictedJoint]],
    filters: Out[Records[DerivativeFilter]],
    channels: Out[Records[CurrentChannel]],
    rings: Out[Matrix[FloatArray]],
    count: int,
    ordered: Out[FloatArray],
    carries: Matrix[BoolArray],
    no_model: BoolArray,
    uses_model: bool,
    uses_current: bool,
    gain: float,
    cycle: float,
    pushed: bool,
    target: FloatArray,
    load_torque: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    model: Records[StickSlipState],
    measured: FloatArray,
    current: FloatArray,
    bias: FloatArray,
    good: Out[BoolArray],
    filtered: Out[FloatArray],
    residual: Out[FloatArray],
    raw: Out[FloatArray],
    change: Out[FloatArray],
) -> tuple[int, bool]:
    """Compute the arrays of :class:`Channels`; return how many joints are good, and True if a board falls behind.

    The arguments are those of :class:`Prediction`, ``current_residual``, ``differentiate`` and ``push_median``. Where a
    joint with a model has no residual, it is no longer ``good``.
    """
    falls_behind = _exclude_behind(target, model, carries, good)
    good_count, n = 0, len(good)
    for j in range(n):
        joint, expected = joints[j], model[j]
        error, board_error = target[j] - measured[j], expected.target - measured[j]
        change[j], curvature = differentiate(filters, j, error, gain, cycle)
        by_current, motor = current_residual(
            channels,
            j,
            current[j],
            board_error + joint.board_integral,
            velocity[j] - change[j],
            acceleration[j] - curvature,
            expected.friction + joint.load_gain * load_torque[j],
            pushed,
        )
        if good[j]:
            update_integral(joints, j, board_error, motor, cycle)
        by_model = expected.position - measured[j] - bias[j]
        by_current = by_current - bias[j] if channels[j].by_current else by_model
        good[j] = good[j] and (math.isfinite(by_model + by_current) or no_model[j])
        good_count += good[j]
        if not uses_model:
            by_model = by_current
        if not uses_current:
            by_current = by_model
        if not good[j]:
            by_model = by_current = 0.0
        filtered[j] = push_median(rings, j, count, by_model, ordered)
        filtered[n + j] = push_median(rings, n + j, count, by_current, ordered)
        residual[j] = _agreed(filtered[j], filtered[n + j])
        raw[j] = _agreed(by_model, by_current) if good[j] else math.nan
    return good_count, falls_behind


@kernel
def follow_hand(
    hands: Out[IntArray], j: int, residual: float, by_current: float, threshold: float
) -> float:
    """Return the residual of a joint: while it is touched that of the current, until this has fallen.

    A board that sums up errors takes a joint back to its target while a hand still holds it: the first channel then
    shows nothing more, and after the release something that is no touch. ``hands`` has the signs of touches.
    """
    if abs(residual) > threshold:
        hands[j] = 1 if residual > 0.0 else -1
    elif by_current * hands[j] <= QUIET_RATIO * threshold:
        hands[j] = 0
    return by_current if hands[j] != 0 else residual


class ChannelComparison:
    """Comparison of the measured joints with a free motion, in position and in current.

    The stick-slip model shows a touch as an unexpected position, the motor current as a torque that a free motion does
    not need (:func:`current_residual`). The residual is the smaller of the two, and 0 where they contradict each other:
    a board that follows another target than the command shows in the first channel alone, a current of the wrong
    sign in the second one. Where the current does not show the torque, the model alone counts.

    Args:
        models: By joint, None for those without.
        cycle: Period of the ticks [s].
        window: Samples of the median.
        carries: (n, n) True where the load on the joint of the column depends on the motion of the joint of the row.
        uses_model: False for the residual by the current alone, where there is one.
        uses_current: False for the residual by the model alone.

    Attributes:
        hands: (n,) signs of touches, for :func:`follow_hand`.
    """

    def __init__(
        self,
        models: Sequence[FusionModel | None],
        cycle: float,
        *,
        window: int,
        carries: BoolArray,
        uses_model: bool = True,
        uses_current: bool = True,
    ) -> None:
        n = len(models)
        self._no_model = np.array([m is None for m in models])
        self._channels = current_channels(models)
        self._derivatives = ErrorDerivatives(n, cycle)
        self._median = RunningMedian(window, 2 * n)
        self._carries, self._cycle = carries, cycle
        self._uses_model, self._uses_current = uses_model, uses_current
        self._compare = _compare.load_unchecked()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self._derivatives.reset()
        self._median.reset()
        for name in ("answered", "recent", "steady"):
            self._channels[name] = 0
        self.hands = np.zeros(len(self._no_model), dtype=np.int64)

    def step(
        self,
        joints: Records[PredictedJoint],
        prediction: Prediction,
        measured: FloatArray,
        current: FloatArray,
        bias: FloatArray,
        good: BoolArray,
        *,
        pushed: bool,
    ) -> Channels:
        """Take in one tick; all values finite.

        Args:
            joints: Of the predictor; the integrals of their boards are updated.
            prediction: For the time of the sample.
            measured: (n,) positions [rad].
            current: (n,) absolute [A].
            bias: (n,) of the residuals [rad].
            good: (n,) joints whose values are valid; those that cannot be judged are cleared.
            pushed: True while the base shows a push.
        """
        derivatives, median, n = self._derivatives, self._median, len(good)
        if not derivatives.started:
            derivatives.start(prediction.target - measured)
        filtered, (residual, raw, change) = np.empty(2 * n), np.empty((3, n))
        count, falls_behind = self._compare(
            joints,
            derivatives.filters,
            self._channels,
            median.rings,
            median.count,
            median.ordered,
            self._carries,
            self._no_model,
            self._uses_model,
            self._uses_current,
            derivatives.gain,
            self._cycle,
            pushed,
            prediction.target,
            prediction.load_torque,
            prediction.velocity,
            prediction.acceleration,
            prediction.model,
            measured,
            current,
            bias,
            good,
            filtered,
            residual,
            raw,
            change,
        )
        median.count += 1
        return Channels(
            filtered=filtered,
            residual=residual,
            raw=raw,
            change=change,
            bad=None if count == n else ~good,
            falls_behind=falls_behind,
        )

    def put(self, where: BoolArray, error: FloatArray) -> None:
        """Forget the residuals of the joints ``where`` (n,), whose models were reset; ``error`` (n,) [rad] is new."""
        # Older residuals were those of the model before its reset.
        self._median.clear(np.tile(where, 2))
        self._derivatives.put(where, error)
