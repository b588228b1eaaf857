"""Joints whose residual may be no touch: their load is not known, or they rest off their place."""

from __future__ import annotations

import numpy as np

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    PUSH_TICKS,
    QUIET_RATIO,
    SETTLING_TICKS,
    UNSURE_FACTOR,
)


class DoubtState:
    """Doubt of one joint.

    Attributes:
        rest_time: For which its model has been at rest [s].
        alone_ticks: For which its model has differed from the position without the torque that this would take.
        raised_ticks: For which its threshold stays raised.
        loud_ticks: For which its residual has been beyond QUIET_RATIO of its threshold.
    """

    rest_time: float
    alone_ticks: int
    raised_ticks: int
    loud_ticks: int


@kernel
def _raise_thresholds(
    states: Out[Records[DoubtState]],
    load_doubt: FloatArray,
    moving: BoolArray,
    cycle: float,
    own: Out[FloatArray],
    raised: Out[FloatArray],
) -> None:
    for j in range(len(own)):
        state = states[j]
        state.rest_time = 0.0 if moving[j] else state.rest_time + cycle
        # The model of a joint at rest soon knows what a load has done to its position.
        if state.rest_time < CORRECTION_TIME:
            own[j] += UNSURE_FACTOR * load_doubt[j]
        # Where a board follows another target, the current alone can show a touch.
        raised[j] = UNSURE_FACTOR * own[j] if state.raised_ticks > 0 else own[j]


@kernel
def _doubt(
    states: Out[Records[DoubtState]],
    model: FloatArray,
    residual: FloatArray,
    threshold: FloatArray,
    moving: BoolArray,
    blind: BoolArray,
    doubtful: Out[BoolArray],
) -> None:
    for j in range(len(doubtful)):
        state, quiet, off = states[j], QUIET_RATIO * threshold[j], abs(model[j])
        loud = abs(residual[j]) > quiet
        state.loud_ticks = state.loud_ticks + 1 if loud else 0
        alone = off > quiet and not (loud or moving[j] or blind[j])
        state.alone_ticks = state.alone_ticks + 1 if alone else 0
        rests_off = state.alone_ticks >= SETTLING_TICKS
        doubtful[j] = rests_off and off > threshold[j]
        if blind[j]:
            state.raised_ticks = SETTLING_TICKS
        elif rests_off or (state.raised_ticks > 0 and off > quiet):
            state.raised_ticks = max(state.raised_ticks - 1, 1)
        else:
            state.raised_ticks = max(state.raised_ticks - 1, 0)


class JointDoubt:
    """Doubt of all joints; see :class:`~pepper_driver.observer.residuals.fusion.FusionGenerator`.

    Args:
        count: Number n of joints.
        cycle: Period of the ticks [s].
    """

    def __init__(self, count: int, cycle: float) -> None:
        self._states, self._cycle = make_records(DoubtState, count), cycle
        self._raise, self._doubt = _raise_thresholds.load(), _doubt.load()
        self.reset()

    def reset(self) -> None:
        """Begin with joints that have been at rest for long."""
        self._states["rest_time"] = CORRECTION_TIME
        for name in ("alone_ticks", "raised_ticks", "loud_ticks"):
            self._states[name] = 0

    @property
    def fresh(self) -> BoolArray:
        """(n,) joints whose residual is not older than a push that begins: it was quiet PUSH_TICKS ago."""
        fresh: BoolArray = self._states["loud_ticks"] <= PUSH_TICKS
        return fresh

    def raise_thresholds(
        self, threshold: FloatArray, load_doubt: FloatArray, moving: BoolArray
    ) -> FloatArray:
        """Add the doubt of loads to (n,) thresholds [rad]; return (n,), raised where a joint is in doubt.

        Args:
            threshold: Of each joint; is changed.
            load_doubt: (n,) standard deviation of the error that follows from what is not known of the loads [rad].
            moving: (n,) joints that slide without touch, or did just before.
        """
        raised = np.empty(len(threshold))
        self._raise(self._states, load_doubt, moving, self._cycle, threshold, raised)
        return raised

    def step(
        self,
        model: FloatArray,
        residual: FloatArray,
        threshold: FloatArray,
        moving: BoolArray,
        blind: BoolArray,
    ) -> BoolArray:
        """Return (n,) joints that rest off their place without the torque of the motor that this would take.

        Args:
            model: (n,) or more, residual by the model alone [rad].
            residual: (n,) of both channels [rad].
            threshold: (n,) before it was raised [rad].
            moving: (n,) joints that slide without touch, or did just before.
            blind: (n,) joints that cannot be judged.
        """
        doubtful = np.empty(len(residual), np.bool_)
        self._doubt(self._states, model, residual, threshold, moving, blind, doubtful)
        return doubtful
