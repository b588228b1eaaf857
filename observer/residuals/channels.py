"""The two channels of mode ``fusion``, and their agreement: the position, and the motor current, of a free motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray
from pepper_driver.config.kernels import Matrix, Out, Records, kernel, make_records
from pepper_driver.observer.constants import MIN_SPREAD, QUIET_RATIO
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.stick_slip import StickSlipState
from pepper_driver.observer.residuals.joint_tick import JointCommand, JointTick
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


class ChannelSettings:
    """Settings of a comparison, the same for all joints.

    Attributes:
        uses_model: False for the residual by the current alone, where there is one.
        uses_current: False for the residual by the model alone.
        gain: Of the derivatives: fraction of a change that their filters take in with one sample.
        cycle: Period of the ticks [s].
    """

    uses_model: bool
    uses_current: bool
    gain: float
    cycle: float


@kernel
def _exclude_behind(
    commands: Records[JointCommand],
    model: Records[StickSlipState],
    carries: Matrix[BoolArray],
    ticks: Out[Records[JointTick]],
) -> bool:
    """Mark joints whose load depends on a board that is behind its command as not good; return True if one is."""
    behind = False
    for i in range(len(ticks)):
        if abs(commands[i].target - model[i].target) > MIN_SPREAD:
            behind = True
            for j in range(len(ticks)):
                ticks[j].good = ticks[j].good and not carries[i, j]
    return behind


@kernel
def _agreed(model: float, current: float) -> float:
    """Return the smaller of two residuals, 0 where their signs differ."""
    size = min(abs(model), abs(current)) if model * current > 0.0 else 0.0
    return math.copysign(size, model)


@kernel
def _compare(
    settings: Records[ChannelSettings],
    joints: Out[Records[PredictedJoint]],
    filters: Out[Records[DerivativeFilter]],
    channels: Out[Records[CurrentChannel]],
    rings: Out[Matrix[FloatArray]],
    count: int,
    ordered: Out[FloatArray],
    carries: Matrix[BoolArray],
    pushed: bool,
    commands: Records[JointCommand],
    model: Records[StickSlipState],
    ticks: Out[Records[JointTick]],
) -> bool:
    """Compute both residuals of each joint; return True if a board falls behind.

    The arguments are those of ``current_residual``, ``differentiate`` and ``push_median``. Where a joint with a model
    has no residual, it is no longer ``good``.
    """
    falls_behind = _exclude_behind(commands, model, carries, ticks)
    use, n = settings[0], len(ticks)
    for j in range(n):
        tick, command, joint, expected = ticks[j], commands[j], joints[j], model[j]
        error, board_error = command.target - tick.measured, expected.target - tick.measured
        tick.change, curvature = differentiate(filters, j, error, use.gain, use.cycle)
        by_current, motor, output = current_residual(
            channels,
            j,
            tick.current,
            board_error + joint.board_integral,
            command.velocity - tick.change,
            command.acceleration - curvature,
            expected.friction + joint.load_gain * command.load_torque,
            pushed,
        )
        tick.motor, tick.output = motor, output
        if tick.good:
            update_integral(joints, j, board_error, motor, use.cycle)
        by_model = expected.position - tick.measured - joint.bias
        by_current = by_current - joint.bias if channels[j].by_current else by_model
        tick.good = tick.good and (math.isfinite(by_model + by_current) or joint.no_model)
        if not use.uses_model:
            by_model = by_current
        if not use.uses_current:
            by_current = by_model
        if not tick.good:
            by_model = by_current = 0.0
        tick.by_model = push_median(rings, j, count, by_model, ordered)
        tick.by_current = push_median(rings, n + j, count, by_current, ordered)
        tick.residual = _agreed(tick.by_model, tick.by_current)
        tick.raw = _agreed(by_model, by_current) if tick.good else math.nan
    return falls_behind


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
        by_current: (n,) True where the current shows the torque of the motor.
        gain: Fraction of a change that the smoothed values take in with one sample.
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
        self._channels = current_channels(models)
        self.by_current: BoolArray = self._channels["by_current"].copy()
        self._derivatives = ErrorDerivatives(n, cycle)
        self.gain = self._derivatives.gain
        self._settings = make_records(
            ChannelSettings,
            1,
            uses_model=uses_model,
            uses_current=uses_current,
            gain=self._derivatives.gain,
            cycle=cycle,
        )
        self._median = RunningMedian(window, 2 * n)
        self._carries = carries
        self._compare = _compare.load_unchecked()
        self.reset()

    def reset(self) -> None:
        """Forget everything but the models."""
        self._derivatives.reset()
        self._median.reset()
        for name in ("answered", "recent", "steady"):
            self._channels[name] = 0
        self.hands = np.zeros(len(self._channels), dtype=np.int64)

    def step(
        self,
        joints: Records[PredictedJoint],
        prediction: Prediction,
        ticks: Records[JointTick],
        *,
        pushed: bool,
    ) -> bool:
        """Take in one tick; all values finite.

        Args:
            joints: Of the predictor; the integrals of their boards are updated.
            prediction: For the time of the sample.
            ticks: (n,) with the samples, ``good`` where they are valid; their residuals are set, and ``good`` is
                cleared where a joint cannot be judged.
            pushed: True while the base shows a push.

        Returns:
            True if a board holds its target behind the command.
        """
        derivatives, median = self._derivatives, self._median
        if not derivatives.started:
            derivatives.start(prediction.command["target"] - ticks["measured"])
        found = self._compare(
            self._settings,
            joints,
            derivatives.filters,
            self._channels,
            median.rings,
            median.count,
            median.ordered,
            self._carries,
            pushed,
            prediction.command,
            prediction.model,
            ticks,
        )
        median.count += 1
        return found

    def put(self, where: BoolArray, error: FloatArray) -> None:
        """Forget the residuals of the joints ``where`` (n,), whose models were reset; ``error`` (n,) [rad] is new."""
        # Older residuals were those of the model before its reset.
        self._median.clear(np.tile(where, 2))
        self._derivatives.put(where, error)
