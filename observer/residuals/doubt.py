"""Joints whose residual may be no touch: they rest off their place.

A joint is in doubt if its command has rested for SETTLING_TICKS and more while the channel of the model alone was
beyond the threshold: its motor does not work against that. Its friction may then have any sign. From QUIET_RATIO of the
threshold on, until this channel is within it again, and for SETTLING_TICKS after the joint was blind or the target of
its board jumped, its threshold is UNSURE_FACTOR times as high.
"""

from __future__ import annotations

from pepper_driver.config.kernels import Out, Records, kernel
from pepper_driver.observer.constants import (
    QUIET_RATIO,
    SETTLING_TICKS,
    UNSURE_FACTOR,
)


class DoubtState:
    """Doubt of one joint.

    Attributes:
        alone_ticks: For which its model has differed from the position without the torque that this would take.
        raised_ticks: For which its threshold stays raised.
        loud_ticks: For which its residual has been beyond QUIET_RATIO of its threshold.
    """

    alone_ticks: int
    raised_ticks: int
    loud_ticks: int


@kernel
def raise_threshold(states: Records[DoubtState], j: int, threshold: float) -> float:
    """Return the threshold of a joint [rad], raised if it is in doubt."""
    # Where a board follows another target, the current alone can show a touch.
    return UNSURE_FACTOR * threshold if states[j].raised_ticks > 0 else threshold


@kernel
def step_doubt(
    states: Out[Records[DoubtState]],
    j: int,
    model: float,
    residual: float,
    threshold: float,
    moving: bool,
    blind: bool,
    jumps: bool,
) -> bool:
    """Take in one tick of a joint; return True if it rests off its place, and its motor does not work against that.

    Args:
        states: Of the joints.
        j: Index of the joint.
        model: Residual by the model alone [rad].
        residual: Of both channels [rad].
        threshold: Before it was raised [rad].
        moving: True if it slides without touch, or did just before.
        blind: True if it cannot be judged.
        jumps: True if the target of its board jumps.
    """
    state, quiet, off = states[j], QUIET_RATIO * threshold, abs(model)
    loud = abs(residual) > quiet
    state.loud_ticks = state.loud_ticks + 1 if loud else 0
    alone = off > quiet and not (loud or moving or blind)
    state.alone_ticks = state.alone_ticks + 1 if alone else 0
    rests_off = state.alone_ticks >= SETTLING_TICKS
    if blind or jumps:
        state.raised_ticks = SETTLING_TICKS
    elif rests_off or (state.raised_ticks > 0 and off > quiet):
        state.raised_ticks = max(state.raised_ticks - 1, 1)
    else:
        state.raised_ticks = max(state.raised_ticks - 1, 0)
    return rests_off and off > threshold
